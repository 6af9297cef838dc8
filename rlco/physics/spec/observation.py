"""Observations of a scene by a robot's sensors and camera, in a domain."""

from __future__ import annotations

import numpy as np

from rlco.physics.mj.rotations import rotation_vector, yaw_matrix
from rlco.physics.spec.domain import Domain
from rlco.physics.spec.task import Array, SceneState, Task


def noise_size(task: Task) -> int:
    """Return the number of standard normal samples that one observation takes."""
    return 3 + 3 * (len(task.objects) + len(task.fixtures) + len(task.goals))


def observe(
    task: Task, domain: Domain, state: SceneState, noise: Array
) -> tuple[Array, Array]:
    """Return the observation of a scene.

    Args:
        task: The task.
        domain: The domain, with its sensors and camera.
        state: The true state, leading axes (...).
        noise: Standard normal samples, shape (..., `noise_size(task)`).

    Returns:
        The robot's state, shape (..., S), and the environment's state, shape
        (..., E), [m], both named by the task.
    """
    sensors, base = domain.sensors, task.robot.base
    tool = state.tool_position - base + sensors.state_noise * noise[..., :3]
    tool[..., 2] += sensors.tool_offset
    turn = rotation_vector(state.tool_rotation @ task.robot.down.T)
    opening = state.gripper_opening[..., None] + sensors.gripper_offset
    robot = np.concatenate([tool, turn, opening], axis=-1)

    lead = state.tool_position.shape[:-1]
    observed = np.concatenate([state.object_position, state.goal_position], axis=-2)
    observed = observed.copy()
    # The camera looks at the table's centre, so its frame rotates about that point.
    observed[..., :2] = observed[..., :2] @ yaw_matrix(sensors.camera_yaw).T
    observed[..., :2] += sensors.camera_shift
    observed += sensors.object_noise * noise[..., 3:].reshape(*lead, -1, 3) - base
    count = len(task.objects) + len(task.fixtures)
    return robot, task.environment_state(
        observed[..., :count, :], observed[..., count:, :]
    )
