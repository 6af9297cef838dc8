"""Initial velocity of a flying body, estimated from its first poses."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.gap.logs.log import Array

# Rows and seconds that the initial velocity is estimated from.
FIRST_ROWS, FIRST_SECONDS = 4, 0.1


def first_velocity(time: Array, pose: Array, gravity: Array) -> Array:
    """Estimate a flying body's velocity in the first row from its first poses.

    Args:
        time: (T,) [s].
        pose: Position and quaternion (w, x, y, z), (T, 7) [m].
        gravity: (3,) [m/s^2].

    Returns:
        Linear in the world frame [m/s], then angular in the body frame [rad/s], (6,).

    Example:
        >>> time = np.arange(5) * 0.01
        >>> pose = np.zeros((5, 7))
        >>> pose[:, 0] = 2.0 * time
        >>> pose[:, 3], pose[:, 6] = np.cos(1.5 * time), np.sin(1.5 * time)
        >>> first_velocity(time, pose, np.zeros(3)).round(6)
        array([2., 0., 0., 0., 0., 3.])
    """
    rows = max(FIRST_ROWS, int(np.searchsorted(time, time[0] + FIRST_SECONDS)))
    passed = time[:rows] - time[0]
    straight = pose[:rows, :3] - 0.5 * gravity * passed[:, None] ** 2
    turned = np.zeros((rows, 3))
    for row in range(rows):
        mujoco.mju_subQuat(turned[row], pose[row, 3:], pose[0, 3:])
    return np.concatenate(
        [np.polyfit(passed, straight, 1)[0], np.polyfit(passed, turned, 1)[0]]
    )
