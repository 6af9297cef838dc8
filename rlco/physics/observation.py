"""What a robot's sensors and camera would report of a scene, in a domain."""

from __future__ import annotations

import numpy as np

from rlco.physics.domain import Domain
from rlco.physics.rotations import rotation_vector, yaw_matrix
from rlco.physics.task import Array, SceneState, Task

# robosuite's Panda beside its table, world frame [m].
BASE_POSITION = np.array([-0.56, 0.0, 0.912])
# Tool rotation when the hand points straight down: the zero of reported rotation.
TOOL_DOWN = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# What `state` holds: tool pose in the frame of the robot's base, [m] and [rad],
# and the distance between the fingers [m].
STATE_NAMES = (
    "tool.x",
    "tool.y",
    "tool.z",
    "tool.rx",
    "tool.ry",
    "tool.rz",
    "gripper.opening",
)
# What an action holds, each in [-1, 1]: delta tool pose, at most 5 cm and 0.5 rad a
# control step, and the gripper: positive closes, negative opens.
ACTION_NAMES = (
    "tool.dx",
    "tool.dy",
    "tool.dz",
    "tool.drx",
    "tool.dry",
    "tool.drz",
    "gripper",
)


def noise_size(task: Task) -> int:
    """Return how many standard normal numbers one observation takes."""
    return 3 + 3 * (len(task.objects) + len(task.fixtures) + len(task.goals))


def observe(
    task: Task, domain: Domain, state: SceneState, noise: Array
) -> tuple[Array, Array]:
    """Return what is reported of a scene.

    Args:
        task: The task.
        domain: Whose sensors and camera report.
        state: The true state, leading axes (...).
        noise: Standard normal numbers, shape (..., `noise_size(task)`).

    Returns:
        The robot's state, shape (..., 7), named by `STATE_NAMES`, and the
        environment's state, shape (..., E), named by the task, [m].
    """
    tool = state.tool_position - BASE_POSITION + domain.state_noise * noise[..., :3]
    tool[..., 2] += domain.tool_offset
    turn = rotation_vector(state.tool_rotation @ TOOL_DOWN.T)
    opening = state.gripper_opening[..., None] + domain.gripper_offset
    robot = np.concatenate([tool, turn, opening], axis=-1)

    lead = state.tool_position.shape[:-1]
    seen = np.concatenate([state.object_position, state.goal_position], axis=-2)
    seen = seen.copy()
    # The camera looks at the table's centre, so its frame turns about that point.
    seen[..., :2] = seen[..., :2] @ yaw_matrix(domain.camera_yaw).T
    seen[..., :2] += domain.camera_shift
    seen += domain.object_noise * noise[..., 3:].reshape(*lead, -1, 3) - BASE_POSITION
    count = len(task.objects) + len(task.fixtures)
    return robot, task.environment_state(seen[..., :count, :], seen[..., count:, :])
