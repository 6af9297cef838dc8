"""What scripted experts share: an action from where the tool should move."""

from __future__ import annotations

import numpy as np

from rlco.physics.observation import TOOL_DOWN
from rlco.physics.rotations import rotation_vector
from rlco.physics.task import Array, SceneState

STEP = 0.05  # largest commanded move of the tool in a control step [m]
TURN = 0.5  # and its largest turn [rad]


def tool_action(state: SceneState, move: Array, gripper: Array | float) -> Array:
    """Return the action that moves the tool and turns it to point straight down.

    Args:
        state: The true state, leading axes (...).
        move: Where to, from where the tool is, shape (..., 3), [m]; a longer move
            than a control step allows keeps its direction.
        gripper: 1 closes, -1 opens, shape (...).

    Returns:
        Shape (..., 7), each number in [-1, 1].
    """
    action = np.zeros((*move.shape[:-1], 7))
    share = move / STEP
    length = np.linalg.norm(share, axis=-1, keepdims=True)
    action[..., :3] = share / np.maximum(length, 1.0)
    action[..., 3:6] = -rotation_vector(state.tool_rotation @ TOOL_DOWN.T) / TURN
    action[..., 6] = gripper
    return np.clip(action, -1.0, 1.0)


def ramp(value: Array, start: float, end: float) -> Array:
    """Return 0 up to `start`, 1 from `end` on, and a straight line between.

    Example:
        >>> import numpy as np
        >>> ramp(np.array([0.0, 0.25, 2.0]), 0.0, 1.0).tolist()
        [0.0, 0.25, 1.0]
        >>> ramp(np.array([0.0, 0.25, 2.0]), 1.0, 0.0).tolist()
        [1.0, 0.75, 0.0]
    """
    share: Array = np.clip((value - start) / (end - start), 0.0, 1.0)
    return share
