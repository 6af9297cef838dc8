"""Every name that docs/gap.md lists is read, without rename, as what it is listed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from log_cases import ARM, JOINTS, Array, arm, motion

from rlco.gap.logs import read_log
from rlco.gap.logs.formats.headers import parse_header, parse_time
from rlco.gap.model import LoadedModel

PAGE = Path(__file__).parents[3] / "docs" / "gap.md"
KINDS = ("position", "velocity", "torque", "command", "extra")
TIME, POSITION, COMMAND = motion()
VALUES = {
    "position": POSITION,
    "velocity": np.gradient(POSITION, TIME, axis=0),
    "torque": 2.0 * POSITION,
    "command": COMMAND,
    "extra": np.full_like(POSITION, 0.25),
}


def table() -> Iterator[tuple[str, list[list[str]]]]:
    """Yield each row of the table: who writes it, and the examples of each cell."""
    text = PAGE.read_text("utf-8")
    rows = text.partition("| written by |")[2].partition("\n\n")[0].splitlines()[2:]
    for row in rows:
        name, *cells = [cell.strip() for cell in row.strip().strip("|").split("|")]
        yield name, [re.findall(r"`([^`]+)`", cell) for cell in cells]


ROWS = dict(table())


@pytest.fixture
def model(tmp_path: Path) -> LoadedModel:
    # Wide ranges: a servo's steps are rounded, and speeds are not checked here.
    return arm(tmp_path, ARM.replace('limited="true"', 'limited="false"'))


def family(example: str) -> list[str]:
    """Return the headers of all joints from that of one."""
    if "elbow" in example:
        return [example.replace("elbow", name) for name in JOINTS]
    number = re.search(r"\d+(?!.*\d)", example)
    if number is None:
        return [example]
    first, before, after = int(number[0]), example[: number.start()], number.end()
    return [f"{before}{first + i}{example[after:]}" for i in range(len(JOINTS))]


def write(file: Path, cells: list[list[str]], clock: str) -> None:
    """Write a log with the first example of each quantity, and all that is not used."""
    scale = {"%time": 1e9, "__time": 1.0}.get(clock) or 1.0 / (parse_time(clock) or 1.0)
    columns: dict[str, Array] = {clock: np.round(TIME * scale, 6)}
    for kind, examples in zip(KINDS, cells, strict=True):
        for example in examples if kind == "extra" else examples[:1]:
            values = VALUES[kind]
            if re.match("present|goal", example, re.IGNORECASE) and kind != "extra":
                turn = 4096.0 / (2 * np.pi)
                speed = 1.0 / (0.229 * 2 * np.pi / 60)
                values = np.round(
                    values * speed if kind == "velocity" else values * turn + 2048
                )
            for i, header in enumerate(family(example)):
                columns[header] = values[:, i]
    lines = [",".join(columns)]
    rows = np.column_stack(list(columns.values()))
    lines += [",".join(f"{x:.12g}" for x in row) for row in rows]
    file.write_text("\n".join(lines))


@pytest.mark.parametrize("name", ROWS)
def test_a_log_as_it_is_written_is_read_without_rename(
    name: str, model: LoadedModel, tmp_path: Path
) -> None:
    (clock, *_), *cells = ROWS[name]
    write(tmp_path / "log.csv", cells, clock)
    log = read_log(tmp_path / "log.csv", model)
    part = log.recordings[0]
    assert log.joints == JOINTS
    np.testing.assert_allclose(part.time, TIME, atol=1e-6)
    for kind, examples in zip(KINDS[:-1], cells, strict=False):
        values = getattr(part, kind)
        if not examples:
            assert values is None
            continue
        # A servo tells its place to 1.5 mrad and its speed to 24 mrad/s.
        coarse = {"velocity": 0.013}.get(kind, 8e-4) if "Dynamixel" in name else 1e-9
        np.testing.assert_allclose(values, VALUES[kind], atol=coarse, rtol=1e-9)
    unused = [header for example in cells[-1] for header in family(example)]
    assert set(log.unused) == set(unused)


@pytest.mark.parametrize(
    ("kind", "example"),
    [
        (kind, example)
        for _, *cells in ROWS.values()
        for kind, examples in zip(KINDS, cells, strict=True)
        for example in examples
    ],
)
def test_each_example_is_what_its_column_says(kind: str, example: str) -> None:
    # Beside counted joints these two are no joints; by themselves they might be.
    if example in ("speed_scaling", "runtime_state"):
        return
    assert parse_header(example, JOINTS).kind == kind


def test_each_clock_is_one() -> None:
    clocks = [clock for (clocks, *_) in ROWS.values() for clock in clocks]
    assert len(clocks) > 9
    assert all(parse_time(clock) for clock in clocks)
