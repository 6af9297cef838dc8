"""Held commands as sums of changes."""

from __future__ import annotations

import numpy as np

from rlco.gap.compare.arm.command_changes import CommandChanges
from rlco.gap.compare.segments import held_commands
from rlco.gap.logs.log import Recording

STEP = 0.01  # [s]
TIME = np.array([0.0, 0.04, 0.08, 0.12])
SENT = np.array([1.0, 2.0, 4.0, 8.0])[:, None]


def _held(late: list[float], unread: bool = False) -> list[float]:
    extra = (np.array([0.06]), np.array([[3.0]])) if unread else None
    recording = Recording("log", TIME, command=SENT, unread=extra)
    changes = CommandChanges.of(recording, STEP, np.array(late))
    return [float(value) for value in changes.held()[:, 0].round(9)]


def test_commands_in_time_are_held_as_they_are_logged() -> None:
    recording = Recording("log", TIME, command=SENT)
    logged = held_commands(recording, STEP, 1, [0])[:, 0]
    assert _held([0.0] * 4) == logged.tolist()


def test_each_change_takes_effect_at_a_time_of_its_own() -> None:
    # The second by 15 ms: half of the step from 0.05 s on has the old command.
    expected = [1.0] * 5 + [1.5] + [2.0] * 2 + [4.0] * 4 + [8.0]
    assert _held([0.0, 0.015, 0.0, 0.0]) == expected


def test_a_command_that_is_overtaken_adds_its_change_later() -> None:
    # 2 comes after 4: what is held then is 1 + (4 - 2), and at last 4.
    expected = [1.0] * 8 + [3.0] * 1 + [4.0] * 3 + [8.0]
    assert _held([0.0, 0.05, 0.0, 0.0]) == expected


def test_a_command_of_no_row_is_in_time_and_divides_the_change_around_it() -> None:
    # 4 is sent after 3, and arrives 10 ms late: it adds 1, not 2.
    expected = [1.0] * 4 + [2.0] * 2 + [3.0] * 3 + [4.0] * 3 + [8.0]
    assert _held([0.0, 0.0, 0.01, 0.0], unread=True) == expected
