"""What a task is: one value that holds its scene, its rules and its expert.

A task is written in one file, as functions over arrays with leading batch axes,
so that both backends and the expert read the very same rules.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError, UnknownNameError

if TYPE_CHECKING:
    from rlco.physics.domain import Domain

Array = NDArray[np.float64]
FINGER_HALF_RANGE = 0.02  # of a Panda finger's travel of 4 cm [m]
#: rlco's own tasks: each is the module of that name beside this one, and in it TASK.
TASK_NAMES = ("push_cube", "pick_and_place", "open_drawer", "close_drawer")


@dataclass(frozen=True)
class SceneState:
    """The true state of a scene, world frame; every array has leading axes [...].

    Attributes:
        tool_position: Grip site, shape (..., 3), [m].
        tool_rotation: Its rotation matrix, shape (..., 3, 3).
        gripper_opening: Distance between the fingers, shape (...), [m].
        joint_position: Arm joints, shape (..., 7), [rad].
        object_position: Tracked bodies: the K objects, then the F moving parts of
            fixtures, shape (..., K + F, 3), [m].
        object_quaternion: Their orientation (w, x, y, z), shape (..., K + F, 4).
        joint_opening: Joints of fixtures, shape (..., J), [m] or [rad].
        goal_position: What the episode places and nothing moves: marks, goals and
            fixtures, shape (..., G, 3), [m].
        goal_quaternion: Their orientation (w, x, y, z), shape (..., G, 4).
        instruction_id: Which instruction the episode has, int64, shape (...).
    """

    tool_position: Array
    tool_rotation: Array
    gripper_opening: Array
    joint_position: Array
    object_position: Array
    object_quaternion: Array
    joint_opening: Array
    goal_position: Array
    goal_quaternion: Array
    instruction_id: NDArray[np.int64]

    def at(self, index: Any) -> SceneState:
        """Return the state at an index into the leading axes."""
        return SceneState(**{k: v[index] for k, v in vars(self).items()})


@dataclass(frozen=True)
class InitialState:
    """How one episode starts.

    Attributes:
        joint_position: Arm joints, shape (7,), [rad].
        object_pose: Position and quaternion (w, x, y, z) of the K objects, then of
            the D distractors of the episode's variation, shape (K + D, 7), [m].
        goal_position: Shape (G, 3), [m].
        instruction_id: Index into the task's instructions.
        goal_quaternion: (w, x, y, z), shape (G, 4); upright where absent.
        joint_opening: Joints of fixtures, shape (J,), [m] or [rad], where the task
            has any.
        gripper_opening: Distance between the fingers at the start [m].
    """

    joint_position: Array
    object_pose: Array
    goal_position: Array
    instruction_id: int
    goal_quaternion: Array | None = None
    joint_opening: Array | None = None
    gripper_opening: float = 0.0

    def goal_orientation(self) -> Array:
        """Return the goals' quaternions, shape (G, 4)."""
        if self.goal_quaternion is None:
            upright = [1.0, 0.0, 0.0, 0.0]
            return np.tile(upright, (len(self.goal_position), 1))
        return self.goal_quaternion

    def fixture_opening(self) -> Array:
        """Return the positions of fixtures' joints, shape (J,), [m] or [rad]."""
        return np.zeros(0) if self.joint_opening is None else self.joint_opening

    def gripper_goal(self) -> Array:
        """Return robosuite's command that keeps the two fingers where they start."""
        side = self.gripper_opening / 2.0 / FINGER_HALF_RANGE - 1.0
        return np.array([side, -side])


@dataclass(frozen=True)
class Task:
    """A manipulation task on robosuite's Panda and table.

    Attributes:
        name: What it is called in options and results.
        instructions: Every instruction there is; an episode has one, by index.
        horizon: Length of an episode in control steps.
        control_frequency: Control steps a second [Hz].
        objects: Names of the objects that lie about, in the order of
            `object_position`.
        goals: Names of what is placed once an episode, in the order of
            `goal_position`.
        environment_state_names: One name a number of `environment_state`.
        make_objects: (domain, variation) -> robosuite objects to put into the
            scene: `objects` (each with a free joint), then `goals` (which become
            mocap bodies), then the distractors of a variation, which have free joints
            and which no policy is told of.
        table_friction: Domain -> sliding, torsional, rolling friction.
        sample: (random generator, variation) -> the start of an episode.
        environment_state: (object positions (..., K, 3), goal positions (..., G, 3))
            as the camera reports them -> features (..., E), [m].
        shaped_reward: (state before, state after a control step) -> shape (...).
        success: state -> bool, shape (...).
        expert: state -> the scripted expert's action, shape (..., 7).
        fixtures: Bodies of goals that move on joints of their own (a drawer); their
            poses follow those of the objects in `object_position`.
        fixture_joints: Names of these joints, in the order of `joint_opening`.
        variations: Names of the unseen variations, for evaluation.
    """

    name: str
    instructions: tuple[str, ...]
    horizon: int
    control_frequency: int
    objects: tuple[str, ...]
    goals: tuple[str, ...]
    environment_state_names: tuple[str, ...]
    make_objects: Callable[[Domain, str | None], list[Any]]
    table_friction: Callable[[Domain], tuple[float, float, float]]
    sample: Callable[[np.random.Generator, str | None], InitialState]
    environment_state: Callable[[Array, Array], Array]
    shaped_reward: Callable[[SceneState, SceneState], Array]
    success: Callable[[SceneState], NDArray[np.bool_]]
    expert: Callable[[SceneState], Array]
    fixtures: tuple[str, ...] = ()
    fixture_joints: tuple[str, ...] = ()
    variations: tuple[str, ...] = ()

    @property
    def state_names(self) -> tuple[str, ...]:
        """One name a number of `state`."""
        from rlco.physics.observation import STATE_NAMES

        return STATE_NAMES

    @property
    def action_names(self) -> tuple[str, ...]:
        """One name a number of an action."""
        from rlco.physics.observation import ACTION_NAMES

        return ACTION_NAMES

    def description(self) -> dict[str, Any]:
        """Return what a policy's user must know of the task, in types of JSON."""
        return {
            "task": self.name,
            "instructions": list(self.instructions),
            "control_frequency": self.control_frequency,
            "state_names": list(self.state_names),
            "environment_state_names": list(self.environment_state_names),
            "action_names": list(self.action_names),
        }

    def reward(self, before: SceneState, after: SceneState, kind: str) -> Array:
        """Return the reward of a control step, ``shaped`` or ``sparse``.

        The sparse reward is +1 where the task becomes solved in this step and -1
        where it is undone, so that an episode's sum is its success at the end.
        """
        if kind == "shaped":
            return self.shaped_reward(before, after)
        now, then = self.success(after), self.success(before)
        change: Array = now.astype(float) - then.astype(float)
        return change


def check_actions(actions: Array) -> None:
    """Refuse action chunks (N, H, 7) that hold NaN or infinity.

    MuJoCo would warn, command zero torques and go on.

    Raises:
        RlcoError: If a number is not finite.
    """
    bad = np.flatnonzero(~np.isfinite(actions).all(axis=(1, 2)))
    if bad.size:
        raise RlcoError(
            f"the actions of environments {bad.tolist()} are NaN or infinite; check "
            "the policy that gives them."
        )


def make_task(task: str | Task) -> Task:
    """Return the task of that name; a `Task` is returned as it is.

    A name is one of rlco's own, or ``module:NAME`` for a `Task` in a module of yours
    that Python finds (``PYTHONPATH=.`` for one in the working directory).

    Raises:
        UnknownNameError: If there is no task of that name.
        RlcoError: If the module cannot be imported, or holds no such task, or the name
            is of one of robosuite's own tasks.

    Example:
        >>> make_task("push_cube").horizon
        120
        >>> make_task("rlco.physics.push_cube:TASK").name
        'push_cube'
    """
    if isinstance(task, Task):
        return task
    if ":" in task:
        return _task_of_module(*task.split(":", 1))
    if task not in TASK_NAMES:
        raise UnknownNameError("task", task, sorted(TASK_NAMES))
    found: Task = importlib.import_module(f"rlco.physics.{task}").TASK
    return found


def _task_of_module(module: str, name: str) -> Task:
    if module == "robosuite":
        raise RlcoError(
            f"'{module}:{name}' is robosuite's own task, without a scripted expert and "
            "domains, which make_env, sft, rl_co and evaluate take; here give one of "
            f"{', '.join(TASK_NAMES)}, or MODULE:NAME of yours."
        )
    try:
        found = getattr(importlib.import_module(module), name, None)
    except ModuleNotFoundError as error:
        raise RlcoError(
            f"cannot import {module!r} for the task '{module}:{name}' ({error}); give "
            "MODULE:NAME of a module that Python finds, with PYTHONPATH=. where it "
            "lies in the working directory."
        ) from error
    if not isinstance(found, Task):
        raise RlcoError(
            f"module {module!r} holds no Task named {name!r} but {found!r}; assign one "
            "to that name."
        )
    return found
