"""Which columns of a log are angles, and what the model says of them."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.gap.logs.log import Array, Log
from rlco.physics.effects.targets import actuated_joint, is_servo

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Angular:
    """The columns that are angles.

    Attributes:
        joints: Joints that are hinges, (joints,).
        commands: Actuators that are sent an angle, (actuators,).
        pairs: Of each such actuator whose hinge is logged: the two columns.
        turning: Hinges that may turn round and round, as wheels do, (joints,).
        low: Lower end of each joint's range, (joints,) [rad].
        high: Upper end.
    """

    joints: Mask
    commands: Mask
    pairs: tuple[tuple[int, int], ...]
    turning: Mask
    low: Array
    high: Array


def angular_columns(log: Log, model: mujoco.MjModel | None) -> Angular:
    """Return a log's angles; without a model all positions and commands are."""
    if model is None:
        return _all_of(log)
    ids = [model.joint(name).id for name in log.joints]
    limited = model.jnt_limited[ids].astype(bool)
    hinges = [_hinge_of(model, name) for name in log.actuators]
    servos = [
        hinge is not None and is_servo(model, model.actuator(name).id)
        for hinge, name in zip(hinges, log.actuators, strict=True)
    ]
    spun = [
        hinge
        for hinge, name in zip(hinges, log.actuators, strict=True)
        if hinge is not None and _sets_speed(model, name)
    ]
    return Angular(
        joints=model.jnt_type[ids] == mujoco.mjtJoint.mjJNT_HINGE,
        commands=np.array(servos, dtype=np.bool_),
        pairs=tuple(
            (log.joints.index(hinge), column)
            for column, hinge in enumerate(hinges)
            if servos[column] and hinge in log.joints
        ),
        turning=np.array([name in spun for name in log.joints], dtype=np.bool_),
        low=np.where(limited, model.jnt_range[ids, 0], -np.inf),
        high=np.where(limited, model.jnt_range[ids, 1], np.inf),
    )


def _all_of(log: Log) -> Angular:
    count = len(log.joints)
    pairs = [
        (log.joints.index(name), column)
        for column, name in enumerate(log.actuators)
        if name in log.joints
    ]
    return Angular(
        joints=np.ones(count, dtype=np.bool_),
        commands=np.ones(len(log.actuators), dtype=np.bool_),
        pairs=tuple(pairs),
        turning=np.zeros(count, dtype=np.bool_),
        low=np.full(count, -np.inf),
        high=np.full(count, np.inf),
    )


def _hinge_of(model: mujoco.MjModel, actuator: str) -> str | None:
    """Return the hinge that an actuator drives; None if it is of no model, or none."""
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, actuator)
    joint = None if number < 0 else actuated_joint(model, number)
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    return joint if joint and model.joint(joint).type[0] == hinge else None


def _sets_speed(model: mujoco.MjModel, actuator: str) -> bool:
    bias = model.actuator_biasprm[model.actuator(actuator).id]
    return bool(bias[1] == 0 and bias[2] < 0)
