"""Whether the parts of a task fit each other, before a scene is built from them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from rlco.errors import ConfigError, counted
from rlco.physics.spec.task import InitialState, SceneState, Task

_NAMES = (
    "instructions",
    "objects",
    "goals",
    "environment_state_names",
    "fixtures",
    "fixture_joints",
    "variations",
)
#: States that the rules are tried on: their leading axes are (3,).
TRIED = 3


def check_task(task: Task) -> Task:
    """Try a task's rules on a few starts, and return the task.

    The rules are called with the states of three starts at once, without physics: the
    tool is somewhere above the table. What a rule raises itself is not caught.

    Raises:
        ConfigError: A rule returns another shape than the task says, a start does not
            fit its objects, or the same seed starts another episode; every problem is
            reported.

    Example:
        >>> from dataclasses import replace
        >>> from rlco.physics.tasks.push_cube import TASK
        >>> check_task(replace(TASK, environment_state_names=("x", "y")))
        Traceback (most recent call last):
        rlco.errors.ConfigError: task 'push_cube': environment_state returns an array \
of shape (3, 12) for 3 states, not (3, 2): environment_state_names has 2 names.
    """
    problems = [*_texts(task), *_numbers(task)]
    starts = [task.sample(np.random.default_rng(seed), None) for seed in range(TRIED)]
    for start in starts:
        problems += _start(task, start)
    again = task.sample(np.random.default_rng(0), None)
    if not problems and _differ(starts[0], again):
        problems.append(
            "sample gives another start when it is called again with the same seed; "
            "draw everything from the random generator that it is given"
        )
    if not problems:
        with np.errstate(all="ignore"):  # shapes count, not numbers
            problems += _rules(task, _states(task, starts))
    if problems:
        found = dict.fromkeys(f"task {task.name!r}: {text}" for text in problems)
        raise ConfigError(list(found))
    return task


def _texts(task: Task) -> Iterator[str]:
    for name in _NAMES:
        value = getattr(task, name)
        if isinstance(value, str):
            yield f"{name} is one text, {value!r}; give a tuple of them, ({value!r},)"
        elif len(set(value)) < len(value):
            yield f"{name} holds a name twice: {', '.join(value)}"
    if not task.instructions:
        yield "instructions is empty; give at least one sentence"


def _numbers(task: Task) -> Iterator[str]:
    for name in ("horizon", "control_frequency", "training_horizon"):
        value = getattr(task, name)
        if value is not None and value < 1:
            yield f"{name}={value} must be at least 1"


def _start(task: Task, start: InitialState) -> Iterator[str]:
    """Say what does not fit in the start of an episode without a variation."""
    if not isinstance(start, InitialState):
        yield f"sample returns {type(start).__name__}, not an InitialState"
        return
    count = len(task.goals)
    wanted = {
        "joint_position": ((len(task.robot.joints),), "the arm's joints"),
        "object_pose": (
            (len(task.objects), 7),
            "position and quaternion of each of objects",
        ),
        "goal_position": ((count, 3), "one row for each of goals"),
        "goal_quaternion": ((count, 4), "one row for each of goals"),
        "joint_opening": ((len(task.fixture_joints),), "one number a fixture's joint"),
    }
    for name, (shape, what) in wanted.items():
        value = getattr(start, name)
        if value is None:
            if name == "joint_opening" and task.fixture_joints:
                yield f"sample gives no joint_opening, of shape {shape}: {what}"
            continue
        array = np.asarray(value)
        if array.shape != shape:
            yield (f"sample gives {name} of shape {array.shape}, not {shape}: {what}")
        elif not np.isfinite(array).all():
            yield f"sample gives {name} that is NaN or infinite"
    if not 0 <= start.gripper_opening <= task.robot.widest:
        yield (
            f"sample gives gripper_opening={start.gripper_opening:g}; the fingers open "
            f"from 0 to {task.robot.widest:g} m"
        )
    if not 0 <= start.instruction_id < len(task.instructions):
        yield (
            f"sample gives instruction_id={start.instruction_id}, but there are "
            f"{len(task.instructions)} instructions, counted from 0"
        )


def _differ(one: InitialState, other: InitialState) -> bool:
    return any(
        not np.array_equal(value, vars(other)[name])
        for name, value in vars(one).items()
        if value is not None
    )


def _states(task: Task, starts: Iterable[InitialState]) -> SceneState:
    """Return states with those starts' objects and goals, and the tool above them."""
    starts = list(starts)
    count, robot = len(starts), task.robot
    goals = np.stack([s.goal_position for s in starts])
    turns = np.stack([s.goal_orientation() for s in starts])
    # Where a fixture's part is depends on its body: somewhere beside it.
    parts = np.repeat(goals[:, :1] + 0.1, len(task.fixtures), axis=1)
    part_turns = np.repeat(turns[:, :1], len(task.fixtures), axis=1)
    poses = np.stack([s.object_pose for s in starts])
    tool = robot.base + np.array([0.5, 0.0, 0.2])
    return SceneState(
        tool_position=np.tile(tool, (count, 1)),
        tool_rotation=np.tile(robot.down, (count, 1, 1)),
        gripper_opening=np.full(count, robot.widest / 2),
        joint_position=np.stack([s.joint_position for s in starts]),
        object_position=np.concatenate([poses[..., :3], parts], axis=1),
        object_quaternion=np.concatenate([poses[..., 3:], part_turns], axis=1),
        joint_opening=np.stack([s.fixture_opening() for s in starts]),
        goal_position=goals,
        goal_quaternion=turns,
        instruction_id=np.array([s.instruction_id for s in starts], dtype=np.int64),
    )


def _rules(task: Task, state: SceneState) -> Iterator[str]:
    """Say which rule returns another shape than the task needs."""
    objects, goals = state.object_position, state.goal_position
    names, actions = task.environment_state_names, task.action_names
    results: dict[str, tuple[Any, tuple[int, ...], str]] = {
        "environment_state": (
            task.environment_state(objects, goals),
            (TRIED, len(names)),
            f"environment_state_names has {counted(len(names), 'name')}",
        ),
        "success": (task.success(state), (TRIED,), "one truth value a state"),
        "shaped_reward": (
            task.shaped_reward(state, state),
            (TRIED,),
            "one number a state",
        ),
        "expert": (
            task.expert(state),
            (TRIED, len(actions)),
            f"one action a state, {', '.join(actions)}",
        ),
    }
    for name, (value, shape, what) in results.items():
        found = np.asarray(value)
        if found.shape != shape:
            yield (
                f"{name} returns an array of shape {found.shape} for {TRIED} states, "
                f"not {shape}: {what}"
            )
        elif name == "success" and found.dtype != np.bool_:
            yield f"success returns {found.dtype}, not truth values (bool)"
