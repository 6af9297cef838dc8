"""Whatever a library raises over a file becomes one short sentence."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import pytest

from rlco.errors import CheckpointError, DataError
from rlco.files import (
    Fields,
    read_json,
    read_json_lines,
    read_yaml,
    reading,
    shown,
    yaml_text,
)
from rlco.files.yaml_files import parse_yaml


@pytest.mark.parametrize(
    ("raised", "said"),
    [
        (ValueError("bad magic"), r"damaged \(bad magic\); copy it again\."),
        (KeyError("x"), r"damaged \('x'\)"),
        (RecursionError("too deep"), "too deep"),
        (OSError("Unsupported"), r"is damaged \(Unsupported\)"),
        (OSError(errno.EIO, "Input/output error"), r"cannot be read \(Input/output"),
        (FileNotFoundError(errno.ENOENT, "No"), "is missing; copy it again"),
        (MemoryError(), "needs more memory than there is"),
    ],
)
def test_an_exception_of_a_library(raised: Exception, said: str) -> None:
    with pytest.raises(DataError, match=said), reading("robot.npz"):
        raise raised


def test_our_own_errors_and_interrupts_go_through() -> None:
    with pytest.raises(CheckpointError), reading("robot.npz"):
        raise CheckpointError("of another kind.")
    with pytest.raises(KeyboardInterrupt), reading("robot.npz"):
        raise KeyboardInterrupt


def test_a_pipe_is_no_file_that_is_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "info.json")
    said = r"info\.json' is no file; copy it again"
    with pytest.raises(DataError, match=said):
        read_json(tmp_path / "info.json")
    with (
        pytest.raises(CheckpointError, match=said),
        reading(tmp_path / "info.json", error=CheckpointError),
    ):
        pytest.fail("opened")


def test_a_device_is_no_file_and_a_file_beyond_the_memory_is_not_read(
    tmp_path: Path,
) -> None:
    with pytest.raises(DataError, match="'/dev/zero' is no file"):
        read_yaml(Path("/dev/zero"))
    with pytest.raises(DataError, match="is no file"):
        read_yaml(tmp_path)
    with (tmp_path / "info.json").open("wb") as file:
        file.truncate(2**42)  # with nothing in it: it takes no place on the disk
    with pytest.raises(DataError, match=r"is a text of 4398046.5 MB, and at most 160"):
        read_json(tmp_path / "info.json")
    with pytest.raises(DataError, match=r"text of .*info\.json' would take 8796"):
        read_json_lines(tmp_path / "info.json")


def test_a_json_text_that_would_fill_a_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rlco.files.texts.LONGEST", 10)
    (tmp_path / "info.json").write_text('{"a": [[], []]}')
    with pytest.raises(DataError, match="holds 15 characters of JSON, and at most 10"):
        read_json(tmp_path / "info.json")


def test_a_value_is_shown_short_whatever_its_size() -> None:
    inner = ["lol"] * 9
    for _ in range(30):  # 9 to the power of 30 texts, spelt out
        inner = [inner] * 9
    assert len(shown(inner)) <= 200
    assert shown(10**5000) == "a int of many digits"


@pytest.mark.parametrize(
    ("content", "match"),
    [
        ({}, "lacks 'fps'"),
        ({"fps": None}, "'fps' of file 'a.json' is None, not a number above 0"),
        ({"fps": "20"}, "is '20', not a number"),
        ({"fps": True}, "is True, not a number"),
        ({"fps": float("nan")}, "is nan, not a number"),
        ({"fps": 10**400}, "not a number"),
        ({"fps": 0}, "is 0, not a number above 0"),
    ],
)
def test_a_number_is_one(content: dict[str, object], match: str) -> None:
    with pytest.raises(DataError, match=match):
        Fields(content, "file 'a.json'").number("fps", above=0)


def test_fields_have_their_types_and_inner_ones_their_place() -> None:
    fields = Fields({"rows": [{"n": 2}, {"n": 2.5}, 7], "n": None}, "file 'a.json'")
    assert fields.integer("n", 5) == 5
    assert Fields({"n": 2.0}, "").integer("n") == 2
    with pytest.raises(DataError, match=r"entry 3 of 'rows' of file .* holds 7"):
        fields.groups("rows")
    two = Fields({"rows": [{"n": 2}, {"n": 2.5}]}, "file 'a.json'").groups("rows")
    assert two[0].integer("n") == 2
    with pytest.raises(
        DataError, match=r"'n' of entry 2 of 'rows' .* is 2\.5, not a w"
    ):
        two[1].integer("n")


@pytest.mark.parametrize(
    "text", ["[" * 200_000, "{", "[1]", "", '"text"', '{"a": 1' + "0" * 5000 + "}"]
)
def test_json_that_is_none(tmp_path: Path, text: str) -> None:
    file = tmp_path / "a.json"
    file.write_text(text)
    with pytest.raises(DataError, match=r"a\.json"):
        read_json(file)


def test_lines_are_counted(tmp_path: Path) -> None:
    file = tmp_path / "a.jsonl"
    file.write_text('{"a": 1}\n\n[2]\n')
    with pytest.raises(DataError, match="line 3 of file"):
        read_json_lines(file)


# -- YAML ------------------------------------------------------------------------------


def yaml_of(tmp_path: Path, text: str) -> object:
    file = tmp_path / "a.yaml"
    file.write_bytes(text.encode("latin-1"))
    return read_yaml(file)


def test_numbers_as_people_write_them(tmp_path: Path) -> None:
    text = "[-1.0e6, 1e-3, 1e3, +2.5E3, .5, -.inf, 12, 1.2.3, 1e, e3]"
    expected = [-1e6, 1e-3, 1e3, 2.5e3, 0.5, -float("inf"), 12, "1.2.3", "1e", "e3"]
    assert yaml_of(tmp_path, text) == expected


def test_aliases_that_stand_for_more_than_a_memory_holds(tmp_path: Path) -> None:
    lines = ["a0: &a0 [lol, lol, lol, lol, lol, lol, lol, lol, lol]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 40)]
    with pytest.raises(DataError, match=r"aliases of file .* stand for more than"):
        yaml_of(tmp_path, "\n".join(lines))


def test_a_few_aliases_are_fine(tmp_path: Path) -> None:
    text = "base: &base {lr: 1e-3}\nhere: {<<: *base, seed: 1}"
    content = yaml_of(tmp_path, text)
    assert content == {"base": {"lr": 1e-3}, "here": {"lr": 1e-3, "seed": 1}}


def test_what_stands_beside_a_merge_replaces_what_it_brings(tmp_path: Path) -> None:
    # The one in the middle has a merge of its own.
    lines = ["base: &base {lr: 1e-3, seed: 1}", "outer:", "  deep:"]
    lines += [
        "    middle: &middle {<<: *base, seed: 2}",
        "last: {seed: 3, <<: *middle}",
    ]
    content = yaml_of(tmp_path, "\n".join(lines))
    assert content == {
        "base": {"lr": 1e-3, "seed": 1},
        "outer": {"deep": {"middle": {"lr": 1e-3, "seed": 2}}},
        "last": {"lr": 1e-3, "seed": 3},
    }


def test_a_key_beside_a_merge_stands_once(tmp_path: Path) -> None:
    text = "base: &base {lr: 1}\nhere:\n  <<: *base\n  lr: 2\n  lr: 3"
    with pytest.raises(DataError, match="'lr' is given twice in line 5"):
        yaml_of(tmp_path, text)


@pytest.mark.parametrize(
    "text",
    [
        "a: &a [*a]",
        "a: 1\na: 2",
        "a: &a {b: 1}\nc: {<<: *a, <<: *a}",
        "a: !!python/object/apply:os.system [ls]",
        "[" * 1500,
        "a: \xff",
        "- " * 600_000,
        "? [1]\n: 2",
    ],
)
def test_yaml_that_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(DataError, match=r"a\.yaml"):
        yaml_of(tmp_path, text)


def test_lines_of_a_message_are_one(tmp_path: Path) -> None:
    with pytest.raises(DataError) as caught:
        yaml_of(tmp_path, "a: [1, 2\nb: 3")
    assert "\n" not in str(caught.value)
    assert json.dumps(str(caught.value))


@pytest.mark.parametrize("text", ["0E0", "1e3", "-1.0e6", "+1e-3", ".5", "1_0.0", "no"])
def test_a_text_that_looks_like_a_number_is_written_as_a_text(text: str) -> None:
    written = yaml_text({"target": text, text: [1e3, text]})
    assert parse_yaml(written, "file") == {"target": text, text: [1000.0, text]}
