"""Step N copies of a robosuite model without robosuite's Python.

robosuite spends most of a control step in Python between two MuJoCo calls. Here
the same compiled model is stepped by one compiled function that calls MuJoCo and
computes the controller's torques in between, for a range of copies, without the
GIL: Python threads then run ranges side by side. Every MuJoCo call, and every
rounding that matters, comes in robosuite's order; a test compares the motions.
"""

from __future__ import annotations

import copy
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import SimulationError
from rlco.physics.domain import Domain
from rlco.physics.libmujoco import address_of
from rlco.physics.native_kernels import FIELDS, OBJECTS, reset_range, step_range
from rlco.physics.task import Array, InitialState, SceneState, Task, check_actions


@dataclass(frozen=True)
class Layout:
    """Where the robot and the objects lie in the model's arrays, and its gains."""

    integers: NDArray[np.int64]  # see `_layout`
    objects: NDArray[np.int64]  # tracked bodies, shape (K,)
    mocap: NDArray[np.int64]  # marks, shape (G,)
    object_joints: NDArray[np.int64]  # first qpos of each object's joint, (K,)
    arm_qpos: NDArray[np.int64]
    arm_dof: NDArray[np.int64]
    mass_address: NDArray[np.int64]  # dof_Madr, shape (nv,)
    parent: NDArray[np.int64]  # dof_parentid, shape (nv,)
    arm_range: Array  # actuator limits, shape (7, 2), [N m]
    finger_range: Array  # shape (2, 2), [m]
    gains: Array  # kp (6), kd (6), output scale (6)
    base: Array  # controller origin: position (3), rotation (9)


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
    ) -> None:
        from rlco.physics.tabletop import Tabletop

        self.task = task
        self.domain = domain
        self.num_envs = num_envs
        self.exact = exact
        source = Tabletop(task, domain)
        source.start(task.sample(np.random.default_rng(0), None))
        self.model: mujoco.MjModel = copy.copy(source.sim.model._model)
        # A diverged state must show as NaN, not start over from the model's zero.
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.layout = _layout(source)
        self.data = [mujoco.MjData(self.model) for _ in range(num_envs)]
        rows = [
            [d._address, *(address_of(getattr(d, name)) for name in FIELDS)]
            for d in self.data
        ]
        self._fields = np.array(rows, dtype=np.int64)
        size = OBJECTS + 7 * len(task.objects)
        self.features: Array = np.zeros((num_envs, size))
        self.goals = np.zeros((num_envs, len(task.goals), 3))
        self.instruction_id = np.zeros(num_envs, dtype=np.int64)
        self._posture = np.zeros((num_envs, 7))
        self._grip = np.zeros((num_envs, 2))
        self._pending = np.zeros((num_envs, domain.command_delay, 7))
        count = min(threads or os.cpu_count() or 1, num_envs)
        self._pool = ThreadPoolExecutor(count) if count > 1 else None
        # Several ranges a thread: copies in contact take longer than others.
        parts = min(num_envs, 4 * count) if count > 1 else 1
        edges = np.linspace(0, num_envs, parts + 1).astype(int)
        self._ranges = list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))

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
        lay = self.layout
        joints = np.stack([start.joint_position for start in initial])
        goals = np.stack([start.goal_position for start in initial])
        poses = np.stack([start.object_pose for start in initial])
        self._posture[which] = joints
        self._grip[which] = (-1.0, 1.0)
        self._pending[which] = 0.0
        # New arrays: states returned earlier hold views of the old ones.
        self.features, self.goals = self.features.copy(), self.goals.copy()
        self.instruction_id = self.instruction_id.copy()
        self.goals[which] = goals
        self.instruction_id[which] = [start.instruction_id for start in initial]
        reset_range(
            which,
            self.model._address,
            self._fields,
            lay.integers,
            lay.objects,
            lay.mocap,
            lay.object_joints,
            lay.arm_qpos,
            joints,
            poses,
            goals,
            self.features,
        )
        return self._scene(self.features, self.goals, self.instruction_id)

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
            (N, H + 1); rows beyond `steps` repeat the last executed one.

        Raises:
            RlcoError: If an action is NaN or infinite.
            SimulationError: If a copy diverges.
        """
        check_actions(actions)
        count, horizon, _ = actions.shape
        if steps is None:
            steps = np.full(count, horizon, dtype=np.int64)
        out = np.empty((count, horizon + 1, self.features.shape[1]))
        out[:, 0] = self.features
        lay = self.layout
        arguments = (
            self.exact,
            self.model._address,
            self._fields,
            lay.integers,
            lay.objects,
            lay.arm_qpos,
            lay.arm_dof,
            lay.mass_address,
            lay.parent,
            lay.arm_range,
            lay.finger_range,
            lay.gains,
            lay.base,
            self._posture,
            self._grip,
            self._pending,
            np.ascontiguousarray(actions, dtype=np.float64),
            steps,
            out,
        )
        if self._pool is None:
            step_range(0, count, *arguments)
        else:
            jobs = [self._pool.submit(step_range, *r, *arguments) for r in self._ranges]
            for job in jobs:
                job.result()
        for e in np.flatnonzero(steps < horizon):
            out[e, steps[e] + 1 :] = out[e, steps[e]]
        if not np.isfinite(out).all():
            broken = np.flatnonzero(~np.isfinite(out).all(axis=(1, 2))).tolist()
            raise SimulationError(self.task.name, broken)
        self.features = out[:, -1].copy()
        lead = (count, horizon + 1)
        goals = np.broadcast_to(self.goals[:, None], (*lead, *self.goals.shape[1:]))
        ids = np.broadcast_to(self.instruction_id[:, None], lead)
        return self._scene(out, goals, ids)

    def scene_state(self) -> SceneState:
        """Return the present state of all copies, leading axes (N,)."""
        return self._scene(self.features, self.goals, self.instruction_id)

    def _scene(
        self, features: Array, goals: Array, ids: NDArray[np.int64]
    ) -> SceneState:
        lead = features.shape[:-1]
        objects = features[..., OBJECTS:].reshape(*lead, -1, 7)
        return SceneState(
            tool_position=features[..., :3],
            tool_rotation=features[..., 3:12].reshape(*lead, 3, 3),
            gripper_opening=features[..., 12] - features[..., 13],
            joint_position=features[..., 14:21],
            object_position=objects[..., :3],
            object_quaternion=objects[..., 3:],
            goal_position=goals,
            instruction_id=ids,
        )


def _layout(source: Any) -> Layout:
    """Read where everything lies, and the controller's gains, from robosuite."""
    robot = source.robots[0]
    arm = robot.part_controllers["right"]
    model = source.sim.model._model
    arm_ctrl = robot._ref_actuators_indexes_dict["right"]
    finger_ctrl = robot._ref_joint_gripper_actuator_indexes["right"]
    finger_qpos = robot._ref_gripper_joint_pos_indexes["right"]
    substeps = int(source.control_timestep / source.model_timestep)
    joints = [o.joints[0] for o in source.objects[: len(source.task.objects)]]
    address = [source.sim.model.get_joint_qpos_addr(j)[0] for j in joints]

    def integers(values: Any) -> NDArray[np.int64]:
        return np.array(values, dtype=np.int64)

    return Layout(
        integers=integers(
            [
                robot.eef_site_id["right"],
                finger_qpos[0],
                arm_ctrl[0],
                finger_ctrl[0],
                model.nq,
                model.nv,
                substeps,
                model.nM,
            ]
        ),
        objects=integers(source.object_ids),
        mocap=integers(source.mocap_ids),
        object_joints=integers(address),
        arm_qpos=integers(arm.qpos_index),
        arm_dof=integers(arm.qvel_index),
        mass_address=integers(model.dof_Madr),
        parent=integers(model.dof_parentid),
        arm_range=model.actuator_ctrlrange[arm_ctrl].copy(),
        finger_range=model.actuator_ctrlrange[finger_ctrl].copy(),
        gains=np.concatenate([arm.kp, arm.kd, arm.output_max]),
        base=np.concatenate([arm.origin_pos, np.ravel(arm.origin_ori)]),
    )
