"""What the tests of both drawer tasks share: scenes placed by hand."""

from __future__ import annotations

import numpy as np

from rlco.physics.spec.robot import PANDA
from rlco.physics.spec.task import SceneState


def drawer_scene(
    opening: float, outside: float, side: float, above: float, yaw: float = 0.0
) -> SceneState:
    """Place a cabinet at (0.2, 0), and the tool as seen from its handle [m].

    The closed handle is 15.1 cm before the cabinet's middle (10 + 4.5 + 0.6), and 8 cm
    above the table.
    """
    outward = np.array([-np.cos(yaw), -np.sin(yaw), 0.0])
    beside = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    cabinet = np.array([0.2, 0.0, 0.8])
    handle = cabinet + (0.151 + opening) * outward + np.array([0.0, 0.0, 0.08])
    up = np.array([0.0, 0.0, above])
    return SceneState(
        tool_position=handle + outside * outward + side * beside + up,
        tool_rotation=PANDA.down,
        gripper_opening=np.array(0.0),
        joint_position=np.zeros(7),
        object_position=handle[None],
        object_quaternion=np.array([[1.0, 0.0, 0.0, 0.0]]),
        joint_opening=np.array([opening]),
        goal_position=cabinet[None],
        goal_quaternion=np.array([[1.0, 0.0, 0.0, 0.0]]),
        instruction_id=np.array(0),
    )
