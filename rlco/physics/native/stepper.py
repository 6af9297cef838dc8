"""Step N worlds of a robosuite model without robosuite's Python.

robosuite spends most of a control step in Python between two MuJoCo calls. Here the
same compiled model is stepped by one compiled function, which calls MuJoCo and computes
the controller's torques for a range of worlds, without the GIL. Python threads run
ranges in parallel. Every MuJoCo call, and every rounding that matters, is in
robosuite's order; a test compares the motions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import SimulationError
from rlco.physics.effects.corrected_model import Given
from rlco.physics.native.effect_kernels import observe_range
from rlco.physics.native.kernels import (
    FINGERS,
    JOINTS,
    POSE_SIZE,
    TOOL,
    TURN,
    Tracked,
    feature_count,
    reset_range,
    step_range,
)
from rlco.physics.native.worlds import Worlds
from rlco.physics.robosuite.effect_sim import corrected_model_of, drawn_models_of
from rlco.physics.robosuite.read_control import integers, read_control, read_gains
from rlco.physics.spec.domain import GivenDomain, make_domain, with_effects
from rlco.physics.spec.stepper import OnDivergence, check_actions
from rlco.physics.spec.task import Array, InitialState, SceneState, Task


class NativeStepper:
    """N worlds of a task's robosuite model, stepped in threads.

    Args:
        task: The task.
        domain: Differences from the simulator as built: a domain, its name or file.
        num_envs: Number of worlds.
        threads: Python threads; by default one per core, at most `num_envs`.
        exact: Compute torques with robosuite's own linear algebra: about a third
            slower, and equal to robosuite even through impacts. Without it, torques
            differ by rounding errors of 1e-12.
        variation: A named variation of the scene.
        on_divergence: ``raise``, or ``mark`` a world that diverges in `diverged` and
            stop stepping it until its reset; its state stays at the last valid one.
        effects: Effects to add to the domain: a list, or the path of an
            ``effects.yaml``.

    Raises:
        RlcoError: If an effect cannot be applied; the effect is named.

    Example:
        >>> from rlco.physics.spec.domain import SIM
        >>> from rlco.physics.tasks.push_cube import TASK
        >>> stepper = NativeStepper(TASK, SIM, num_envs=2, threads=1)
        >>> rng = np.random.default_rng(0)
        >>> state = stepper.reset([TASK.sample(rng, None) for _ in range(2)])
        >>> state = stepper.step(np.zeros((2, 4, 7)))
        >>> state.tool_position.shape  # (environments, control steps + 1, 3)
        (2, 5, 3)
    """

    def __init__(
        self,
        task: Task,
        domain: GivenDomain,
        *,
        num_envs: int,
        threads: int | None = None,
        exact: bool = False,
        variation: str | None = None,
        on_divergence: OnDivergence = "raise",
        effects: Given = None,
    ) -> None:
        from rlco.physics.robosuite.tabletop import Tabletop

        self.task = task
        self.domain = with_effects(make_domain(domain), effects)
        self.num_envs = num_envs
        self._on_divergence = on_divergence
        source = Tabletop(task, self.domain, variation=variation)
        source.start(task.sample(np.random.default_rng(0), variation))
        self.worlds = Worlds(
            source.sim.model._model,
            read_control(source, exact=exact),
            read_gains(source),
            num_envs=num_envs,
            threads=threads,
            controller_model=corrected_model_of(source.sim).controller_model,
            drawn=drawn_models_of(source.sim),
        )
        self.tracked = tracked_of(source)
        source.close()
        self.features: Array = np.zeros((num_envs, feature_count(self.tracked)))
        self.goals = np.zeros((num_envs, len(task.goals), POSE_SIZE))
        self.instruction_id = np.zeros(num_envs, dtype=np.int64)

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model of all worlds."""
        return self.worlds.model

    def model_of(self, number: int) -> mujoco.MjModel:
        """Return one world's model, to render it; valid until the next call."""
        return self.worlds.model_of(number)

    @property
    def model_addresses(self) -> NDArray[np.int64]:
        """Addresses of the worlds' models, which compiled code reads, (N,)."""
        return self.worlds.memory.models

    def run_over(
        self, kernel: Callable[..., None], count: int, *arguments: Any
    ) -> None:
        """Run a compiled loop over `count` worlds, in the threads that step them."""
        self.worlds.run_over(kernel, count, *arguments)

    def patch(
        self, which: NDArray[np.int64], values: Mapping[str, NDArray[Any]]
    ) -> None:
        """Give worlds their own values of arrays that only drawing reads, unchecked."""
        self.worlds.patch_model(which, values, derive=False)

    @property
    def data(self) -> list[mujoco.MjData]:
        """MuJoCo's state of each world."""
        return self.worlds.data

    @property
    def diverged(self) -> NDArray[np.bool_]:
        """Mask of the worlds that have diverged since their reset, shape (N,)."""
        return self.worlds.memory.broken

    def reset(
        self,
        initial: list[InitialState],
        which: NDArray[np.int64] | None = None,
        drawn: Sequence[int] | None = None,
    ) -> SceneState:
        """Start episodes in the worlds `which` (all by default).

        Args:
            initial: One initial state for each of `which`.
            which: Indices of worlds, shape (R,).
            drawn: The parameter set of the domain's sample that each of `which` has
                from now on; None: the last one, or at first the effects' own numbers.

        Returns:
            The state of all worlds, leading axes (N,).
        """
        which = np.arange(self.num_envs) if which is None else which
        joints = np.stack([start.joint_position for start in initial])
        goals = np.concatenate(
            [
                np.stack([start.goal_position for start in initial]),
                np.stack([start.goal_orientation() for start in initial]),
            ],
            axis=-1,
        )
        if drawn is not None:
            self.worlds.draw(which, drawn)
        memory = self.worlds.memory
        factor, offset = self.worlds.reported(which, self.tracked.arm_qpos)
        memory.posture[which] = factor * joints + offset
        openings = np.array([start.gripper_opening for start in initial])
        robot = self.task.robot
        memory.grip[which] = np.stack([robot.gripper_goal(one) for one in openings])
        memory.seed[which] = [start.seed for start in initial]
        self.worlds.forget(which)
        # New arrays, because states returned earlier hold views of the old ones.
        self.features, self.goals = self.features.copy(), self.goals.copy()
        self.instruction_id = self.instruction_id.copy()
        self.goals[which] = goals
        self.instruction_id[which] = [start.instruction_id for start in initial]
        reset_range(
            which,
            memory,
            self.tracked,
            joints,
            robot.fingers(openings)[0],
            np.stack([start.object_pose for start in initial]),
            goals,
            np.stack([start.fixture_opening() for start in initial]),
            self.features,
        )
        for row in range(which.size):
            number = which[row : row + 1]
            observe_range(number, self.worlds.control_of(int(number[0])), memory)
        return self.scene_state()

    def step(
        self, actions: Array, steps: NDArray[np.int64] | None = None
    ) -> SceneState:
        """Execute action chunks, shape (N, H, A), in all worlds.

        Args:
            actions: Each value in [-1, 1]; values outside are clipped.
            steps: Number of the H steps that each world executes, shape (N,); all by
                default.

        Returns:
            The state before the first and after each control step, leading axes
            (N, H + 1); rows beyond `steps`, and those of worlds that have diverged,
            repeat the last valid one.

        Raises:
            RlcoError: If an action is NaN or infinite.
            SimulationError: If a world diverges, unless such worlds are marked.
        """
        check_actions(actions)
        count, horizon, _ = actions.shape
        if steps is None:
            steps = np.full(count, horizon, dtype=np.int64)
        out = np.empty((count, horizon + 1, self.features.shape[1]))
        out[:, 0] = self.features
        self.worlds.run_controlled(
            step_range,
            self.tracked,
            np.ascontiguousarray(actions, dtype=np.float64),
            steps,
            out,
        )
        if self._on_divergence == "raise" and self.diverged.any():
            raise SimulationError(
                self.task.name, np.flatnonzero(self.diverged).tolist()
            )
        self.features = out[:, -1].copy()
        lead = (count, horizon + 1)
        goals = np.broadcast_to(self.goals[:, None], (*lead, *self.goals.shape[1:]))
        ids = np.broadcast_to(self.instruction_id[:, None], lead)
        return scene_of(out, self.tracked, goals, ids)

    def randomise(
        self,
        which: NDArray[np.int64] | Sequence[int],
        fields: Mapping[str, NDArray[Any]] | None = None,
        *,
        stiffness: NDArray[Any] | float | None = None,
        damping: NDArray[Any] | float | None = None,
        command_delay: NDArray[Any] | int | None = None,
    ) -> None:
        """Change only the worlds `which`, until changed again; see `Worlds`.

        Raises:
            RlcoError: If a name, a shape or a value is not allowed.
        """
        self.worlds.randomise(
            which,
            fields,
            stiffness=stiffness,
            damping=damping,
            command_delay=command_delay,
        )

    def scene_state(self) -> SceneState:
        """Return the current state of all worlds, leading axes (N,)."""
        return scene_of(self.features, self.tracked, self.goals, self.instruction_id)

    def reported_state(self) -> SceneState:
        """Return the same, with robots as their encoders report them."""
        state, control = self.scene_state(), self.worlds.control
        if not control.acting.controller_model:
            return state
        tool, rotation = state.tool_position.copy(), state.tool_rotation.copy()
        for number in np.flatnonzero(~self.diverged).tolist():
            data = self.worlds.observed[number]
            tool[number] = data.site_xpos[control.site]
            rotation[number] = data.site_xmat[control.site].reshape(3, 3)
        everyone = np.arange(self.num_envs)
        factor, offset = self.worlds.reported(everyone, self.tracked.arm_qpos)
        return replace(
            state,
            tool_position=tool,
            tool_rotation=rotation,
            joint_position=factor * state.joint_position + offset,
        )


def scene_of(
    features: Array, tracked: Tracked, goals: Array, ids: NDArray[np.int64]
) -> SceneState:
    """Convert features written by a native kernel to a scene's state.

    Args:
        features: (..., F), as `rlco.physics.native.kernels.read_features` writes them.
        tracked: The addresses they were read from.
        goals: Position and quaternion of objects fixed for the episode, (..., G, 7).
        ids: The episode's instruction, (...,).
    """
    lead, first = features.shape[:-1], JOINTS + tracked.arm_qpos.size
    end = first + POSE_SIZE * tracked.objects.size
    poses = features[..., first:end].reshape(*lead, -1, POSE_SIZE)
    return SceneState(
        tool_position=features[..., TOOL:TURN],
        tool_rotation=features[..., TURN:FINGERS].reshape(*lead, 3, 3),
        gripper_opening=features[..., FINGERS] - features[..., FINGERS + 1],
        joint_position=features[..., JOINTS:first],
        object_position=poses[..., :3],
        object_quaternion=poses[..., 3:],
        joint_opening=features[..., end:],
        goal_position=goals[..., :3],
        goal_quaternion=goals[..., 3:],
        instruction_id=ids,
    )


def tracked_of(source: Any) -> Tracked:
    """Return the addresses of a robosuite scene's features."""
    robot, arm = source.robots[0], source.task.robot.arm
    joints = [o.joints[0] for o in source.loose]
    address = [source.sim.model.get_joint_qpos_addr(j)[0] for j in joints]
    return Tracked(
        site=int(robot.eef_site_id[arm]),
        finger=int(robot._ref_gripper_joint_pos_indexes[arm][0]),
        nq=int(source.sim.model._model.nq),
        arm_qpos=integers(robot.part_controllers[arm].qpos_index),
        objects=integers(source.object_ids),
        object_joints=integers(address),
        mocap=integers(source.mocap_ids),
        fixture_qpos=integers(source.fixture_qpos),
    )
