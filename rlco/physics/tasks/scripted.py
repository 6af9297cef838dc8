"""Action of a scripted expert for a motion of the tool."""

from __future__ import annotations

import numpy as np

from rlco.physics.mj.rotations import rotation_vector
from rlco.physics.spec.robot import GRIPPER, PANDA, POSITION, ROTATION, Robot
from rlco.physics.spec.task import Array, SceneState


def tool_action(
    state: SceneState, move: Array, gripper: Array | float, robot: Robot = PANDA
) -> Array:
    """Return the action that moves the tool and rotates it to point straight down.

    Args:
        state: The true state, leading axes (...).
        move: Motion relative to the tool's position, shape (..., 3), [m]; a motion
            longer than a control step allows keeps its direction.
        gripper: 1 closes, -1 opens, shape (...).
        robot: The robot.

    Returns:
        Shape (..., A), each value in [-1, 1].
    """
    action = np.zeros((*move.shape[:-1], len(robot.action_names)))
    share = move / robot.largest_move
    length = np.linalg.norm(share, axis=-1, keepdims=True)
    action[..., POSITION] = share / np.maximum(length, 1.0)
    turn = rotation_vector(state.tool_rotation @ robot.down.T)
    action[..., ROTATION] = -turn / robot.largest_turn
    action[..., GRIPPER] = gripper
    return np.clip(action, -1.0, 1.0)


def ramp(value: Array, start: float, end: float) -> Array:
    """Return 0 up to `start`, 1 from `end` on, and a linear ramp between.

    Example:
        >>> import numpy as np
        >>> ramp(np.array([0.0, 0.25, 2.0]), 0.0, 1.0).tolist()
        [0.0, 0.25, 1.0]
        >>> ramp(np.array([0.0, 0.25, 2.0]), 1.0, 0.0).tolist()
        [1.0, 0.75, 0.0]
    """
    share: Array = np.clip((value - start) / (end - start), 0.0, 1.0)
    return share
