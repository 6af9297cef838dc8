"""Step N copies of a robosuite model without robosuite's Python.

robosuite spends most of a control step in Python between two MuJoCo calls. Here
the same compiled model is stepped by one compiled function that calls MuJoCo and
computes the controller's torques in between, for a range of copies, without the
GIL: Python threads then run ranges side by side. Every MuJoCo call, and every
rounding that matters, comes in robosuite's order; a test compares the motions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import SimulationError
from rlco.physics.arm_control import integers, read_control, read_gains
from rlco.physics.copies import Copies
from rlco.physics.domain import Domain
from rlco.physics.effect_kernels import look_range
from rlco.physics.effect_sim import mended_model_of
from rlco.physics.mended_model import Given, given_effects
from rlco.physics.native_kernels import OBJECTS, Tracked, reset_range, step_range
from rlco.physics.task import Array, InitialState, SceneState, Task, check_actions

OnDivergence = Literal["raise", "mark"]


class NativeStepper:
    """N copies of a task's robosuite model, stepped in threads.

    Args:
        task: The task.
        domain: What differs from the simulator as built.
        num_envs: Number of copies.
        threads: Python threads; by default one a core, at most `num_envs`.
        exact: Compute torques with robosuite's own linear algebra: about a third
            slower, and equal to robosuite through impacts too. Without it torques
            differ by 1e-12 of rounding.
        variation: A named variation of the scene.
        on_divergence: ``raise``, or ``mark`` a copy that diverges in `diverged` and
            leave it alone until its reset; its state stays the last sound one.
        effects: Effects to add to the model: a list, or the path of an
            ``effects.yaml``.

    Raises:
        RlcoError: If an effect cannot be applied; names it.

    Example:
        >>> from rlco.physics.domain import SIM
        >>> from rlco.physics.push_cube import TASK
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
        domain: Domain,
        *,
        num_envs: int,
        threads: int | None = None,
        exact: bool = False,
        variation: str | None = None,
        on_divergence: OnDivergence = "raise",
        effects: Given = None,
    ) -> None:
        from rlco.physics.tabletop import Tabletop

        self.task = task
        self.domain = domain
        self.num_envs = num_envs
        self._on_divergence = on_divergence
        given = given_effects(effects)
        source = Tabletop(task, domain, variation=variation, effects=given)
        source.start(task.sample(np.random.default_rng(0), variation))
        self.copies = Copies(
            source.sim.model._model,
            read_control(source, exact=exact),
            read_gains(source),
            num_envs=num_envs,
            threads=threads,
            command_delay=domain.command_delay,
            believed=mended_model_of(source.sim).believed,
        )
        self.tracked = _tracked(source)
        tracked = self.tracked
        size = OBJECTS + 7 * tracked.objects.size + tracked.fixture_qpos.size
        self.features: Array = np.zeros((num_envs, size))
        self.goals = np.zeros((num_envs, len(task.goals), 7))
        self.instruction_id = np.zeros(num_envs, dtype=np.int64)

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model of all copies."""
        return self.copies.model

    def model_of(self, number: int) -> mujoco.MjModel:
        """Return one copy's model, for pictures of it; valid until the next call."""
        return self.copies.model_of(number)

    @property
    def data(self) -> list[mujoco.MjData]:
        """MuJoCo's state of each copy."""
        return self.copies.data

    @property
    def diverged(self) -> NDArray[np.bool_]:
        """Which copies have diverged since their reset, shape (N,)."""
        return self.copies.memory.broken

    def reset(
        self, initial: list[InitialState], which: NDArray[np.int64] | None = None
    ) -> SceneState:
        """Start episodes in the copies `which` (all by default).

        Args:
            initial: One start for each of `which`.
            which: Indices of copies, shape (R,).

        Returns:
            The state of all copies, leading axes (N,).
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
        memory = self.copies.memory
        factor, offset = self.copies.control.acting.told[:, self.tracked.arm_qpos]
        memory.posture[which] = factor * joints + offset
        memory.grip[which] = np.stack([start.gripper_goal() for start in initial])
        self.copies.forget(which)
        # New arrays: states returned earlier hold views of the old ones.
        self.features, self.goals = self.features.copy(), self.goals.copy()
        self.instruction_id = self.instruction_id.copy()
        self.goals[which] = goals
        self.instruction_id[which] = [start.instruction_id for start in initial]
        reset_range(
            which,
            memory,
            self.tracked,
            joints,
            np.array([start.gripper_opening / 2.0 for start in initial]),
            np.stack([start.object_pose for start in initial]),
            goals,
            np.stack([start.fixture_opening() for start in initial]),
            self.features,
        )
        look_range(which, self.copies.control, memory)
        return self.scene_state()

    def step(
        self, actions: Array, steps: NDArray[np.int64] | None = None
    ) -> SceneState:
        """Execute action chunks, shape (N, H, 7), in all copies.

        Args:
            actions: Each number in [-1, 1]; what lies outside is clipped.
            steps: How many of the H steps each copy executes, shape (N,); all by
                default.

        Returns:
            The state before the first and after each control step, leading axes
            (N, H + 1); rows beyond `steps`, and those of copies that have diverged,
            repeat the last sound one.

        Raises:
            RlcoError: If an action is NaN or infinite.
            SimulationError: If a copy diverges, unless those are marked.
        """
        check_actions(actions)
        count, horizon, _ = actions.shape
        if steps is None:
            steps = np.full(count, horizon, dtype=np.int64)
        out = np.empty((count, horizon + 1, self.features.shape[1]))
        out[:, 0] = self.features
        self.copies.run(
            step_range,
            self.copies.control,
            self.copies.memory,
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
        return scene_of(out, self.tracked.objects.size, goals, ids)

    def randomise(
        self,
        which: NDArray[np.int64] | Sequence[int],
        fields: Mapping[str, NDArray[Any]] | None = None,
        *,
        stiffness: NDArray[Any] | float | None = None,
        damping: NDArray[Any] | float | None = None,
        command_delay: NDArray[Any] | int | None = None,
    ) -> None:
        """Change the copies `which` alone, until told otherwise; see `Copies`.

        Raises:
            RlcoError: If a name, a shape or a number is not allowed.
        """
        self.copies.randomise(
            which,
            fields,
            stiffness=stiffness,
            damping=damping,
            command_delay=command_delay,
        )

    def scene_state(self) -> SceneState:
        """Return the present state of all copies, leading axes (N,)."""
        return scene_of(
            self.features, self.tracked.objects.size, self.goals, self.instruction_id
        )

    def reported_state(self) -> SceneState:
        """Return the same with robots where their encoders tell that they are."""
        state, control = self.scene_state(), self.copies.control
        if not control.acting.believed:
            return state
        tool, rotation = state.tool_position.copy(), state.tool_rotation.copy()
        for number in np.flatnonzero(~self.diverged).tolist():
            data = self.copies.seen[number]
            tool[number] = data.site_xpos[control.site]
            rotation[number] = data.site_xmat[control.site].reshape(3, 3)
        factor, offset = control.acting.told[:, self.tracked.arm_qpos]
        return replace(
            state,
            tool_position=tool,
            tool_rotation=rotation,
            joint_position=factor * state.joint_position + offset,
        )


def scene_of(
    features: Array, objects: int, goals: Array, ids: NDArray[np.int64]
) -> SceneState:
    """Read what a native kernel wrote down of a scene.

    Args:
        features: (..., F), as `rlco.physics.native_kernels.read_features` writes them.
        objects: How many free objects there are.
        goals: Position and quaternion of what the episode places, (..., G, 7).
        ids: The episode's instruction, (...,).
    """
    end = OBJECTS + 7 * objects
    poses = features[..., OBJECTS:end].reshape(*features.shape[:-1], -1, 7)
    return SceneState(
        tool_position=features[..., :3],
        tool_rotation=features[..., 3:12].reshape(*features.shape[:-1], 3, 3),
        gripper_opening=features[..., 12] - features[..., 13],
        joint_position=features[..., 14:21],
        object_position=poses[..., :3],
        object_quaternion=poses[..., 3:],
        joint_opening=features[..., end:],
        goal_position=goals[..., :3],
        goal_quaternion=goals[..., 3:],
        instruction_id=ids,
    )


def _tracked(source: Any) -> Tracked:
    """Read from robosuite where the features of its scene lie."""
    robot = source.robots[0]
    joints = [o.joints[0] for o in source.loose]
    address = [source.sim.model.get_joint_qpos_addr(j)[0] for j in joints]
    return Tracked(
        site=int(robot.eef_site_id["right"]),
        finger=int(robot._ref_gripper_joint_pos_indexes["right"][0]),
        nq=int(source.sim.model._model.nq),
        arm_qpos=integers(robot.part_controllers["right"].qpos_index),
        objects=integers(source.object_ids),
        object_joints=integers(address),
        mocap=integers(source.mocap_ids),
        fixture_qpos=integers(source.fixture_qpos),
    )
