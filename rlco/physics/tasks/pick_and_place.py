"""Pick and Place: put the named object into the bowl.

Three objects of different shapes stand in a row across the table, in random order, and
a bowl behind them; the robot starts above the table with an open gripper. Solved where
the named object's centre is within the bowl and below its rim. Releasing is not
required, as in the paper's released scene; the expert does it, above the rim (arXiv
2602.12628, its task "pick and place").
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from rlco.physics.spec.domain import Domain
from rlco.physics.spec.task import Array, InitialState, SceneState, Task
from rlco.physics.tasks.push_cube import COLOURS, TABLE_HEIGHT
from rlco.physics.tasks.scripted import ramp, tool_action
from rlco.physics.tasks.variations import (
    JOINT_NOISE,
    UNSEEN_COLOURS,
    VARIATIONS,
    add_distractors,
    beside,
    check_variation,
    make_distractors,
    yaw_quaternion,
)

# Tool 18 cm above the table behind the row, pointing down, fingers across y.
HOME = np.array([0.0, 0.217, 0.0, -2.676, 0.0, 2.893, 0.786])
HOME_NOISE = 0.02  # standard deviation of each joint at the start [rad]
MASS = 0.05  # of an object: a hollow toy [kg]
# Lacquered wood: sliding, torsional, rolling. Rolling keeps a ball where it lies.
FRICTION = (0.7, 5e-3, 1e-3)


@dataclass(frozen=True)
class Shape:
    """An object's geom, and the height of its centre above the table [m]."""

    kind: str
    size: tuple[float, ...]
    height: float
    quaternion: str = "1 0 0 0"


SHAPES = {
    "red": Shape("box", (0.02, 0.02, 0.02), 0.02),
    "green": Shape("cylinder", (0.02, 0.025), 0.025),
    "blue": Shape("sphere", (0.022,), 0.022),
}
UNSEEN_SHAPES = {
    "red": Shape("box", (0.026, 0.017, 0.024), 0.024),
    "green": Shape("capsule", (0.019, 0.015), 0.019, "0.70710678 0 0.70710678 0"),
    "blue": Shape("ellipsoid", (0.027, 0.021, 0.018), 0.018),
}
BOWL_COLOUR = (0.72, 0.77, 0.83, 1.0)
# Inner radius of the bowl at its bottom and at its rim, and the rim's height [m].
BOTTOM_RADIUS, RIM_RADIUS, RIM_HEIGHT = 0.05, 0.07, 0.045
BOARDS = 16  # boxes that form the ring of its wall
# Positions of distractors, beside the tool's path [m].
PLACES = (((-0.1, 0.1), (0.26, 0.32)), ((-0.1, 0.1), (-0.32, -0.26)))

# Tool positions of the expert, heights above the table [m].
APPROACH_HEIGHT = 0.10  # open fingers pass over all objects
CARRY_HEIGHT = 0.115  # what they hold passes over the rim
RELEASE_HEIGHT = 0.075  # fingers open just above the rim


def make_objects(domain: Domain, variation: str | None = None) -> list[object]:
    """Return the three objects, the bowl, and what the variation adds.

    Raises:
        UnknownNameError: If the variation is unknown.
    """
    check_variation(variation)
    # Importing robosuite takes seconds; rules and expert do not need it.
    from rlco.physics.robosuite.mjcf_object import MjcfObject, geom, numbers

    shapes = UNSEEN_SHAPES if variation == "shapes" else SHAPES
    colours = UNSEEN_COLOURS if variation == "colours" else COLOURS
    friction = (FRICTION[0] * domain.friction_scale, *FRICTION[1:])
    made: list[object] = []
    for name, shape in shapes.items():
        body = ElementTree.Element("body", name="main")
        ElementTree.SubElement(body, "joint", name="free", type="free")
        geom(
            body,
            "solid",
            shape.kind,
            (0, 0, 0),
            shape.size,
            colours[name],
            quaternion=shape.quaternion,
            mass=numbers((MASS * domain.mass_scale,)),
            friction=numbers(friction),
            # Its own friction applies, not that of robosuite's rubber finger pads.
            priority="1",
            condim="6",  # with rolling friction
        )
        made.append(MjcfObject(name, body))
    added = make_distractors() if variation == "distractors" else []
    return [*made, make_bowl(), *added]


def make_bowl() -> object:
    """Return the bowl: a disc, and around it a ring of boards that lean outwards."""
    from rlco.physics.robosuite.mjcf_object import MjcfObject, geom, numbers

    thick = 0.002  # half of a board's thickness [m]
    body = ElementTree.Element("body", name="main")
    disc = (BOTTOM_RADIUS + thick, thick)
    geom(body, "bottom", "cylinder", (0, 0, thick), disc, BOWL_COLOUR)
    lean = np.arctan2(RIM_RADIUS - BOTTOM_RADIUS, RIM_HEIGHT)
    middle = (BOTTOM_RADIUS + RIM_RADIUS) / 2 + thick
    half = RIM_HEIGHT / 2
    for index in range(BOARDS):
        turn = 2 * np.pi * index / BOARDS
        place = (middle * np.cos(turn), middle * np.sin(turn), half)
        # Wide enough to meet its neighbours at the rim.
        wide = (RIM_RADIUS + 2 * thick) * np.tan(np.pi / BOARDS)
        # First lean outwards (about y), then turn about z.
        quaternion = (
            np.cos(turn / 2) * np.cos(lean / 2),
            -np.sin(turn / 2) * np.sin(lean / 2),
            np.cos(turn / 2) * np.sin(lean / 2),
            np.sin(turn / 2) * np.cos(lean / 2),
        )
        geom(
            body,
            f"board_{index}",
            "box",
            place,
            (thick, wide, half / np.cos(lean)),
            BOWL_COLOUR,
            quaternion=numbers(quaternion),
        )
    return MjcfObject("bowl", body)


def table_friction(domain: Domain) -> tuple[float, float, float]:
    """Return the table's friction; that of the objects has priority."""
    return (FRICTION[0] * domain.friction_scale, FRICTION[1], FRICTION[2])


def sample(rng: np.random.Generator, variation: str | None = None) -> InitialState:
    """Draw the initial state of an episode.

    Raises:
        UnknownNameError: If the variation is unknown.
    """
    check_variation(variation)
    shapes = UNSEEN_SHAPES if variation == "shapes" else SHAPES
    slots = rng.permutation(3)
    poses = np.zeros((3, 7))
    poses[:, 0] = rng.uniform(-0.10, -0.04, 3)
    poses[:, 1] = (slots - 1) * 0.12 + rng.uniform(-0.015, 0.015, 3)
    poses[:, 2] = [TABLE_HEIGHT + shape.height for shape in shapes.values()]
    poses[:, 3:] = yaw_quaternion(rng.uniform(-0.15, 0.15, 3))
    bowl = np.array([[rng.uniform(0.11, 0.17), rng.uniform(-0.1, 0.1), TABLE_HEIGHT]])
    noise = HOME_NOISE
    if variation == "initial_states":
        poses[:, 0] += 0.06  # the row closer to the bowl than in training
        bowl[0, :2] = rng.uniform(0.17, 0.20), beside(rng, 0.11, 0.16)
        noise = JOINT_NOISE
    start = InitialState(
        joint_position=HOME + rng.normal(0.0, noise, HOME.size),
        object_pose=poses,
        goal_position=bowl,
        instruction_id=int(rng.integers(3)),
        gripper_opening=0.08,
    )
    if variation == "distractors":
        return add_distractors(start, rng, PLACES)
    return start


def environment_state(objects: Array, goals: Array) -> Array:
    """Return x, y, z of each object, then x and y of the bowl, shape (..., 11), [m]."""
    flat = objects.reshape(*objects.shape[:-2], -1)
    return np.concatenate([flat, goals[..., 0, :2]], axis=-1)


def named(state: SceneState) -> Array:
    """Return the named object's centre, shape (..., 3), [m]."""
    index = state.instruction_id[..., None, None]
    row: Array = np.take_along_axis(state.object_position, index, axis=-2)[..., 0, :]
    return row


def above_table(height: Array) -> Array:
    """Convert a height above the floor to one above the table [m]."""
    return height - TABLE_HEIGHT


def to_bowl(state: SceneState, position: Array) -> Array:
    """Return the vector from a position to the bowl, in the plane, (..., 2), [m]."""
    gap: Array = (state.goal_position[..., 0, :] - position)[..., :2]
    return gap


def success(state: SceneState) -> NDArray[np.bool_]:
    """Return whether the named object's centre is within the bowl, below its rim."""
    centre = named(state)
    gap = np.linalg.norm(to_bowl(state, centre), axis=-1)
    height = above_table(centre[..., 2])
    solved: NDArray[np.bool_] = (
        (gap < BOTTOM_RADIUS) & (height > 0.0) & (height < RIM_HEIGHT)
    )
    return solved


def shaped_reward(before: SceneState, after: SceneState) -> Array:
    """Return 10/m of the object's progress, 4/m of the tool's, and 0.05 at the goal.

    The object's path leads up, over the rim and across to the bowl; the tool's leads to
    the object. The first two terms are differences of a potential, so nothing is gained
    by moving to and fro. The last rewards arriving early and staying.
    """

    def potential(state: SceneState) -> Array:
        centre = named(state)
        gap = np.linalg.norm(to_bowl(state, centre), axis=-1)
        # Outside the bowl it has to be lifted, within it may sink.
        outside = ramp(gap, BOTTOM_RADIUS, RIM_RADIUS + 0.03)
        missing = np.maximum(CARRY_HEIGHT - above_table(centre[..., 2]), 0.0)
        tool = np.linalg.norm(centre - state.tool_position, axis=-1)
        wanted = ramp(gap, 0.03, 0.06)
        value: Array = -10.0 * (gap + outside * missing) - 4.0 * wanted * tool
        return value

    return potential(after) - potential(before) + 0.05 * success(after)


def expert(state: SceneState) -> Array:
    """Return the scripted expert's action from the true state, shape (..., A).

    It has no memory and no hard switches: it reaches for the object, closes more the
    better the object lies between the fingers, lifts and carries more the more it has
    closed, and rises once the object is in the bowl.
    """
    centre, tool = named(state), state.tool_position
    reach = (centre - tool)[..., :2]
    bowl = to_bowl(state, tool)
    height = above_table(tool[..., 2:])
    lies = above_table(centre[..., 2:])
    off = np.linalg.norm(reach, axis=-1, keepdims=True)
    far = np.linalg.norm(bowl, axis=-1, keepdims=True)
    gap = np.linalg.norm(to_bowl(state, centre), axis=-1, keepdims=True)
    done = ramp(gap, 0.055, 0.045) * ramp(lies, RIM_HEIGHT + 0.005, RIM_HEIGHT - 0.005)

    between = ramp(off, 0.018, 0.009) * ramp(np.abs(height - lies), 0.016, 0.009)
    held = between * ramp(state.gripper_opening[..., None], 0.052, 0.047)
    over = ramp(far, 0.03, 0.015) * ramp(height, RELEASE_HEIGHT + 0.015, RELEASE_HEIGHT)
    # High where it has to travel, low where it grasps and releases.
    down = lies + ramp(off, 0.008, 0.03) * (APPROACH_HEIGHT - lies)
    carry = RELEASE_HEIGHT + ramp(far, 0.012, 0.03) * (CARRY_HEIGHT - RELEASE_HEIGHT)
    up = held * carry + (1.0 - held) * down - height
    plane = held * bowl + (1.0 - held) * reach
    # Too low to travel: rise first, to avoid hitting something.
    plane = 0.6 * plane * (1.0 - 0.95 * ramp(up, 0.01, 0.03))
    up = done * (APPROACH_HEIGHT - height) + (1.0 - done) * up
    move = np.concatenate([(1.0 - done) * plane, up], axis=-1)
    close = between * (1.0 - over) * (1.0 - done)
    return tool_action(state, move, gripper=2.0 * close[..., 0] - 1.0)


TASK = Task(
    name="pick_and_place",
    instructions=tuple(f"put the {name} object into the bowl" for name in COLOURS),
    horizon=140,
    training_horizon=96,  # see docs/tasks.md
    control_frequency=20,
    objects=tuple(COLOURS),
    goals=("bowl",),
    environment_state_names=(
        *(f"{name}.{axis}" for name in COLOURS for axis in "xyz"),
        "bowl.x",
        "bowl.y",
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
