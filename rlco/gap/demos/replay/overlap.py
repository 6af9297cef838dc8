"""Move objects out of a measured overlap with the robot."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.gap.logs.log import Array

_DEPTH = 2e-4  # penetration of pushing contacts in MuJoCo [m]
_ROUNDS = 4


def separate(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    objects: Iterable[int],
    robot: NDArray[np.bool_],
    free: NDArray[np.bool_],
) -> None:
    """Move free objects out of the robot, along the deepest contact.

    Two measurements, each a millimetre off, may place an object inside the finger that
    pushes it. The simulator would then eject it, farther with less friction. An object
    held from two sides stays.

    Args:
        model: The model.
        data: Its state; `qpos` of the objects is changed.
        objects: Address in `qpos` of each object's free joint.
        robot: Mask of the robot's geoms, (ngeom,).
        free: Which of each object's x, y, z may change, (objects, 3).

    Example:
        >>> model = mujoco.MjModel.from_xml_string(
        ...     "<mujoco><worldbody><geom name='tip' size='.1'/><body pos='.15 0 0'>"
        ...     "<freejoint/><geom size='.1' mass='1'/></body></worldbody></mujoco>")
        >>> data = mujoco.MjData(model)
        >>> separate(model, data, [0], np.array([True, False]), np.ones((1, 3), bool))
        >>> round(float(data.qpos[0]), 4)
        0.1998
    """
    for _ in range(_ROUNDS):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        moved = False
        for address, axes in zip(objects, free, strict=True):
            way = _way_out(model, data, address, robot)
            if way is not None:
                data.qpos[address : address + 3][axes] += way[axes]
                moved = True
        if not moved:
            return


def _way_out(
    model: mujoco.MjModel, data: mujoco.MjData, address: int, robot: NDArray[np.bool_]
) -> Array | None:
    """Return the shift that ends an object's deepest contact with the robot, [m]."""
    contact = data.contact
    body = model.jnt_bodyid[np.flatnonzero(model.jnt_qposadr == address)[0]]
    ours = model.body_rootid[model.geom_bodyid[contact.geom]] == body  # (contacts, 2)
    theirs = robot[contact.geom]
    sign = np.where(ours[:, 1] & theirs[:, 0], 1.0, -1.0)
    touching = (ours[:, 1] & theirs[:, 0]) | (ours[:, 0] & theirs[:, 1])
    deep = touching & (contact.dist < -_DEPTH)
    if not deep.any():
        return None
    # The first axis of a contact's frame is its normal, from the first geom to the
    # second.
    out = sign[deep, None] * contact.frame[deep, :3]
    depth = -contact.dist[deep] - _DEPTH
    deepest = int(depth.argmax())
    if (out @ out[deepest] < -0.5).any():
        return None
    return np.asarray(depth[deepest] * out[deepest] * 1.001)
