"""Tray: grasp the cube and put it into the tray."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from rlco.physics.robosuite.mjcf_object import MjcfObject, geom
from rlco.physics.spec.domain import Domain
from rlco.physics.spec.robot import PANDA
from rlco.physics.spec.task import Array, InitialState, SceneState, Task
from rlco.physics.tasks.pick_and_place import HOME, HOME_NOISE
from rlco.physics.tasks.push_cube import TABLE_HEIGHT
from rlco.physics.tasks.scripted import ramp, tool_action

CUBE = 0.02  # half of its side [m]
SIDE, RIM, BOARD = 0.07, 0.02, 0.003  # of the tray: half sides, height of its rim [m]
# Tool heights above the table [m].
APPROACH, CARRY, RELEASE = 0.10, 0.095, 0.045


def make_objects(domain: Domain, variation: str | None = None) -> list[object]:
    """Return the cube, which moves, then the tray, which does not."""
    from robosuite.models.objects import BoxObject

    density = 400.0 * domain.mass_scale  # [kg/m^3]
    cube = BoxObject(name="cube", size=[CUBE] * 3, density=density, rgba=(1, 0, 0, 1))
    body = ElementTree.Element("body", name="main")  # no joint: it stays
    grey = (0.6, 0.6, 0.6, 1.0)
    geom(body, "floor", "box", (0, 0, 0.002), (SIDE, SIDE, 0.002), grey)
    for index, (x, y) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1))):
        size = (BOARD, SIDE, RIM / 2) if x else (SIDE, BOARD, RIM / 2)
        geom(body, f"wall{index}", "box", (x * SIDE, y * SIDE, RIM / 2), size, grey)
    return [cube, MjcfObject("tray", body)]


def table_friction(domain: Domain) -> tuple[float, float, float]:
    """Return the table's friction."""
    return (0.7 * domain.friction_scale, 5e-3, 1e-4)


def sample(rng: np.random.Generator, variation: str | None = None) -> InitialState:
    """Draw the start of an episode: the cube at the right, the tray at the left."""
    cube = (rng.uniform(-0.08, 0.08), rng.uniform(-0.15, -0.05), TABLE_HEIGHT + CUBE)
    tray = (rng.uniform(-0.05, 0.05), rng.uniform(0.13, 0.18), TABLE_HEIGHT)
    return InitialState(
        joint_position=HOME + rng.normal(0.0, HOME_NOISE, 7),
        object_pose=np.array([[*cube, 1.0, 0.0, 0.0, 0.0]]),
        goal_position=np.array([tray]),
        instruction_id=0,
        gripper_opening=PANDA.widest,  # closed unless it is given
    )


def environment_state(objects: Array, goals: Array) -> Array:
    """Return x, y, z of the cube, x and y of the tray, shape (..., 5), [m]."""
    return np.concatenate([objects[..., 0, :], goals[..., 0, :2]], axis=-1)


def to_tray(state: SceneState, position: Array) -> Array:
    """Return the vector from a position to the tray, in the plane, (..., 2), [m]."""
    return (state.goal_position[..., 0, :] - position)[..., :2]


def success(state: SceneState) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return whether the cube lies in the tray, and the fingers have let it go."""
    cube = state.object_position[..., 0, :]
    within = np.abs(to_tray(state, cube)).max(axis=-1) < SIDE - 0.015
    low = cube[..., 2] < TABLE_HEIGHT + 2 * CUBE
    return within & low & (state.gripper_opening > 0.06)


def shaped_reward(before: SceneState, after: SceneState) -> Array:
    """Return 10/m of the cube's progress, 4/m of the tool's, and 0.05 when solved."""

    def potential(state: SceneState) -> Array:
        cube = state.object_position[..., 0, :]
        gap = np.linalg.norm(to_tray(state, cube), axis=-1)
        # Beside the tray it has to be lifted.
        missing = np.maximum(CARRY - (cube[..., 2] - TABLE_HEIGHT), 0.0)
        tool = np.linalg.norm(cube - state.tool_position, axis=-1)
        lift = ramp(gap, 0.05, 0.10) * missing
        return -10.0 * (gap + lift) - 4.0 * ramp(gap, 0.03, 0.06) * tool

    return potential(after) - potential(before) + 0.05 * success(after)


def expert(state: SceneState) -> Array:
    """Return the action, shape (..., 7), without memory and without hard switches.

    It reaches for the cube, closes the more the better the cube lies between the
    fingers, carries the more it has closed, opens over the tray, and then rises.
    """
    cube, tool = state.object_position[..., 0, :], state.tool_position
    reach, over = (cube - tool)[..., :2], to_tray(state, tool)
    height, lies = tool[..., 2:] - TABLE_HEIGHT, cube[..., 2:] - TABLE_HEIGHT
    off, far = (np.linalg.norm(v, axis=-1, keepdims=True) for v in (reach, over))
    gap = np.linalg.norm(to_tray(state, cube), axis=-1, keepdims=True)

    done = ramp(gap, 0.05, 0.04) * ramp(lies, 2 * CUBE + 0.005, 2 * CUBE - 0.005)
    between = ramp(off, 0.018, 0.009) * ramp(np.abs(height - lies), 0.016, 0.009)
    held = between * ramp(state.gripper_opening[..., None], 0.050, 0.045)
    there = ramp(far, 0.03, 0.015) * ramp(height, RELEASE + 0.015, RELEASE)

    down = lies + ramp(off, 0.008, 0.03) * (APPROACH - lies)
    carry = RELEASE + ramp(far, 0.012, 0.03) * (CARRY - RELEASE)
    up = held * carry + (1.0 - held) * down - height
    plane = held * over + (1.0 - held) * reach
    # Too low to travel: rise first.
    plane = 0.6 * plane * (1.0 - 0.95 * ramp(up, 0.01, 0.03))
    up = done * (APPROACH + 0.02 - height) + (1.0 - done) * up
    close = between * (1.0 - there) * (1.0 - done)
    move = np.concatenate([(1.0 - done) * plane, up], axis=-1)
    return tool_action(state, move, gripper=2.0 * close[..., 0] - 1.0)


TASK = Task(
    name="tray",
    instructions=("put the cube into the tray",),
    horizon=140,
    control_frequency=20,
    objects=("cube",),
    goals=("tray",),
    environment_state_names=("cube.x", "cube.y", "cube.z", "tray.x", "tray.y"),
    make_objects=make_objects,
    table_friction=table_friction,
    sample=sample,
    environment_state=environment_state,
    shaped_reward=shaped_reward,
    success=success,
    expert=expert,
)
