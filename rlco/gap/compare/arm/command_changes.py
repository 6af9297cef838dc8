"""Held commands as sums of changes, each of which takes effect at a time of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rlco.gap.compare.problem import Integers
from rlco.gap.compare.segments import command_steps, sent_commands
from rlco.gap.logs.log import Array, Recording


@dataclass(frozen=True)
class CommandChanges:
    """Changes of a recording's commands.

    A held command is the first, plus every change whose time has come. So it is linear
    in each change, and a command may even overtake another.

    Attributes:
        first: The first command, (actuators,).
        time: When each change takes effect, from the first physics step on, (M,) [s].
        changes: (M, actuators); none in the first.
        row: Row of each, or -1, (M,).
        step: The physics step [s].
        steps: Physics steps of the recording.
    """

    first: Array
    time: Array
    changes: Array
    row: Integers
    step: float
    steps: int

    @classmethod
    def of(cls, recording: Recording, step: float, late: Array) -> CommandChanges:
        """Return the changes of a recording.

        Args:
            recording: The recording.
            step: The physics step [s].
            late: How much later than its row each row's command takes effect,
                (rows,) [s].
        """
        time, sent, row = sent_commands(recording)
        times = command_steps(recording, step)
        later = np.where(row >= 0, late[row], 0.0)
        changes = np.diff(sent, axis=0, prepend=sent[:1])
        return cls(sent[0], time + later - times[0], changes, row, step, len(times))

    def held(self) -> Array:
        """Return the commands at each physics step, (steps, actuators)."""
        every = np.ones(len(self.time), dtype=bool)
        return np.asarray(self.first + np.cumsum(self.at(every), axis=0))

    def at(self, some: Array, later: float = 0.0) -> Array:
        """Return what some changes add at each physics step, (steps, actuators).

        A command that changes within a step is, on average over it, a part of the new.

        Args:
            some: Which, (M,).
            later: By how much later all of them take effect [s].
        """
        place = (self.time[some] + later) / self.step
        place = np.clip(place, 0.0, self.steps - 1.0)
        before = place.astype(int)
        part = (place - before)[:, None]
        added = np.zeros((self.steps + 1, self.changes.shape[1]))
        np.add.at(added, before, (1.0 - part) * self.changes[some])
        np.add.at(added, before + 1, part * self.changes[some])
        return added[:-1]
