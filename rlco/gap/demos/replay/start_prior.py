"""Prior over the initial states of a task's episodes.

A log observes some of the parameters; the others follow the task's own distribution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from rlco.gap.demos.replay.channels import report
from rlco.gap.demos.replay.plants import Plants
from rlco.gap.demos.replay.rollouts import Start
from rlco.gap.logs.log import Array
from rlco.physics.native.kernels import POSE_SIZE
from rlco.physics.spec.task import InitialState, SceneState

_DRAWS = 200
_STEP = 1e-5  # of finite differences [m or rad]
_ROUNDS = 3  # Gauss-Newton iterations


@dataclass(frozen=True)
class Layout:
    """Slices of the parameters: joints, opening, objects, marks, fixtures."""

    joints: int
    objects: int
    marks: int
    fixtures: int

    @property
    def joint_part(self) -> slice:
        """The arm's joints."""
        return slice(0, self.joints)

    @property
    def object_part(self) -> slice:
        """x, y, z and yaw of each object."""
        first = self.joints + 1  # the opening lies between
        return slice(first, first + 4 * self.objects)

    @property
    def mark_part(self) -> slice:
        """x, y, z and yaw of each mark."""
        first = self.object_part.stop
        return slice(first, first + 4 * self.marks)

    @property
    def fixture_part(self) -> slice:
        """Position of each fixture's joint."""
        first = self.mark_part.stop
        return slice(first, first + self.fixtures)


class Starts:
    """The distribution of a task's initial states, and their reports.

    Args:
        plants: The task's model.

    Attributes:
        layout: Slices of an initial state's parameters.
        mean: Of each parameter over the task's draws, (P,).
        deviation: Standard deviation of each, (P,).
    """

    def __init__(self, plants: Plants) -> None:
        self._plants = plants
        self._model = plants.nominal.model
        self._data = mujoco.MjData(self._model)
        task = plants.task
        rng = np.random.default_rng(0)
        draws = [task.sample(rng, None) for _ in range(_DRAWS)]
        count = len(task.objects)
        self.layout = Layout(
            len(task.robot.joints), count, len(task.goals), len(task.fixture_joints)
        )
        self._turns = draws[0].object_pose[:count, 3:]
        self._mark_turns = draws[0].goal_orientation()
        parameters = self._parameters(draws)
        self.mean, self.deviation = parameters.mean(axis=0), parameters.std(axis=0)

    def poses(self, parameters: Array) -> tuple[Array, Array]:
        """Return the poses (w, x, y, z) of objects and of marks, (..., 7) each."""
        layout = self.layout
        lead = parameters.shape[:-1]
        both = []
        for part, first in (
            (layout.object_part, self._turns),
            (layout.mark_part, self._mark_turns),
        ):
            rows = parameters[..., part].reshape(*lead, -1, 4)
            half = rows[..., 3] / 2.0
            zero = np.zeros_like(half)
            turn = np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)
            quaternion = _product(turn, np.broadcast_to(first, turn.shape))
            both.append(np.concatenate([rows[..., :3], quaternion], axis=-1))
        return both[0], both[1]

    def start(self, parameters: Array) -> Start:
        """Return the state at rest with these parameters."""
        tracked = self._plants.nominal.tracked
        qpos = self._model.qpos0.copy()
        objects, marks = self.poses(parameters)
        robot = self._plants.task.robot
        joints, opening = (
            parameters[self.layout.joint_part],
            parameters[self.layout.joints],
        )
        qpos[tracked.arm_qpos] = joints
        qpos[[tracked.finger, tracked.finger + 1]] = robot.fingers(opening)
        for address, pose in zip(tracked.object_joints, objects, strict=True):
            qpos[address : address + POSE_SIZE] = pose
        qpos[tracked.fixture_qpos] = parameters[self.layout.fixture_part]
        return Start(
            qpos,
            np.zeros(self._model.nv),
            marks,
            joints.copy(),
            robot.gripper_goal(opening),
        )

    def reported(self, parameters: Array) -> Array:
        """Return the sensors' report of initial states, in the order of known names.

        Args:
            parameters: Of each initial state, (N, P).

        Returns:
            (N, known names).
        """
        tracked = self._plants.nominal.tracked
        objects, marks = self.poses(parameters)
        bodies, sites = tracked.objects, len(parameters)
        position, turn = np.empty((sites, 3)), np.empty((sites, 3, 3))
        body, quaternion = (np.empty((sites, len(bodies), n)) for n in (3, 4))
        model, data = self._model, self._data
        for row, one in enumerate(parameters):
            data.qpos[tracked.arm_qpos] = one[self.layout.joint_part]
            for address, pose in zip(tracked.object_joints, objects[row], strict=True):
                data.qpos[address : address + POSE_SIZE] = pose
            data.mocap_pos[tracked.mocap] = marks[row, :, :3]
            data.mocap_quat[tracked.mocap] = marks[row, :, 3:]
            data.qpos[tracked.fixture_qpos] = one[self.layout.fixture_part]
            mujoco.mj_kinematics(model, data)
            position[row] = data.site_xpos[tracked.site]
            turn[row] = data.site_xmat[tracked.site].reshape(3, 3)
            body[row], quaternion[row] = data.xpos[bodies], data.xquat[bodies]
        state = SceneState(
            tool_position=position,
            tool_rotation=turn,
            gripper_opening=parameters[:, self.layout.joints],
            joint_position=parameters[:, self.layout.joint_part],
            object_position=body,
            object_quaternion=quaternion,
            joint_opening=parameters[:, self.layout.fixture_part],
            goal_position=marks[..., :3],
            goal_quaternion=marks[..., 3:],
            instruction_id=np.zeros(sites, dtype=np.int64),
        )
        return report(self._plants.task, self._plants.domain, state)

    def likeliest(
        self, observed: Array, columns: list[int], noise: Array, mean: Array
    ) -> Array:
        """Return the most likely initial state, given observations of it, (P,).

        The maximum of the posterior under normal priors and noise, by Gauss-Newton.

        Args:
            observed: Observations, (columns,).
            columns: Their indices among the known names.
            noise: Standard deviation of each, (columns,).
            mean: Of the prior, (P,).
        """
        parameters = mean.copy()
        weight = 1.0 / np.maximum(self.deviation, 1e-6)
        for _ in range(_ROUNDS):
            here, slope = self.slopes(parameters, columns)
            rows = np.concatenate([slope / noise[:, None], np.diag(weight)])
            goal = np.concatenate(
                [(observed - here) / noise, weight * (mean - parameters)]
            )
            parameters = parameters + np.linalg.lstsq(rows, goal, rcond=None)[0]
        return parameters

    def slopes(self, parameters: Array, columns: list[int]) -> tuple[Array, Array]:
        """Return the report of an initial state and its Jacobian.

        Returns:
            (columns,) and (columns, P).
        """
        moved = np.concatenate(
            [parameters[None], parameters + _STEP * np.eye(parameters.size)]
        )
        observed = self.reported(moved)[:, columns]
        return observed[0], (observed[1:] - observed[0]).T / _STEP

    def _parameters(self, draws: Sequence[InitialState]) -> Array:
        """Return draws as parameters, (draws, P)."""
        count = self.layout.objects
        objects = np.stack([draw.object_pose[:count] for draw in draws])
        marks = np.stack([draw.goal_position for draw in draws])
        turned = np.stack([draw.goal_orientation() for draw in draws])
        both = [
            np.concatenate([position, _yaws(turn, first)[..., None]], axis=-1)
            for position, turn, first in (
                (objects[..., :3], objects[..., 3:], self._turns),
                (marks, turned, self._mark_turns),
            )
        ]
        return np.concatenate(
            [
                np.stack([draw.joint_position for draw in draws]),
                np.array([[draw.gripper_opening] for draw in draws]),
                *(part.reshape(len(draws), -1) for part in both),
                np.stack([draw.fixture_opening() for draw in draws]),
            ],
            axis=1,
        )


def _yaws(turns: Array, first: Array) -> Array:
    """Return the rotations about z from quaternions (w, x, y, z) to others, [rad]."""
    back = first * np.array([1.0, -1.0, -1.0, -1.0])
    apart = _product(turns, np.broadcast_to(back, turns.shape))
    return 2.0 * np.arctan2(apart[..., 3], apart[..., 0])


def _product(a: Array, b: Array) -> Array:
    """Return the product of quaternions (w, x, y, z), (..., 4)."""
    w, v = a[..., :1], a[..., 1:]
    s, u = b[..., :1], b[..., 1:]
    scalar = w * s - (v * u).sum(axis=-1, keepdims=True)
    vector = w * u + s * v + np.cross(v, u)
    return np.concatenate([scalar, vector], axis=-1)
