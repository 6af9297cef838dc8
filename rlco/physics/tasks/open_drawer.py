"""Open Drawer: pull the drawer of a table-top cabinet open by its handle.

The cabinet stands in front of the robot, slightly rotated, its drawer closed or almost
closed. The robot starts above the table with closed fingers. Solved where the drawer is
8 cm open: wide enough for a hand to reach in (arXiv 2602.12628, its task "open
drawer"; thresholds of the paper are unpublished).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rlco.physics.spec.task import Array, InitialState, SceneState, Task
from rlco.physics.tasks import cabinet
from rlco.physics.tasks.scripted import ramp, tool_action
from rlco.physics.tasks.variations import VARIATIONS

OPENINGS = (0.0, 0.01)  # of the drawer at the start [m]
SOLVED = 0.08  # opening at which the task is solved [m]
WANTED = 0.11  # opening at which the expert stops pulling [m]

# Tool positions of the expert, heights relative to the handle's middle [m].
HOOK_HEIGHT = -0.003  # fingertips 8 mm lower still: well behind the bar
TRAVEL_HEIGHT = 0.045  # fingertips pass over the handle
# Outside of the handle's middle: a finger's width of clearance on either side [m].
SLOT = -(cabinet.HANDLE_RADIUS + cabinet.HANDLE_GAP / 2)
LEEWAY = 0.008


def sample(rng: np.random.Generator, variation: str | None = None) -> InitialState:
    """Draw the initial state of an episode.

    Raises:
        UnknownNameError: If the variation is unknown.
    """
    return cabinet.sample(rng, OPENINGS, variation)


def success(state: SceneState) -> NDArray[np.bool_]:
    """Return whether the drawer is open."""
    solved: NDArray[np.bool_] = cabinet.opening(state) >= SOLVED
    return solved


def height(state: SceneState) -> Array:
    """Return the tool's height above its position behind the handle, (...), [m]."""
    above: Array = (state.tool_position - cabinet.handle(state))[..., 2] - HOOK_HEIGHT
    return above


def astray(state: SceneState) -> Array:
    """Return the tool's distance, in the plane, to the slot behind the handle [m].

    It is narrow for a tool above the handle, and reaches the handle for one behind it.
    """
    outside, side = cabinet.from_handle(state)
    deep = ramp(height(state), 0.02, 0.01)
    outer = SLOT + LEEWAY + 0.012 * deep
    along = outside - np.clip(outside, SLOT - LEEWAY, outer)
    across = side - np.clip(side, -0.02, 0.02)
    away: Array = np.sqrt(along**2 + across**2)
    return away


def shaped_reward(before: SceneState, after: SceneState) -> Array:
    """Return 10/m of opening, 4/m of the tool's progress, and 0.05 at the goal.

    The tool's progress is towards its position behind the handle. The first two terms
    are differences of a potential, so nothing is gained by moving to and fro. The last
    rewards arriving early and staying.
    """

    def potential(state: SceneState) -> Array:
        missing = np.maximum(WANTED - cabinet.opening(state), 0.0)
        # Once the drawer is open the tool may move anywhere.
        wanted = ramp(missing, WANTED - SOLVED, WANTED - SOLVED + 0.02)
        above = np.maximum(height(state), 0.0)
        tool = np.sqrt(astray(state) ** 2 + above**2)
        value: Array = -10.0 * missing - 4.0 * wanted * tool
        return value

    return potential(after) - potential(before) + 0.05 * success(after)


def expert(state: SceneState) -> Array:
    """Return the scripted expert's action from the true state, shape (..., A).

    It has no memory and no hard switches: it glides above the slot behind the handle,
    down into it, and pulls harder the deeper it is hooked.
    """
    outside, side = (part[..., None] for part in cabinet.from_handle(state))
    outward = cabinet.outward(state)
    sideward = np.stack([-outward[..., 1], outward[..., 0]], axis=-1)
    away, above = astray(state)[..., None], height(state)[..., None]

    hooked = ramp(above, 0.016, 0.008) * ramp(away, 0.006, 0.002)
    missing = WANTED - cabinet.opening(state)[..., None]
    pull = np.clip(missing, -0.01, 0.03) * outward - 0.5 * side * sideward
    travel = 0.6 * ((SLOT - outside) * outward - side * sideward)
    plane = hooked * pull + (1.0 - hooked) * travel
    # High where it still has to travel, low once it is above the slot.
    rise = ramp(away, 0.003, 0.012)
    up = rise * (TRAVEL_HEIGHT - HOOK_HEIGHT) - above
    # Too low to travel: rise first, to avoid hitting the handle.
    plane = plane * (1.0 - 0.95 * ramp(up, 0.0, 0.03))
    return tool_action(state, np.concatenate([plane, up], axis=-1), gripper=1.0)


TASK = Task(
    name="open_drawer",
    instructions=("open the drawer",),
    horizon=120,
    training_horizon=60,  # see docs/tasks.md
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
