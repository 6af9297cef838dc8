"""Smooth positions, velocities and accelerations of an unevenly sampled recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rlco.errors import DataError
from rlco.gap.logs.log import Array, Recording

_DEGREE = 3


@dataclass(frozen=True)
class Motion:
    """Smoothed motion and torques of recordings, without their inaccurate ends.

    Attributes:
        time: Of the retained rows, (rows,) [s].
        position: (rows, joints) [rad].
        velocity: (rows, joints) [rad/s].
        acceleration: (rows, joints) [rad/s^2].
        torque: As measured, (rows, joints) [N m].
        recordings: Rows of each recording.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    torque: Array
    recordings: tuple[slice, ...]


def smooth_motion(
    time: Array, position: Array, window: float
) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration by local cubics.

    A cubic is fitted to the rows around each row by least squares. This is the filter
    of Savitzky and Golay for times that need not be even.

    Args:
        time: Increasing, (T,) [s].
        position: (T, joints) [rad or m].
        window: Width of each fit [s]; at least seven rows are used.

    Returns:
        Three arrays (T, joints).

    Example:
        >>> time = np.linspace(0.0, 1.0, 41)
        >>> _, velocity, acceleration = smooth_motion(time, time[:, None] ** 3, 0.3)
        >>> np.allclose(velocity[:, 0], 3 * time**2), np.allclose(
        ...     acceleration[:, 0], 6 * time)
        (True, True)
    """
    period = float(np.median(np.diff(time)))
    half = rows_of(window, period)
    half = min(half, (len(time) - 1) // 2)
    middle = np.clip(np.arange(len(time)), half, len(time) - 1 - half)
    rows = middle[:, None] + np.arange(-half, half + 1)
    # Scaled by the window: powers of small times would be ill conditioned.
    scale = half * period
    away = (time[rows] - time[:, None]) / scale
    powers = away[..., None] ** np.arange(_DEGREE + 1)
    weights = np.linalg.pinv(powers)
    found = np.einsum("tpw,twj->ptj", weights, position[rows])
    return found[0], found[1] / scale, 2.0 * found[2] / scale**2


def rows_of(window: float, period: float) -> int:
    """Return the rows on each side that a window reaches, at least three."""
    return max(3, round(0.5 * window / period))


def smoothed(recording: Recording, window: float) -> Motion:
    """Return a recording's motion by local cubics over `window` seconds.

    Raises:
        DataError: If positions or torques are missing, or it is too short.
    """
    if recording.position is None or recording.torque is None:
        message = f"{recording.name} has no positions or no torques: "
        raise DataError(message + "inverse dynamics need both; give a log with both.")
    # Rows whose window reaches beyond an end have poorer derivatives.
    inside = (recording.time - recording.time[0] >= 0.5 * window) & (
        recording.time[-1] - recording.time >= 0.5 * window
    )
    if recording.rows < 8 or not inside.any():
        message = f"{recording.name} lasts {recording.seconds:.2f} s: "
        raise DataError(
            message + f"accelerations need more than {window} s; give longer ones."
        )
    parts = smooth_motion(recording.time, recording.position, window)
    position, velocity, acceleration = (part[inside] for part in parts)
    return Motion(
        recording.time[inside],
        position,
        velocity,
        acceleration,
        recording.torque[inside],
        (slice(0, int(inside.sum())),),
    )


def joined(motions: Sequence[Motion]) -> Motion:
    """Concatenate several motions."""
    ends = np.cumsum([0] + [len(motion.time) for motion in motions])

    def all_of(name: str) -> Array:
        return np.concatenate([getattr(motion, name) for motion in motions])

    return Motion(
        all_of("time"),
        all_of("position"),
        all_of("velocity"),
        all_of("acceleration"),
        all_of("torque"),
        tuple(slice(int(a), int(b)) for a, b in pairwise(ends)),
    )
