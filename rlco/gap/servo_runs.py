"""What was sent to a servo, at each physics step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rlco.errors import DataError
from rlco.gap.log import Array, Recording
from rlco.gap.servo_kernel import Runs


def run_of(recording: Recording, step: float, duty_gain: float) -> Runs:
    """Return what was sent in a recording, held from each row to the next.

    Args:
        recording: With ``kp`` among its facts.
        step: Physics step [s].
        duty_gain: Duty for each radian of error and unit of ``kp`` [1/rad].

    Raises:
        DataError: If a channel is missing.
    """
    missing = [
        name
        for name, found in (
            ("positions", recording.position),
            ("commands", recording.command),
            ("kp", recording.facts.get("kp")),
        )
        if found is None
    ]
    if missing:
        raise DataError(
            f"{recording.name} lacks {' and '.join(missing)}: a servo bench needs "
            "positions, commands and the firmware's kp."
        )
    position = np.asarray(recording.position, dtype=float)
    place = (recording.time - recording.time[0]) / step
    near = np.round(place)
    place = np.where(np.abs(place - near) < 1e-6, near, place)
    steps = np.arange(int(np.ceil(place[-1])) + 1)
    row = np.searchsorted(place, steps, side="right") - 1
    speed = 0.0 if recording.velocity is None else recording.velocity[0, 0]
    return Runs(
        np.array([0, len(steps)]),
        np.asarray(recording.command, dtype=float)[row, 0],
        enabled(recording)[row],
        np.array([duty_gain * recording.facts["kp"]]),
        np.array([[position[0, 0], speed]]),
        place,
    )


def enabled(recording: Recording) -> NDArray[np.bool_]:
    """Return in which rows the drive was on, (T,)."""
    return recording.extra.get("torque_enable", np.ones(recording.rows)) > 0.5


def joined(runs: Sequence[Runs]) -> Runs:
    """Return runs one after the other."""
    first = np.cumsum([0] + [len(run.goal) for run in runs])
    return Runs(
        first,
        np.concatenate([run.goal for run in runs]),
        np.concatenate([run.enabled for run in runs]),
        np.concatenate([run.gain for run in runs]),
        np.concatenate([run.start for run in runs]),
        np.concatenate([a + run.place for a, run in zip(first, runs, strict=False)]),
    )


def at_rows(track: Array, place: Array) -> Array:
    """Interpolate what is known at each step to the logged rows, (rows,)."""
    before = place.astype(np.int64)
    after = np.minimum(before + 1, len(track) - 1)
    rows: Array = track[before] + (place - before) * (track[after] - track[before])
    return rows
