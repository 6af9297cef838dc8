"""Close Drawer: push the open drawer of a table-top cabinet shut.

The cabinet stands in front of the robot, slightly rotated, its drawer 7 to 12 cm open.
The robot starts above the table with closed fingers. Solved where the drawer is at most
1 cm open (arXiv 2602.12628, its task "close drawer"; thresholds of the paper are
unpublished).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rlco.physics.spec.task import Array, InitialState, SceneState, Task
from rlco.physics.tasks import cabinet
from rlco.physics.tasks.scripted import ramp, tool_action
from rlco.physics.tasks.variations import VARIATIONS

OPENINGS = (0.07, 0.12)  # of the drawer at the start [m]
SOLVED = 0.01  # opening at which the task is solved [m]

# Tool positions of the expert, heights relative to the handle's middle [m].
PUSH_HEIGHT = 0.0
TRAVEL_HEIGHT = 0.045  # fingertips pass over the handle
STANDOFF = 0.045  # tool in front of the handle before contact, 2 cm at contact


def sample(rng: np.random.Generator, variation: str | None = None) -> InitialState:
    """Draw the initial state of an episode.

    Raises:
        UnknownNameError: If the variation is unknown.
    """
    return cabinet.sample(rng, OPENINGS, variation)


def success(state: SceneState) -> NDArray[np.bool_]:
    """Return whether the drawer is closed."""
    solved: NDArray[np.bool_] = cabinet.opening(state) <= SOLVED
    return solved


def height(state: SceneState) -> Array:
    """Return the tool's height above the one for pushing, shape (...), [m]."""
    above: Array = (state.tool_position - cabinet.handle(state))[..., 2] - PUSH_HEIGHT
    return above


def astray(state: SceneState) -> Array:
    """Return the tool's distance, in the plane, to the corridor before the handle [m].

    The corridor is 4 cm wide and extends from the handle to where pushing starts.
    """
    outside, side = cabinet.from_handle(state)
    along = outside - np.clip(outside, 0.012, STANDOFF)
    across = side - np.clip(side, -0.02, 0.02)
    away: Array = np.sqrt(along**2 + across**2)
    return away


def shaped_reward(before: SceneState, after: SceneState) -> Array:
    """Return 10/m of closing, 4/m of the tool's progress, and 0.05 at the goal.

    The tool's progress is towards its position before the handle. The first two terms
    are differences of a potential, so nothing is gained by moving to and fro. The last
    rewards arriving early and staying.
    """

    def potential(state: SceneState) -> Array:
        opening = cabinet.opening(state)
        # Once the drawer is closed the tool may move anywhere.
        wanted = ramp(opening, SOLVED, SOLVED + 0.02)
        tool = np.sqrt(astray(state) ** 2 + height(state) ** 2)
        value: Array = -10.0 * opening - 4.0 * wanted * tool
        return value

    return potential(after) - potential(before) + 0.05 * success(after)


def expert(state: SceneState) -> Array:
    """Return the scripted expert's action from the true state, shape (..., A).

    It has no memory and no hard switches: it glides down in front of the handle, and
    pushes harder the better it is positioned.
    """
    outside, side = (part[..., None] for part in cabinet.from_handle(state))
    outward = cabinet.outward(state)
    sideward = np.stack([-outward[..., 1], outward[..., 0]], axis=-1)
    away, above = astray(state)[..., None], height(state)[..., None]

    placed = ramp(np.abs(above), 0.02, 0.01) * ramp(away, 0.012, 0.004)
    opening = cabinet.opening(state)[..., None]
    push = -np.clip(opening, 0.0, 0.03) * outward - 0.5 * side * sideward
    travel = 0.6 * ((STANDOFF - 0.01 - outside) * outward - side * sideward)
    plane = placed * push + (1.0 - placed) * travel
    # High where it still has to travel, low once it is before the handle.
    rise = ramp(away, 0.015, 0.035)
    up = rise * (TRAVEL_HEIGHT - PUSH_HEIGHT) - above
    # Too low to travel: rise first, to avoid hitting the handle.
    plane = plane * (1.0 - 0.95 * ramp(up, 0.0, 0.03))
    return tool_action(state, np.concatenate([plane, up], axis=-1), gripper=1.0)


TASK = Task(
    name="close_drawer",
    instructions=("close the drawer",),
    horizon=120,
    training_horizon=48,  # see docs/tasks.md
    control_frequency=20,
    objects=(),
    goals=("cabinet",),
    fixtures=("cabinet_drawer",),
    fixture_joints=("cabinet_slide",),
    environment_state_names=("handle.x", "handle.y", "cabinet.x", "cabinet.y"),
    make_objects=cabinet.make_objects,
    table_friction=cabinet.table_friction,
    sample=sample,
    environment_state=cabinet.environment_state,
    shaped_reward=shaped_reward,
    success=success,
    expert=expert,
    variations=VARIATIONS,
)
