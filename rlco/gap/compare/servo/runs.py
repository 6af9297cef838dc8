"""The commands of a servo at each physics step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rlco.errors import DataError
from rlco.gap.compare.servo.kernel import Runs
from rlco.gap.compare.wording import listed
from rlco.gap.logs.log import Array, Recording
from rlco.gap.servo_models import Pendulum

#: Facts that a recording's header must give.
FACTS = ("mass", "length", "vin", "kp")


def run_of(recording: Recording, step: float, duty_gain: float) -> Runs:
    """Return the commands of a recording, each held until the next row.

    Args:
        recording: With `FACTS` among its facts.
        step: Physics step [s].
        duty_gain: Duty per radian of error and unit of ``kp`` [1/rad].

    Raises:
        DataError: If a channel or a fact is missing, or a fact is not above 0.
    """
    missing = [
        name
        for name, found in (
            ("positions", recording.position),
            ("commands", recording.command),
            *((name, recording.facts.get(name)) for name in FACTS),
        )
        if found is None
    ]
    if missing:
        raise DataError(
            f"{recording.name} lacks {listed(missing)}: a servo on its bench needs "
            "positions and commands, and mass, length, vin and kp in the header, as "
            "BAM's JSON has them; give such recordings, or an MJCF file as model=."
        )
    for name in FACTS:
        if not recording.facts[name] > 0.0:
            raise DataError(
                f"{name} of {recording.name} is {recording.facts[name]:g}: correct it "
                "in the file's header, it must be above 0."
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


def pendulum_of(recording: Recording) -> Pendulum:
    """Return the pendulum of a recording.

    Example:
        >>> facts = {"mass": 0.5, "length": 0.1, "vin": 7.4, "kp": 200.0}
        >>> pendulum_of(Recording("run", np.arange(2.0), facts=facts))
        Pendulum(mass=0.5, length=0.1, volts=7.4, arm_mass=0.0)
    """
    facts = recording.facts
    arm_mass = facts.get("arm_mass", 0.0)
    return Pendulum(facts["mass"], facts["length"], facts["vin"], arm_mass)


def enabled(recording: Recording) -> NDArray[np.bool_]:
    """Return the rows in which the drive was on, (T,)."""
    return recording.extra.get("torque_enable", np.ones(recording.rows)) > 0.5


def joined(runs: Sequence[Runs]) -> Runs:
    """Concatenate runs."""
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
    """Interpolate values at each step to the logged rows, (rows,)."""
    before = place.astype(np.int64)
    after = np.minimum(before + 1, len(track) - 1)
    rows: Array = track[before] + (place - before) * (track[after] - track[before])
    return rows
