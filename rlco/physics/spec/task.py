"""A task as one value that holds its scene, its rules and its expert.

A task is written in one file, as functions over arrays with leading batch axes, so that
both backends and the expert use the same rules.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from rlco.physics.spec.actions import LIMIT
from rlco.physics.spec.robot import PANDA, Robot

if TYPE_CHECKING:
    from rlco.physics.spec.domain import Domain

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SceneState:
    """The true state of a scene, world frame; every array has leading axes [...].

    Attributes:
        tool_position: Grip site, shape (..., 3), [m].
        tool_rotation: Its rotation matrix, shape (..., 3, 3).
        gripper_opening: Distance between the fingers, shape (...), [m].
        joint_position: Arm joints, shape (..., n), [rad].
        object_position: Tracked bodies: the K objects, then the F moving parts of
            fixtures, shape (..., K + F, 3), [m].
        object_quaternion: Their orientation (w, x, y, z), shape (..., K + F, 4).
        joint_opening: Joints of fixtures, shape (..., J), [m] or [rad].
        goal_position: Bodies fixed for the episode: marks, goals and fixtures, shape
            (..., G, 3), [m].
        goal_quaternion: Their orientation (w, x, y, z), shape (..., G, 4).
        instruction_id: Index of the episode's instruction, int64, shape (...).
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
    """The initial state of one episode.

    Attributes:
        joint_position: Arm joints, shape (n,), [rad].
        object_pose: Position and quaternion (w, x, y, z) of the K objects, then of
            the D distractors of the episode's variation, shape (K + D, 7), [m].
        goal_position: Shape (G, 3), [m].
        instruction_id: Index into the task's instructions.
        goal_quaternion: (w, x, y, z), shape (G, 4); upright where absent.
        joint_opening: Joints of fixtures, shape (J,), [m] or [rad], where the task
            has any.
        gripper_opening: Distance between the fingers at the start [m].
        seed: Of what is drawn within the episode: how late each command arrives, where
            the domain has such delays. `Task.initial_state` draws it.
    """

    joint_position: Array
    object_pose: Array
    goal_position: Array
    instruction_id: int
    goal_quaternion: Array | None = None
    joint_opening: Array | None = None
    gripper_opening: float = 0.0
    seed: int = 0

    def goal_orientation(self) -> Array:
        """Return the goals' quaternions, shape (G, 4)."""
        if self.goal_quaternion is None:
            upright = [1.0, 0.0, 0.0, 0.0]
            return np.tile(upright, (len(self.goal_position), 1))
        return self.goal_quaternion

    def fixture_opening(self) -> Array:
        """Return the positions of fixtures' joints, shape (J,), [m] or [rad]."""
        return np.zeros(0) if self.joint_opening is None else self.joint_opening


@dataclass(frozen=True)
class Task:
    """A manipulation task of a robot at robosuite's table.

    Attributes:
        name: Its name in options and results.
        instructions: All instructions; an episode has one, by index.
        horizon: Length of an episode in control steps.
        control_frequency: Control steps per second [Hz].
        objects: Names of the free objects, in the order of `object_position`.
        goals: Names of the bodies that are fixed for an episode, in the order of
            `goal_position`.
        environment_state_names: Name of each dimension of `environment_state`.
        make_objects: (domain, variation) -> robosuite objects to add to the scene:
            `objects` (each with a free joint), then `goals` (which become mocap
            bodies), then the distractors of a variation, which have free joints and are
            not observed by policies.
        table_friction: Domain -> sliding, torsional, rolling friction.
        sample: (random generator, variation) -> the initial state of an episode.
        environment_state: (object positions (..., K, 3), goal positions (..., G, 3))
            as the camera reports them -> features (..., E), [m].
        shaped_reward: (state before, state after a control step) -> shape (...).
        success: state -> bool, shape (...).
        expert: state -> the scripted expert's action, shape (..., A).
        fixtures: Bodies of goals that move on joints of their own (a drawer); their
            poses follow those of the objects in `object_position`.
        fixture_joints: Names of these joints, in the order of `joint_opening`.
        variations: Names of the unseen variations, for evaluation.
        robot: The robot that performs it.
        training_horizon: Length of a training episode in control steps, where most
            of `horizon` would be rest after success; None: `horizon`.
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
    robot: Robot = PANDA
    training_horizon: int | None = None

    #: Numbers of an action are at most so large.
    action_limit: ClassVar[float] = LIMIT

    @property
    def state_names(self) -> tuple[str, ...]:
        """Name of each dimension of `state`."""
        return self.robot.state_names

    @property
    def action_names(self) -> tuple[str, ...]:
        """Name of each dimension of an action."""
        return self.robot.action_names

    def initial_state(
        self, rng: np.random.Generator, variation: str | None = None
    ) -> InitialState:
        """Return what `sample` draws, with a seed from the same generator.

        The seed shifts none of the generator's draws, before or after.
        """
        (child,) = rng.spawn(1)
        start = self.sample(rng, variation)
        return replace(start, seed=int(child.integers(2**63)))

    def description(self) -> dict[str, Any]:
        """Return what a policy's user must know of the task, in JSON types."""
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

        The sparse reward is +1 in the step in which the task becomes solved and -1
        where this is undone, so that an episode's sum is its success at the end.
        """
        if kind == "shaped":
            return self.shaped_reward(before, after)
        now, then = self.success(after), self.success(before)
        change: Array = now.astype(float) - then.astype(float)
        return change
