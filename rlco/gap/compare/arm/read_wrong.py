"""What an encoder reads too much in a recording, and what its servo is driven to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rlco.gap.compare.segments import command_steps
from rlco.gap.logs.log import Array, Recording

_NEAR = 1e-4  # of a position, for the slope of an error there [rad or m]


@dataclass(frozen=True)
class ReadWrong:
    """The error of an encoder along a recording.

    Attributes:
        at_rows: In each row, (T,) [rad or m].
        at_steps: At each physics step of the commands, (steps,) [rad or m].
        slope: How much it grows with what is read, in each row, (T,). Residuals stay
            in what is read, by 1 / (1 - slope): otherwise a large error, which makes
            all positions small, would make residuals small, too.
    """

    at_rows: Array
    at_steps: Array
    slope: Array


def read_wrong(
    recording: Recording, column: int, error: Callable[[Array], Array], step: float
) -> ReadWrong:
    """Return an error along a recording.

    Args:
        recording: The recording.
        column: Of the joint.
        error: What is read too much [rad or m] where some positions are read, (T,) to
            (T,).
        step: Of the physics [s].
    """
    read = np.asarray(recording.position, dtype=float)[:, column]
    path = np.interp(command_steps(recording, step), recording.time, read)
    slope = (error(read + _NEAR) - error(read - _NEAR)) / (2.0 * _NEAR)
    return ReadWrong(error(read), error(path), slope)
