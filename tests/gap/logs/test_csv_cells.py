"""CSV as data frames and exporters write it: quotes, lists, blanks between topics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from log_cases import JOINTS, Array, arm, motion

from rlco.errors import DataError
from rlco.gap.logs import read_log

TIME, POSITION, COMMAND = motion()


def write(file: Path, header: str, rows: list[str]) -> Path:
    file.write_text("\n".join([header, *rows]))
    return file


def cell(style: str, values: Array) -> str:
    numbers = [f"{value:.9f}" for value in values]
    return {
        "list": f'"[{", ".join(numbers)}]"',
        "tuple": f'"({", ".join(numbers)})"',
        "numpy": f'"[{" ".join(numbers[:2])}\n {numbers[2]}]"',
        "blanks": f'"{" ".join(numbers)}"',
        "bare": f"[{' '.join(numbers)}]",
    }[style]


@pytest.mark.parametrize("style", ["list", "tuple", "numpy", "blanks", "bare"])
def test_a_list_in_a_cell_is_a_column_a_number(tmp_path: Path, style: str) -> None:
    rows = [
        f"{t:.3f},{cell(style, q)},{cell(style, c)}"
        for t, q, c in zip(TIME, POSITION, COMMAND, strict=True)
    ]
    file = write(tmp_path / "a.csv", "time,joint_positions,action", rows)
    part = read_log(file, arm(tmp_path)).recordings[0]
    np.testing.assert_allclose(part.position, POSITION, atol=1e-8)
    np.testing.assert_allclose(part.command, COMMAND, atol=1e-8)


def test_a_list_of_names_says_whose_the_numbers_are(tmp_path: Path) -> None:
    names = "\"['wrist', 'shoulder', 'elbow']\""
    order = [2, 0, 1]
    rows = [
        f"{t:.3f},{names},{cell('list', q[order])}"
        for t, q in zip(TIME, POSITION, strict=True)
    ]
    file = write(tmp_path / "a.csv", "time,name,position", rows)
    part = read_log(file, arm(tmp_path)).recordings[0]
    np.testing.assert_allclose(part.position, POSITION, atol=1e-8)


def test_lists_that_differ_in_length_are_refused(tmp_path: Path) -> None:
    rows = [f'{t:.3f},"[0.1, 0.2, 0.3]"' for t in TIME]
    rows[6] = f'{TIME[6]:.3f},"[0.1, 0.2]"'
    file = write(tmp_path / "a.csv", "time,position", rows)
    with pytest.raises(DataError, match="a list of 2 in row 7 and of 3 in the first"):
        read_log(file, arm(tmp_path))


def test_quoted_names_and_numbers_with_separators_in_them(tmp_path: Path) -> None:
    header = '"time","shoulder","elbow","wrist","remark, if any"'
    rows = [
        ",".join([*(f'"{x:.9f}"' for x in (t, *q)), '"none, really"'])
        for t, q in zip(TIME, POSITION, strict=True)
    ]
    log = read_log(write(tmp_path / "a.csv", header, rows), arm(tmp_path))
    np.testing.assert_allclose(log.recordings[0].position, POSITION, atol=1e-8)
    assert "Columns of text are left out: remark, if any." in log.notes


def topics(tmp_path: Path, *, broken: bool = False) -> Path:
    """Write states at all times, and every other command between them, as PlotJuggler.

    Rows are at the times of either, blank where the other topic has no message.
    """
    states = [f"/joint_states/{name}/position" for name in JOINTS]
    sent = [f"/arm_controller/commands/data[{i}]" for i in range(3)]
    rows = []
    for row, time in enumerate(TIME):
        if row % 2 == 0:
            goal = [f"{x:.9f}" for x in COMMAND[row]]
            rows.append(",".join([f"{time - 0.004:.6f}", "", "", "", *goal]))
        told = [f"{x:.9f}" for x in POSITION[row]]
        told = ["", *told[1:]] if broken and row == 40 else told
        rows.append(",".join([f"{time:.6f}", *told, "", "", ""]))
    return write(tmp_path / "a.csv", ",".join(["__time", *states, *sent]), rows)


def test_topics_with_times_of_their_own_meet_at_those_of_the_positions(
    tmp_path: Path,
) -> None:
    log = read_log(topics(tmp_path), arm(tmp_path))
    part = log.recordings[0]
    np.testing.assert_allclose(part.time, TIME, atol=1e-9)
    np.testing.assert_allclose(part.position, POSITION, atol=1e-8)
    # The last one that was sent holds.
    np.testing.assert_allclose(
        part.command, np.repeat(COMMAND[::2], 2, axis=0), atol=1e-8
    )
    assert any("held from message to message" in note for note in log.notes)


def test_a_blank_in_one_joint_alone_is_a_fault_still(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="shoulder/position' of 'a' is NaN"):
        read_log(topics(tmp_path, broken=True), arm(tmp_path))
