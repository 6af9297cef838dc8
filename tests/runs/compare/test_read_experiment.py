"""Experiments that are none are refused in a sentence, however they are wrong."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import pytest
import yaml

from rlco.errors import ConfigError, DataError
from rlco.runs.compare.cells import Store
from rlco.runs.compare.experiment import Experiment
from rlco.runs.compare.jobs import expand, file_hash
from rlco.runs.compare.only import only
from rlco.runs.compare.plan import make_plan
from rlco.runs.compare.reading.read_experiment import read_experiment
from rlco.runs.compare.smallest import smallest

#: Whose combinations of values no memory holds.
MANY = {f"v{number}": list(range(100)) for number in range(6)}
ALL = "".join(f"{{{name}}}" for name in MANY)


@pytest.fixture
def given() -> dict[str, Any]:
    """An experiment that is right: one job, one method."""
    return {
        "over": {"seed": [0, 12], "task": ["push", "lift"]},
        "jobs": {
            "one": {"script": "s.py", "options": {"seed": "{seed}", "task": "{task}"}}
        },
        "table": {"by": "task", "methods": {"sft": {"job": "one"}}},
    }


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "s.py").write_text("print(1)\n")
    return tmp_path


def read(folder: Path, given: Any) -> Experiment:
    path = folder / "small.yaml"
    text = given if isinstance(given, str) else yaml.safe_dump(given, sort_keys=False)
    path.write_text(text)
    return read_experiment(path)


def refused(folder: Path, given: Any) -> str:
    """Read an experiment that must be refused soon; return what is said."""
    before = time.process_time()
    with pytest.raises(ConfigError) as caught:
        read(folder, given)
    assert time.process_time() - before < 20
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 30 * 700
    return text


# -- Formats ---------------------------------------------------------------------------


def test_a_number_may_have_a_format(folder: Path, given: dict[str, Any]) -> None:
    given["jobs"]["one"]["options"] = {"seed": "6{seed:03d}", "task": "{task:6}|"}
    given["table"]["methods"] = {"at {seed:.1f}": {"job": "one"}}
    given["table"]["differences"] = [["at 0.0", "at 12.0"]]
    experiment = read(folder, given)
    assert [job.options({}) for job in expand(experiment)][2:] == [
        {"seed": "6012", "task": "push  |"},
        {"seed": "6012", "task": "lift  |"},
    ]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{seed:q}", "braces hold 'seed:q'; give a name alone, or with a number's"),
        ("{seed:999999999}", "braces hold 'seed:999999999'"),
        ("{seed:>5}", "braces hold 'seed:>5'"),
        ("{seed:{task}}", "braces hold 'seed:{task}'"),
        ("{seed!r}", "braces hold 'seed!r'"),
        ("{seed!z}", "braces hold 'seed!z'"),
        ("{task:d}", "has {task:d}, a format that 'push' does not take; write {task}"),
        ("{seed.real}", "braces hold 'seed.real', which is no name"),
        ("{" + "q" * 9000 + ":d}", "names {qqq"),
    ],
)
def test_other_formats_are_refused(
    folder: Path, given: dict[str, Any], text: str, said: str
) -> None:
    given["jobs"]["one"]["options"]["more"] = ["a", text]
    assert f"job one{'' if said.startswith(('has', 'names')) else ':'} {said}" in (
        refused(folder, given)
    )
    del given["jobs"]["one"]["options"]["more"]
    given["table"]["methods"] = {f"m {text}": {"job": "one"}}
    assert said in refused(folder, given)


@pytest.mark.parametrize("form", ["d", "5"])
def test_a_folder_takes_no_format(
    folder: Path, given: dict[str, Any], form: str
) -> None:
    given["jobs"]["two"] = {"script": "s.py", "options": {"policy": f"{{one:{form}}}"}}
    assert f"{{one:{form}}}, but a job's folder takes no format; write {{one}}" in (
        refused(folder, given)
    )


def test_a_label_names_what_its_job_varies_with(
    folder: Path, given: dict[str, Any]
) -> None:
    given["over"]["beta"] = [0, 1]
    given["table"]["methods"] = {"beta {beta}": {"job": "one"}}
    said = "names {beta}, with which job one does not vary; leave it out of the label"
    assert said in refused(folder, given)


# -- Jobs ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("options", [1, 2], "has options: [1, 2]; give names with values"),
        ("options", "abc", "has options: 'abc'; give names with values"),
        ("options", {1: 2}, "has an option 1; give a name of letters"),
        ("options", {"a": {None: 2}}, "has an option None; give a name of"),
        ("options", {"out=there/x": 1}, "has an option 'out=there/x'; give a name"),
        ("options", {" out": 1}, "has an option ' out'; give a name"),
        ("options", {"x": "a\0b"}, "jobs one options x: 'a\\x00b' is no text that"),
        ("options", {"x": {1, 2}}, "is no text, number, flag, list or mapping"),
        ("options", {"x": 10**400}, "jobs one options x: 1000"),
        ("options", {"x": "{task}" * 50_000}, "has 1 option of up to"),
        ("options", {f"x{n}": n for n in range(900)}, "has 900 options of up to"),
        ("curves", 5, "has curves: 5; give a list of tables in its run folder"),
        ("curves", None, "has curves: None; give a list of tables"),
        ("curves", [5], "has a curve 5; give the name of a table in its run folder"),
        ("curves", ["/etc/*.csv"], "has a curve '/etc/*.csv'; give the name of"),
        ("curves", ["../*.csv"], "has a curve '../*.csv'; give the name of"),
        ("curves", ["a/../../b"], "has a curve 'a/../../b'; give the name of"),
        ("curves", [""], "has a curve ''; give the name of"),
        ("curves", ["."], "has a curve '.'; give the name of"),
        ("curves", ["**x"], "has a curve '**x'; give the name of"),
        ("curves", ["**/" * 5000], "has a curve '**/**"),
        ("minutes", float("nan"), "has minutes: nan; give the time expected on one"),
        ("minutes", float("inf"), "has minutes: inf; give the time"),
        ("minutes", -5, "has minutes: -5; give the time"),
        ("minutes", True, "has minutes: True; give the time"),
        ("minutes", [1], "has minutes: [1]; give the time"),
        ("minutes", 10**400, "jobs one minutes: 1000"),
        ("minutes", 1e300, "has minutes: 1e+300; give the time"),
        ("results", [1], "has results: [1]; give false where"),
        ("script", ["a"], "has script ['a'], which is no file here"),
        ("script", "s" * 5000, "which is no file here"),
        ("script", "/dev/zero", "has script '/dev/zero', which is no file here"),
    ],
)
def test_a_job_is_refused(
    folder: Path, given: dict[str, Any], field: str, value: Any, said: str
) -> None:
    given["jobs"]["one"][field] = value
    given["table"]["by"] = []
    assert said in refused(folder, given)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"def (:\n", "invalid syntax (bad.py, line 1)"),
        (b"a\0b", "null bytes"),
        (b'x = "\xff"\n', "can't decode byte 0xff"),
        (b"(" * 5000, "too many nested parentheses"),
        (b"-" * 100_000 + b"1", "too complex"),
        (b"+".join([b"1"] * 50_000), "recursion"),
        (b"a" + b"()" * 2000, "recursion"),
        (b"x = 0x" + b"f" * 5000, "4300 digits"),
        (b"x = 1\n" * 400_000, "is of 2400000 bytes, and at most 2000000 are read"),
    ],
    ids=range(9),
)
def test_a_script_that_is_no_python_is_refused(
    folder: Path, given: dict[str, Any], content: bytes, said: str
) -> None:
    (folder / "bad.py").write_bytes(content)
    given["jobs"]["one"]["script"] = "bad.py"
    given["jobs"]["one"]["curves"] = 5
    text = refused(folder, given)
    assert "job one: file " in text
    assert said in text
    assert "; correct it, or give another one" in text
    assert "has curves: 5" in text  # all that is wrong is said
    # What it imports is said as soon as its jobs are made.
    given["jobs"]["one"] |= {"script": "s.py", "curves": []}
    (folder / "s.py").write_text("import bad\n")
    with pytest.raises(DataError, match=r"bad\.py"):
        expand(read(folder, given))


def test_one_curve_may_stand_without_brackets(
    folder: Path, given: dict[str, Any]
) -> None:
    given["jobs"]["one"]["curves"] = "metrics.csv"
    assert read(folder, given).jobs["one"].curves == ("metrics.csv",)


@pytest.mark.parametrize("place", ["/dev/zero", "/proc/version", "pipe", ".", "a\0b"])
def test_what_never_ends_is_not_hashed(
    folder: Path,
    given: dict[str, Any],
    place: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(folder)
    os.mkfifo("pipe")
    assert file_hash(place) is None
    if "\0" not in place:
        given["jobs"]["one"]["options"]["data"] = place
        given["files"] = {place: "0" * 64}
        assert all(job.key for job in expand(read(folder, given)))


# -- Sizes -----------------------------------------------------------------------------


def test_more_jobs_and_labels_than_memory_holds_are_refused(
    folder: Path, given: dict[str, Any]
) -> None:
    given["over"] |= MANY
    given["jobs"]["one"]["options"]["all"] = ALL
    given["table"]["methods"] = {f"m {ALL}": {"job": "one"}}
    text = refused(folder, given)
    assert "more than 10000 with all values of their variables; make several" in text
    assert "table would have more than 10000 rows, of all methods" in text


def test_more_tables_than_memory_holds_are_refused(
    folder: Path, given: dict[str, Any]
) -> None:
    given["over"] |= MANY
    given["table"]["by"] = ["task", *MANY]
    assert "table would have more than 10000 rows" in refused(folder, given)
    given["table"]["by"] = ["task"] * 20_000
    assert "table would have more than 10000 rows" in refused(folder, given)


def test_values_that_nothing_names_make_no_more_jobs(
    folder: Path, given: dict[str, Any]
) -> None:
    given["over"] |= MANY
    assert len(expand(read(folder, given))) == 4


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"over": {"seed": [*range(2000)]}}, "over seed has 2000 values, and at most"),
        ({"over": {"seed": [0], "task": ["x" * 300]}}, "a folder whose name is of 3"),
        ({"without": [{"seed": 0}] * 5000}, "without holds 5000 values, and at most"),
        ({"jobs": {f"j{n}": {"script": "s.py"} for n in range(300)}}, "than 200 jobs"),
        ({f"k{n}": n for n in range(9000)}, "correct these first, and what else"),
    ],
    ids=["values", "name", "without", "jobs", "problems"],
)
def test_what_is_too_much_is_refused(
    folder: Path, given: dict[str, Any], change: dict[str, Any], said: str
) -> None:
    assert said in refused(folder, given | change)


def test_aliases_that_multiply_are_refused(folder: Path, given: dict[str, Any]) -> None:
    one = f"a0: &a0 [{', '.join('x' * 10)}]"
    more = [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 8)]
    given["jobs"]["one"]["options"] = "HERE"
    text = yaml.safe_dump(given)
    for several in (more, more[:4]):
        refused(folder, text.replace("HERE", f"{{{', '.join([one, *several])}}}"))


def test_jobs_that_need_each_other_in_many_ways_are_planned_at_once(
    folder: Path, given: dict[str, Any]
) -> None:
    # The dearest come first in the file, so that each is added for those after it.
    given["jobs"] = {
        f"j{n}": {
            "script": "s.py",
            "minutes": 100 - n,
            "options": {f"p{k}": f"{{j{n - k}}}" for k in (1, 2) if n >= k},
        }
        for n in range(60)
    }
    given["table"] = {"methods": {"m": {"job": "j59"}}}
    plan = make_plan(expand(read(folder, given)), Store(folder / "out", None))
    assert [job.kind.name for job in plan.jobs] == [f"j{n}" for n in range(60)]


# -- Jobs of another file --------------------------------------------------------------


def shares(folder: Path, given: dict[str, Any]) -> dict[str, Any]:
    """Write ``all.yaml`` with five jobs; return an experiment that shares some."""
    every = {
        "data": {"script": "s.py", "results": False, "options": {"seed": "{seed}"}},
        "other": {"script": "s.py", "options": {"never": "{task}"}},
        "one": {"script": "s.py", "options": {"of": {"data": "{data}"}}},
        "two": {"script": "s.py", "options": {"policy": "{one}/policy"}},
        "three": {"script": "s.py", "options": {"task": "{task}"}},
    }
    text = yaml.safe_dump(given | {"jobs": every}, sort_keys=False)
    (folder / "all.yaml").write_text(text)
    mine = {"last": {"script": "s.py", "options": {"from": "{two}"}}}
    methods = {"last": {"job": "last"}, "three": {"job": "three"}}
    return given | {
        "jobs_of": "all.yaml",
        "jobs": mine,
        "table": {"by": "task", "methods": methods},
    }


def test_jobs_of_another_file_are_those_that_are_needed(
    folder: Path, given: dict[str, Any]
) -> None:
    experiment = read(folder, shares(folder, given))
    assert list(experiment.jobs) == ["data", "one", "two", "three", "last"]
    # What decides a result is the same, so that such a job runs once for both.
    there = {job.key for job in expand(read_experiment(folder / "all.yaml"))}
    shared = [job for job in expand(experiment) if job.kind.name != "last"]
    assert len(shared) == 2 * 3 + 2
    assert {job.key for job in shared} <= there


def test_a_file_may_have_no_jobs_of_its_own(
    folder: Path, given: dict[str, Any]
) -> None:
    mine = shares(folder, given)
    del mine["jobs"], mine["table"]["methods"]["last"]
    assert list(read(folder, mine).jobs) == ["three"]


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"jobs_of": "absent.yaml"}, "jobs_of: 'absent.yaml': "),
        ({"jobs_of": "../all.yaml"}, "'../all.yaml' is no name of a file beside this"),
        ({"jobs_of": ["all.yaml"]}, "jobs_of: ['all.yaml'] is no name of a file"),
        ({"jobs_of": ".."}, "jobs_of: '..'"),
        ({"jobs_of": "q" * 5000}, "jobs_of: 'qqq"),
        ({"jobs_of": "none.yaml"}, "jobs_of: 'none.yaml' has no jobs of its own; name"),
        ({"jobs_of": "odd.yaml"}, "jobs of odd.yaml a: 'b\\x00' is no text that a"),
        ({"jobs": {"two": {"script": "s.py"}}}, "job 'two' is also a job of jobs_of:"),
        ({"jobs": ["two"]}, "jobs is missing, or is no mapping of names"),
        ({"over": {"seed": [0]}}, "job three names {task}, which is no variable"),
    ],
)
def test_jobs_that_cannot_be_shared_are_refused(
    folder: Path, given: dict[str, Any], more: dict[str, Any], said: str
) -> None:
    (folder / "none.yaml").write_text("jobs_of: all.yaml\n")
    (folder / "odd.yaml").write_text('jobs: {a: "b\\0"}\n')
    assert said in refused(folder, shares(folder, given) | more)


# -- Tables, and the rest --------------------------------------------------------------

NO_NAMES = [[["task"]], {"task": 1}, 3, True, [{"task": 1}], [None], "q" * 5000]


@pytest.mark.parametrize("field", ["by", "mean", "axis", "seed"])
@pytest.mark.parametrize("value", NO_NAMES, ids=range(len(NO_NAMES)))
def test_what_names_no_variable_is_refused(
    folder: Path, given: dict[str, Any], field: str, value: Any
) -> None:
    given["table"][field] = value
    text = refused(folder, given)
    assert ("is no variable" if field in ("by", "seed") else "is none of by") in text


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("domains", [["sim"]], "table's domain is ['sim']; give one name"),
        ("domains", {"sim": 1}, "table's domain is {'sim': 1}; give one name"),
        ("curve_episodes", -3, "curve_episodes is -3, no number of episodes; give a"),
        ("curve_episodes", True, "curve_episodes is True, no number of episodes"),
        ("curve_episodes", 10**9, "is 1000000000, no number of episodes"),
        ("differences", 3, "table's difference 3 is no pair [A, B]"),
        ("differences", [[["sft"], {"a": 2}]], "table's difference names \"['sft']\""),
        ("differences", ["q" * 5000], "is no pair [A, B]"),
        ("predictions", 3, "table's prediction 3 is not of the form"),
        (
            "predictions",
            [{"gain": ["sft", "sft"], "falls_with": "sft", "domain": ["sim"]}],
            "table's prediction's domain is ['sim']; give one name",
        ),
        ("published", 3, "table's published 3 is not of the form"),
        (
            "published",
            [{"source": ["a"], "at": {}, "success": {"sft": 0.5}}],
            "table's published source is ['a']; give one name",
        ),
        (
            "published",
            [{"source": "a", "at": {}, "success": {"sft": True}}],
            "is not of the form {source: WHO, at: {VARIABLE: VALUE}",
        ),
        ("methods", [["sft"]], "table's methods is missing, or is no mapping"),
        ("methods", {"sft": ["one"]}, "table's method 'sft' is missing, or is no"),
        ("methods", {"sft": {"job": ["one"]}}, "has job \"['one']\""),
        ("methods", {"sft": {"job": "one", "at": 5}}, "has at: 5, which maps no"),
        (
            "methods",
            {"sft": {"job": "one", "method": ["sft"]}},
            "table's method 'sft''s method is ['sft']; give one name",
        ),
        (
            "methods",
            {"sft": {"job": "one", "curve": {"a": 1}}},
            "table's method 'sft''s curve is {'a': 1}; give one name",
        ),
        ("methods", {"q" * 5000: {"job": "one"}}, "a label of more than 200"),
    ],
)
def test_a_table_is_refused(
    folder: Path, given: dict[str, Any], field: str, value: Any, said: str
) -> None:
    given["table"][field] = value
    assert said in refused(folder, given)


def test_nothing_is_as_good_as_left_out(folder: Path, given: dict[str, Any]) -> None:
    given["table"] |= dict.fromkeys(("mean", "axis", "domains", "differences"))
    before = read(folder, given).table
    assert (before.mean, before.axis, before.domains) == ((), None, ())
    given["table"]["by"] = None
    given["over"]["task"] = ["push"]
    assert read(folder, given).table.by == ()


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (
            "[2026-01-01]",
            "over task holds '2026-01-01', which is no value that results",
        ),
        ("[.nan]", "over task holds 'nan', which is no value"),
        ("[1, 1.0]", "over task holds a value twice"),
        ('[null, "null"]', "over task holds a value twice"),
        ("[!!binary aGk=]", "over task: b'hi' is no text, number"),
        ('["\\ud800"]', "over task: '\\ud800' is no text that a command line takes"),
        ("[0x" + "f" * 5000 + "]", "over task: a int of many digits is no usual"),
        ("!!set {a, b}", "is no text, number, flag, list or mapping"),
    ],
)
def test_values_that_results_cannot_name_are_refused(
    folder: Path, given: dict[str, Any], values: str, said: str
) -> None:
    given["over"]["task"] = "HERE"
    assert said in refused(folder, yaml.safe_dump(given).replace("HERE", values))


@pytest.mark.parametrize("name", ["../../x", "..", ".", "", "x" * 200, ["a"], None])
def test_a_name_is_that_of_one_folder(
    folder: Path, given: dict[str, Any], name: Any
) -> None:
    assert "name" in refused(folder, given | {"name": name})


@pytest.mark.parametrize("debug", ["[a]\n", "5\n"])
def test_short_options_that_are_none_are_refused(
    folder: Path, given: dict[str, Any], debug: str
) -> None:
    (folder / "s").mkdir()
    (folder / "s" / "debug.yaml").write_text("")
    experiment = read(folder, given)
    assert smallest(experiment).jobs["one"].options["config"] == "debug"
    (folder / "s" / "debug.yaml").write_text(debug)
    with pytest.raises(DataError, match=r"debug\.yaml' holds .*, not names with"):
        smallest(experiment)


@pytest.mark.parametrize("value", [["seed"], {"seed": 0}, "seed=" + "7" * 5000])
def test_a_part_that_is_none_is_refused(
    folder: Path, given: dict[str, Any], value: Any
) -> None:
    experiment = read(folder, given)
    with pytest.raises(ConfigError, match="only=") as caught:
        only(expand(experiment), experiment, [value])
    assert len(str(caught.value)) < 300
