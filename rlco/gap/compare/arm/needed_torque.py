"""Torque that a motion requires, and the torque limits at which it would saturate."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from rlco.gap.logs.log import Array
from rlco.physics.effects.targets import actuator_of, command_at, dof_of

# A limit shows only below the required torque, and a joint with far too little torque
# falls whatever else it does. Initial limits are therefore spaced closely enough for a
# fit to converge.
_CLOSE = 1.4
_MOST = 8


def servo_torque(
    model: mujoco.MjModel,
    joints: Sequence[str],
    command: Array,
    position: Array,
    velocity: Array,
) -> Array:
    """Return the torque of the joints' actuators by their own law, without any limit.

    Args:
        model: The robot.
        joints: Names of the columns.
        command: Of a servo, where its joint shall be, (T, joints) [rad or m].
        position: (T, joints) [rad or m].
        velocity: (T, joints) [rad/s or m/s].

    Returns:
        (T, joints) [N m or N]; zero where a joint has no actuator.
    """
    torque = np.zeros_like(position)
    for column, name in enumerate(joints):
        actuator = actuator_of(model, name)
        if actuator < 0:
            continue
        gear, bias = model.actuator_gear[actuator, 0], model.actuator_biasprm[actuator]
        gain = model.actuator_gainprm[actuator, 0] * command_at(model, actuator)
        torque[:, column] = (
            gain * command[:, column]
            + bias[0]
            + gear * bias[1] * position[:, column]
            + gear * bias[2] * velocity[:, column]
        )
    return torque


def limits(torque: Array) -> tuple[float, ...]:
    """Return limits from just below the largest torque down to the usual torque.

    Args:
        torque: Absolute required torque, (T,).

    Example:
        >>> [round(limit, 2) for limit in limits(np.array([1.0, 1.0, 1.0, 2.0]))]
        [1.79, 1.36, 1.04, 0.79, 0.6]
        >>> limits(np.r_[np.zeros(999), 2.0])[0]  # a single short pulse
        1.8
    """
    high = 0.9 * float(np.quantile(torque, 0.995) or torque.max())
    low = max(0.6 * float(np.median(torque)), 0.08 * high)
    count = int(np.ceil(np.log(high / low) / np.log(_CLOSE))) + 1
    return tuple(np.geomspace(high, low, min(max(count, 2), _MOST)).tolist())


def static_torque(
    model: mujoco.MjModel, joints: Sequence[str], position: Array
) -> Array:
    """Return the torque that holds the joints against gravity.

    Args:
        model: The robot.
        joints: Names of the columns.
        position: (T, joints) [rad or m].

    Returns:
        (T, joints) [N m or N].
    """
    data, torque = mujoco.MjData(model), np.empty(np.shape(position))
    places = [model.joint(name).qposadr[0] for name in joints]
    dofs = [dof_of(model, name) for name in joints]
    for row, values in enumerate(position):
        data.qpos[places] = values
        mujoco.mj_forward(model, data)
        torque[row] = data.qfrc_bias[dofs]
    return torque
