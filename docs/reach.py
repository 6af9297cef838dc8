"""Reach: bring the tool above the mark."""

from __future__ import annotations

import numpy as np

from rlco.physics.spec.domain import Domain
from rlco.physics.spec.task import Array, InitialState, SceneState, Task
from rlco.physics.tasks.push_cube import HOME, HOME_NOISE, TABLE_HEIGHT


def make_objects(domain: Domain, variation: str | None = None) -> list[object]:
    """Return robosuite's objects: tracked ones first, then marks."""
    from robosuite.models.objects import BoxObject, CylinderObject

    density = 500.0 * domain.mass_scale  # [kg/m^3]
    cube = BoxObject(name="cube", size=[0.025] * 3, density=density)
    mark = CylinderObject(
        name="mark", size=[0.03, 0.001], obj_type="visual", joints=None
    )
    return [cube, mark]


def table_friction(domain: Domain) -> tuple[float, float, float]:
    """Return the table's friction."""
    return (0.6 * domain.friction_scale, 5e-3, 1e-4)


def sample(rng: np.random.Generator, variation: str | None = None) -> InitialState:
    """Draw the start of an episode; there are no variations."""
    return InitialState(
        joint_position=HOME + rng.normal(0.0, HOME_NOISE, 7),
        object_pose=np.array([[0.2, 0.2, TABLE_HEIGHT + 0.025, 1.0, 0.0, 0.0, 0.0]]),
        goal_position=np.array([[*rng.uniform(-0.1, 0.1, 2), TABLE_HEIGHT]]),
        instruction_id=0,
    )


def environment_state(objects: Array, goals: Array) -> Array:
    """Return what is seen: x and y of the mark, shape (..., 2), [m]."""
    return goals[..., 0, :2]


def gap(state: SceneState) -> Array:
    """Return the vector from the tool to its goal, shape (..., 3), [m]."""
    goal = state.goal_position[..., 0, :] + np.array([0.0, 0.0, 0.1])
    return goal - state.tool_position


def success(state: SceneState) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return whether the tool is within 2 cm of its goal."""
    return np.linalg.norm(gap(state), axis=-1) < 0.02


def shaped_reward(before: SceneState, after: SceneState) -> Array:
    """Return 10 a metre of progress, and 0.05 at the goal."""
    far, near = (np.linalg.norm(gap(s), axis=-1) for s in (before, after))
    return 10.0 * (far - near) + 0.05 * success(after)


def expert(state: SceneState) -> Array:
    """Return the action, shape (..., 7): straight there, fingers closed."""
    action = np.zeros((*state.tool_position.shape[:-1], 7))
    action[..., :3] = np.clip(gap(state) / 0.05, -1.0, 1.0)
    action[..., 6] = 1.0
    return action


TASK = Task(
    name="reach",
    instructions=("reach for the mark",),
    horizon=60,
    control_frequency=20,
    objects=("cube",),
    goals=("mark",),
    environment_state_names=("mark.x", "mark.y"),
    make_objects=make_objects,
    table_friction=table_friction,
    sample=sample,
    environment_state=environment_state,
    shaped_reward=shaped_reward,
    success=success,
    expert=expert,
)
