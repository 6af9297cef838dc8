"""Push Cube via Instruction: push the named cube onto the mark of its colour.

Three cubes stand in a row across the table, their colours in random order, each
with a flat mark of its colour 13 to 18 cm further on. The robot starts behind
the row with closed fingers. Solved where the named cube's centre lies within
3 cm of its mark; the other cubes do not matter (arXiv 2602.12628, its task "push
cube"; thresholds of the paper are unpublished).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rlco.physics.spec.domain import Domain
from rlco.physics.spec.task import Array, InitialState, SceneState, Task
from rlco.physics.tasks.scripted import tool_action
from rlco.physics.tasks.variations import (
    JOINT_NOISE,
    UNSEEN_COLOURS,
    VARIATIONS,
    add_distractors,
    check_variation,
    make_distractors,
)

COLOURS = {
    "red": (0.85, 0.16, 0.14, 1.0),
    "green": (0.16, 0.62, 0.27, 1.0),
    "blue": (0.15, 0.34, 0.80, 1.0),
}
# Positions of distractors, beside the row [m].
PLACES = (((-0.1, 0.1), (0.26, 0.32)), ((-0.1, 0.1), (-0.32, -0.26)))
TABLE_HEIGHT = 0.8  # robosuite's table top [m]
HALF_SIZE = 0.025  # of a cube [m]
MASS = 0.06  # a 5 cm pine cube [kg]
FRICTION = (0.6, 5e-3, 1e-4)  # wood on laminate: sliding, torsional, rolling
TOLERANCE = 0.03  # of success [m]

# Tool 8 cm above the table behind the row, pointing down, fingers across x.
HOME = np.array([0.0, 0.51, 0.0, -2.777, 0.0, 3.288, 0.786])
HOME_NOISE = 0.02  # standard deviation of each joint at the start [rad]

# Tool positions of the expert [m].
PUSH_HEIGHT = TABLE_HEIGHT + 0.025
TRAVEL_HEIGHT = TABLE_HEIGHT + 0.085
STANDOFF = 0.055  # tool behind the cube's centre before contact


def make_objects(domain: Domain, variation: str | None = None) -> list[object]:
    """Return robosuite's three cubes, their three marks, and what the variation adds.

    ``shapes`` replaces the cubes by upright cylinders of the same width and height.

    Raises:
        UnknownNameError: If the variation is unknown.
    """
    check_variation(variation)
    # Importing robosuite takes seconds; rules and expert do not need it.
    from rlco.physics.robosuite.robosuite_api import BoxObject, CylinderObject

    colours = UNSEEN_COLOURS if variation == "colours" else COLOURS
    round_ones = variation == "shapes"
    volume = (2 * HALF_SIZE) ** 3 * (np.pi / 4 if round_ones else 1.0)
    cubes = [
        BoxObject(
            name=f"{name}_cube",
            size=[HALF_SIZE] * 3,
            rgba=rgba,
            density=MASS * domain.mass_scale / volume,
            friction=(FRICTION[0] * domain.friction_scale, *FRICTION[1:]),
        )
        for name, rgba in colours.items()
    ]
    for cube in cubes:
        for geom in cube.get_obj().iter("geom"):
            # Its own friction applies, not that of robosuite's rubber finger pads.
            geom.set("priority", "1")
            if round_ones:
                # robosuite's own cylinder would have other contact parameters, too.
                geom.set("type", "cylinder")
                geom.set("size", f"{HALF_SIZE} {HALF_SIZE}")
    marks = [
        CylinderObject(
            name=f"{name}_mark",
            size=[TOLERANCE, 0.001],
            rgba=(*rgba[:3], 0.6),
            obj_type="visual",
            joints=None,
        )
        for name, rgba in colours.items()
    ]
    added = make_distractors() if variation == "distractors" else []
    return [*cubes, *marks, *added]


def table_friction(domain: Domain) -> tuple[float, float, float]:
    """Return the table's friction; MuJoCo uses the larger of two touching geoms."""
    return (FRICTION[0] * domain.friction_scale, FRICTION[1], FRICTION[2])


def sample(rng: np.random.Generator, variation: str | None = None) -> InitialState:
    """Draw the initial state of an episode.

    Raises:
        UnknownNameError: If the variation is unknown.
    """
    check_variation(variation)
    slots = rng.permutation(3)
    cubes = np.zeros((3, 7))
    cubes[:, 0] = rng.uniform(-0.10, -0.05, 3)
    cubes[:, 1] = (slots - 1) * 0.14 + rng.uniform(-0.02, 0.02, 3)
    cubes[:, 2] = TABLE_HEIGHT + HALF_SIZE
    yaw = rng.uniform(-0.1, 0.1, 3)
    cubes[:, 3], cubes[:, 6] = np.cos(yaw / 2), np.sin(yaw / 2)
    marks = cubes[:, :3].copy()
    marks[:, 0] += rng.uniform(0.13, 0.18, 3)
    marks[:, 1] += rng.uniform(-0.01, 0.01, 3)
    marks[:, 2] = TABLE_HEIGHT + 0.001
    noise = HOME_NOISE
    if variation == "initial_states":
        # The whole row farther away than in training, and more noise on the arm.
        cubes[:, 0] += 0.06
        marks[:, 0] += 0.06
        noise = JOINT_NOISE
    start = InitialState(
        joint_position=HOME + rng.normal(0.0, noise, HOME.size),
        object_pose=cubes,
        goal_position=marks,
        instruction_id=int(rng.integers(3)),
    )
    if variation == "distractors":
        return add_distractors(start, rng, PLACES)
    return start


def environment_state(objects: Array, goals: Array) -> Array:
    """Return x and y of each cube, then of each mark, shape (..., 12), [m]."""
    both = np.concatenate([objects, goals], axis=-2)[..., :2]
    return both.reshape(*both.shape[:-2], -1)


def named(state: SceneState, positions: Array) -> Array:
    """Select the named cube's row: (..., 3, 3) -> (..., 3)."""
    index = state.instruction_id[..., None, None]
    row: Array = np.take_along_axis(positions, index, axis=-2)[..., 0, :]
    return row


def distance(state: SceneState) -> Array:
    """Return the named cube's distance to its mark, in the plane [m]."""
    gap = named(state, state.object_position) - named(state, state.goal_position)
    length: Array = np.linalg.norm(gap[..., :2], axis=-1)
    return length


def success(state: SceneState) -> NDArray[np.bool_]:
    """Return whether the named cube lies on its mark, on the table."""
    height = named(state, state.object_position)[..., 2] - TABLE_HEIGHT
    return (distance(state) < TOLERANCE) & (np.abs(height - HALF_SIZE) < 0.01)


def shaped_reward(before: SceneState, after: SceneState) -> Array:
    """Return 10/m of the cube's progress, 4/m of the tool's, and 0.05 at the goal.

    The tool's progress is towards the corridor behind the named cube, from which
    pushing succeeds. The first two terms are differences of a potential, so nothing is
    gained by moving to and fro. The last rewards arriving early and staying.
    """

    def potential(state: SceneState) -> Array:
        gap = distance(state)
        # At the mark the direction of pushing, and so the corridor, is undefined.
        wanted = np.clip((gap - 0.01) / 0.02, 0.0, 1.0)
        value: Array = -10.0 * gap - 4.0 * wanted * astray(state)
        return value

    return potential(after) - potential(before) + 0.05 * success(after)


def placing(state: SceneState) -> tuple[Array, Array]:
    """Return the tool's position relative to the named cube and its mark [m].

    Returns:
        Its distance ahead of the cube (negative: behind) and beside the line through
        both, each shape (...).
    """
    offset = state.tool_position - named(state, state.object_position)
    forward = push_direction(state)
    along: Array = (offset[..., :2] * forward).sum(-1)
    across = offset[..., :2] - along[..., None] * forward
    return along, np.linalg.norm(across, axis=-1)


def astray(state: SceneState) -> Array:
    """Return the tool's distance to the corridor behind the named cube [m]."""
    along, sideways = placing(state)
    short = np.maximum(-STANDOFF - along, 0.0)
    past = np.maximum(along + 0.02, 0.0)
    away: Array = np.sqrt(sideways**2 + short**2 + past**2)
    return away


def push_direction(state: SceneState) -> Array:
    """Return the unit vector from the named cube to its mark, (..., 2)."""
    gap = named(state, state.goal_position) - named(state, state.object_position)
    length = np.linalg.norm(gap[..., :2], axis=-1, keepdims=True)
    direction: Array = gap[..., :2] / np.maximum(length, 1e-9)
    return direction


def push_start(state: SceneState) -> Array:
    """Return the position behind the named cube where pushing starts, (..., 3), [m]."""
    start = named(state, state.object_position).copy()
    start[..., :2] -= STANDOFF * push_direction(state)
    return start


def expert(state: SceneState) -> Array:
    """Return the scripted expert's action from the true state, shape (..., A).

    It has no memory and no hard switches: it glides down behind the cube and pushes
    harder the better it is positioned, so that its demonstrations are a smooth function
    of the state.
    """
    tool = state.tool_position
    forward = push_direction(state)
    along, sideways = (part[..., None] for part in placing(state))
    start = push_start(state)[..., :2] - tool[..., :2]

    low = np.clip((PUSH_HEIGHT + 0.025 - tool[..., 2:]) / 0.015, 0.0, 1.0)
    # Strict before contact with the cube, lenient while pushing.
    leeway = 0.006 + 0.018 * np.clip((along + 0.046) / 0.008, 0.0, 1.0)
    aligned = np.clip(2.0 - sideways / leeway, 0.0, 1.0)
    behind = np.clip((-0.02 - along) / 0.01, 0.0, 1.0)
    placed = low * aligned * behind
    # Straight towards the mark: two fingers side by side keep the cube's face flush.
    gap = distance(state)[..., None]
    push = np.clip(gap - 0.004, 0.0, 0.035) * forward
    plane = placed * push + (1.0 - placed) * 0.6 * start
    # High where it still has to travel, low once it is behind the cube.
    rise = np.clip((astray(state)[..., None] - 0.025) / 0.02, 0.0, 1.0)
    height = PUSH_HEIGHT + rise * (TRAVEL_HEIGHT - PUSH_HEIGHT) - tool[..., 2:]
    # Too low to travel: rise first, to avoid hitting a cube.
    plane = plane * (1.0 - np.clip(height / 0.03, 0.0, 0.95))
    # Well within the tolerance it rests, because the line to the mark is undefined.
    rest = np.clip((gap - 0.012) / 0.01, 0.0, 1.0)
    move = rest * np.concatenate([plane, height], axis=-1)
    return tool_action(state, move, gripper=1.0)  # fingers stay closed


TASK = Task(
    name="push_cube",
    instructions=tuple(f"push the {name} cube onto its mark" for name in COLOURS),
    horizon=120,
    training_horizon=64,  # see docs/tasks.md
    control_frequency=20,
    objects=tuple(f"{name}_cube" for name in COLOURS),
    goals=tuple(f"{name}_mark" for name in COLOURS),
    environment_state_names=tuple(
        f"{name}_{kind}.{axis}"
        for kind in ("cube", "mark")
        for name in COLOURS
        for axis in "xy"
    ),
    make_objects=make_objects,
    table_friction=table_friction,
    sample=sample,
    environment_state=environment_state,
    shaped_reward=shaped_reward,
    success=success,
    expert=expert,
    variations=VARIATIONS,
)
