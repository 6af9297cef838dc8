"""A table-top cabinet with one drawer, shared by the tasks that open and close it.

robosuite has none. It consists of boxes and one bar: an open box, and in it a drawer on
a slide joint, whose bow handle has space for a robot's fingers behind it.
"""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from rlco.physics.spec.domain import Domain
from rlco.physics.spec.task import Array, InitialState, SceneState
from rlco.physics.tasks.variations import (
    JOINT_NOISE,
    add_distractors,
    beside,
    check_variation,
    make_distractors,
    yaw_quaternion,
)

TABLE_HEIGHT = 0.8  # robosuite's table top [m]
# Tool 18 cm above the table before the cabinet, pointing down, fingers across y.
HOME = np.array([0.0, 0.217, 0.0, -2.676, 0.0, 2.893, 0.786])
HOME_NOISE = 0.02  # standard deviation of each joint at the start [rad]

DEPTH, WIDTH, HEIGHT = 0.20, 0.26, 0.10  # of the whole cabinet [m]
WALL = 0.01  # thickness of every board [m]
TRAVEL = 0.15  # of the drawer [m]
HANDLE_RADIUS = 0.006  # [m]
HANDLE_GAP = 0.045  # between handle and front: a Panda finger is 2 cm thick [m]
HANDLE_HEIGHT = 0.08  # near the top, so that the hand stays above the cabinet [m]
# From the cabinet's centre to the closed handle's.
REACH = DEPTH / 2 + HANDLE_GAP + HANDLE_RADIUS
DRAWER_MASS = 0.6  # 1 cm boards of pine, and the bar [kg]
RUNNER_FRICTION = 1.2  # 0.2 (waxed wood on wood) of its weight [N]
RUNNER_DAMPING = 4.0  # soft enough to close with a finger [N s/m]
# Positions of distractors, beside the tool's path [m].
PLACES = (((-0.1, 0.05), (0.24, 0.32)), ((-0.1, 0.05), (-0.32, -0.24)))
HANDLE_FRICTION = (0.5, 5e-3, 1e-4)  # brushed steel: sliding, torsional, rolling


@dataclass(frozen=True)
class Look:
    """The look of a cabinet, which variations change: colours and handle shape."""

    body: tuple[float, float, float, float] = (0.34, 0.44, 0.53, 1.0)
    front: tuple[float, float, float, float] = (0.80, 0.55, 0.30, 1.0)
    inside: tuple[float, float, float, float] = (0.86, 0.79, 0.66, 1.0)
    handle: tuple[float, float, float, float] = (0.22, 0.23, 0.25, 1.0)
    handle_half_length: float = 0.07  # [m]
    handle_kind: str = "capsule"  # or "box"
    width: float = WIDTH  # [m]


LOOKS = {
    "colours": Look(
        body=(0.60, 0.26, 0.22, 1.0),
        front=(0.90, 0.88, 0.82, 1.0),
        handle=(0.80, 0.62, 0.22, 1.0),
    ),
    "shapes": Look(handle_half_length=0.045, handle_kind="box", width=0.34),
}


def make_cabinet(domain: Domain, variation: str | None = None) -> object:
    """Return the cabinet: body ``main``, and ``drawer`` on the joint ``slide``.

    The root is on the table under the cabinet's middle. The drawer's own origin is the
    middle of its handle, and it opens towards the root's negative x.
    """
    # Importing robosuite takes seconds; rules and expert do not need it.
    from rlco.physics.robosuite.mjcf_object import MjcfObject, geom, numbers

    look = LOOKS.get(variation or "", Look())
    # Cabinet and drawer collide with the robot and not with each other: conaffinity 0.
    solid = {"conaffinity": "0", "contype": "1"}
    root = ElementTree.Element("body", name="main")
    wide, deep, high, wall = look.width / 2, DEPTH / 2, HEIGHT / 2, WALL / 2
    for name, place, size in (
        ("bottom", (0, 0, wall), (deep, wide, wall)),
        ("top", (0, 0, HEIGHT - wall), (deep, wide, wall)),
        ("left", (0, wide - wall, high), (deep, wall, high - WALL)),
        ("right", (0, wall - wide, high), (deep, wall, high - WALL)),
        ("back", (deep - wall, 0, high), (wall, wide - WALL, high - WALL)),
    ):
        geom(root, name, "box", place, size, look.body, **solid)

    drawer = ElementTree.SubElement(
        root, "body", name="drawer", pos=numbers((-REACH, 0, HANDLE_HEIGHT))
    )
    ElementTree.SubElement(
        drawer,
        "joint",
        name="slide",
        type="slide",
        axis="-1 0 0",
        range=numbers((0, TRAVEL)),
        limited="true",
        frictionloss=numbers((RUNNER_FRICTION * domain.fixture_friction_scale,)),
        damping=numbers((RUNNER_DAMPING,)),
        armature="0.05",
    )
    inertia = ElementTree.SubElement(
        drawer,
        "inertial",
        pos=numbers((REACH - 0.02, 0, -0.03)),
        diaginertia="3e-3 3e-3 5e-3",
    )
    inertia.set("mass", numbers((DRAWER_MASS * domain.mass_scale,)))
    _add_boards(drawer, look, domain, solid)
    return MjcfObject("cabinet", root)


def _add_boards(
    drawer: ElementTree.Element, look: Look, domain: Domain, solid: dict[str, str]
) -> None:
    """Add front, box and handle to the drawer, in the handle's frame."""
    from rlco.physics.robosuite.mjcf_object import geom, numbers

    play = 0.003  # between drawer and cabinet, and to its closed front [m]
    front = HANDLE_GAP + HANDLE_RADIUS + WALL / 2
    wide = look.width / 2 - WALL - play
    middle = HEIGHT / 2 - HANDLE_HEIGHT
    tall = HEIGHT / 2 - WALL - play
    back = front + DEPTH - 3 * WALL
    long = (back - front) / 2
    low = middle - tall + WALL / 2
    for name, place, size in (
        ("front", (front, 0, middle), (WALL / 2, wide, tall)),
        ("floor", (front + long, 0, low), (long, wide, WALL / 2)),
        ("left", (front + long, wide - WALL / 2, middle), (long, WALL / 2, tall)),
        ("right", (front + long, WALL / 2 - wide, middle), (long, WALL / 2, tall)),
        ("back", (back, 0, middle), (WALL / 2, wide, tall)),
    ):
        rgba = look.front if name == "front" else look.inside
        geom(drawer, f"drawer_{name}", "box", place, size, rgba, **solid)
    friction = (HANDLE_FRICTION[0] * domain.friction_scale, *HANDLE_FRICTION[1:])
    # Its own friction applies, not that of robosuite's rubber finger pads.
    metal = {**solid, "friction": numbers(friction), "priority": "1"}
    half, radius = look.handle_half_length, HANDLE_RADIUS
    if look.handle_kind == "box":
        geom(
            drawer,
            "bar",
            "box",
            (0, 0, 0),
            (radius, half, radius),
            look.handle,
            **metal,
        )
    else:
        geom(
            drawer,
            "bar",
            "capsule",
            (0, 0, 0),
            (radius, half),
            look.handle,
            quaternion="0.70710678 0.70710678 0 0",
            **metal,
        )
    post = (HANDLE_GAP + HANDLE_RADIUS) / 2
    for name, side in (("post_left", half), ("post_right", -half)):
        geom(
            drawer,
            name,
            "box",
            (post, side, 0),
            (post, 0.005, 0.005),
            look.handle,
            **metal,
        )


def make_objects(domain: Domain, variation: str | None = None) -> list[object]:
    """Return the cabinet, and what the variation adds.

    Raises:
        UnknownNameError: If the variation is unknown.
    """
    check_variation(variation)
    added = make_distractors() if variation == "distractors" else []
    return [make_cabinet(domain, variation), *added]


def sample(
    rng: np.random.Generator, openings: tuple[float, float], variation: str | None
) -> InitialState:
    """Draw the cabinet's pose, the drawer's opening, and the robot's pose.

    Args:
        rng: Random generator.
        openings: Smallest and largest opening of the drawer [m].
        variation: A variation of the initial states.

    Raises:
        UnknownNameError: If the variation is unknown.
    """
    check_variation(variation)
    noise = HOME_NOISE
    x, y, yaw = rng.uniform((0.18, -0.06, -0.12), (0.22, 0.06, 0.12))
    if variation == "initial_states":
        y, yaw, noise = beside(rng, 0.07, 0.11), beside(rng, 0.14, 0.20), JOINT_NOISE
    start = InitialState(
        joint_position=HOME + rng.normal(0.0, noise, HOME.size),
        object_pose=np.zeros((0, 7)),
        goal_position=np.array([[x, y, TABLE_HEIGHT]]),
        goal_quaternion=yaw_quaternion(np.array([yaw])),
        joint_opening=np.array([rng.uniform(*openings)]),
        instruction_id=0,
    )
    if variation == "distractors":
        return add_distractors(start, rng, PLACES)
    return start


def handle(state: SceneState) -> Array:
    """Return the middle of the handle, world frame, shape (..., 3), [m]."""
    position: Array = state.object_position[..., 0, :]
    return position


def opening(state: SceneState) -> Array:
    """Return the opening of the drawer, shape (...), [m]."""
    joint: Array = state.joint_opening[..., 0]
    return joint


def outward(state: SceneState) -> Array:
    """Return the unit vector in which the drawer opens, in the plane, (..., 2)."""
    line = (handle(state) - state.goal_position[..., 0, :])[..., :2]
    direction: Array = line / np.linalg.norm(line, axis=-1, keepdims=True)
    return direction


def from_handle(state: SceneState) -> tuple[Array, Array]:
    """Return the tool's distance outside of the handle, and beside its middle [m].

    Outside is positive in front of the handle and negative between handle and front.
    """
    offset = (state.tool_position - handle(state))[..., :2]
    ahead = outward(state)
    beside = np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
    return (offset * ahead).sum(-1), (offset * beside).sum(-1)


def environment_state(objects: Array, goals: Array) -> Array:
    """Return x and y of the handle, then of the cabinet, shape (..., 4), [m].

    Their difference determines the cabinet's yaw and the opening of the drawer.
    """
    both = np.concatenate([objects, goals], axis=-2)[..., :2]
    return both.reshape(*both.shape[:-2], -1)


def table_friction(domain: Domain) -> tuple[float, float, float]:
    """Return the table's friction, which does not matter in these tasks."""
    return (0.6 * domain.friction_scale, 5e-3, 1e-4)
