"""How a task's episodes start, as numbers with their spread.

A log tells some of these numbers; the others are what the task's own draws make likely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from rlco.gap.log import Array
from rlco.gap.task_channels import report
from rlco.gap.task_plants import Plants
from rlco.gap.task_rollouts import Start
from rlco.physics.task import FINGER_HALF_RANGE, InitialState, SceneState

_DRAWS = 200
_STEP = 1e-5  # of finite differences [m or rad]
_ROUNDS = 3  # of Gauss and Newton


@dataclass(frozen=True)
class Layout:
    """Where each kind of number lies: joints, opening, objects, marks, fixtures."""

    objects: int
    marks: int
    fixtures: int

    @property
    def object_part(self) -> slice:
        """x, y, z and yaw of each object."""
        return slice(8, 8 + 4 * self.objects)

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
    """The likely starts of a task, and what would be reported of one.

    Args:
        plants: The task's model.

    Attributes:
        layout: Where the numbers of a start lie.
        mean: Of each number over the task's draws, (P,).
        spread: Its standard deviation, (P,).
    """

    def __init__(self, plants: Plants) -> None:
        self._plants = plants
        self._model = plants.nominal.model
        self._data = mujoco.MjData(self._model)
        task = plants.task
        rng = np.random.default_rng(0)
        draws = [task.sample(rng, None) for _ in range(_DRAWS)]
        count = len(task.objects)
        self.layout = Layout(count, len(task.goals), len(task.fixture_joints))
        self._turns = draws[0].object_pose[:count, 3:]
        self._mark_turns = draws[0].goal_orientation()
        numbers = self._numbers(draws)
        self.mean, self.spread = numbers.mean(axis=0), numbers.std(axis=0)

    def poses(self, numbers: Array) -> tuple[Array, Array]:
        """Return the poses (w, x, y, z) of objects and of marks, (..., 7) each."""
        layout = self.layout
        lead = numbers.shape[:-1]
        both = []
        for part, first in (
            (layout.object_part, self._turns),
            (layout.mark_part, self._mark_turns),
        ):
            rows = numbers[..., part].reshape(*lead, -1, 4)
            half = rows[..., 3] / 2.0
            zero = np.zeros_like(half)
            turn = np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)
            quaternion = _product(turn, np.broadcast_to(first, turn.shape))
            both.append(np.concatenate([rows[..., :3], quaternion], axis=-1))
        return both[0], both[1]

    def start(self, numbers: Array) -> Start:
        """Return a start as a state at rest."""
        tracked = self._plants.nominal.tracked
        qpos = self._model.qpos0.copy()
        objects, marks = self.poses(numbers)
        qpos[tracked.arm_qpos] = numbers[:7]
        qpos[[tracked.finger, tracked.finger + 1]] = numbers[7] / 2.0, -numbers[7] / 2.0
        for address, pose in zip(tracked.object_joints, objects, strict=True):
            qpos[address : address + 7] = pose
        qpos[tracked.fixture_qpos] = numbers[self.layout.fixture_part]
        side = numbers[7] / 2.0 / FINGER_HALF_RANGE - 1.0
        return Start(
            qpos,
            np.zeros(self._model.nv),
            marks,
            numbers[:7].copy(),
            np.array([side, -side]),
        )

    def reported(self, numbers: Array) -> Array:
        """Return what would be told of starts, in the order of the known names.

        Args:
            numbers: Of each start, (N, P).

        Returns:
            (N, known names).
        """
        tracked = self._plants.nominal.tracked
        objects, marks = self.poses(numbers)
        bodies, sites = tracked.objects, len(numbers)
        place, turn = np.empty((sites, 3)), np.empty((sites, 3, 3))
        body, quaternion = (np.empty((sites, len(bodies), n)) for n in (3, 4))
        model, data = self._model, self._data
        for row, one in enumerate(numbers):
            data.qpos[tracked.arm_qpos] = one[:7]
            for address, pose in zip(tracked.object_joints, objects[row], strict=True):
                data.qpos[address : address + 7] = pose
            data.mocap_pos[tracked.mocap] = marks[row, :, :3]
            data.mocap_quat[tracked.mocap] = marks[row, :, 3:]
            data.qpos[tracked.fixture_qpos] = one[self.layout.fixture_part]
            mujoco.mj_kinematics(model, data)
            place[row] = data.site_xpos[tracked.site]
            turn[row] = data.site_xmat[tracked.site].reshape(3, 3)
            body[row], quaternion[row] = data.xpos[bodies], data.xquat[bodies]
        state = SceneState(
            tool_position=place,
            tool_rotation=turn,
            gripper_opening=numbers[:, 7],
            joint_position=numbers[:, :7],
            object_position=body,
            object_quaternion=quaternion,
            joint_opening=numbers[:, self.layout.fixture_part],
            goal_position=marks[..., :3],
            goal_quaternion=marks[..., 3:],
            instruction_id=np.zeros(sites, dtype=np.int64),
        )
        return report(self._plants.task, self._plants.domain, state)

    def likeliest(
        self, told: Array, columns: list[int], noise: Array, mean: Array
    ) -> Array:
        """Return the start that is likeliest, given what was told of it, (P,).

        The maximum of the posterior under normal priors and noise, by Gauss-Newton.

        Args:
            told: What was told, (columns,).
            columns: Where that is among the known names.
            noise: Standard deviation of each, (columns,).
            mean: Of the prior, (P,).
        """
        numbers = mean.copy()
        weight = 1.0 / np.maximum(self.spread, 1e-6)
        for _ in range(_ROUNDS):
            here, slope = self.slopes(numbers, columns)
            rows = np.concatenate([slope / noise[:, None], np.diag(weight)])
            goal = np.concatenate([(told - here) / noise, weight * (mean - numbers)])
            numbers = numbers + np.linalg.lstsq(rows, goal, rcond=None)[0]
        return numbers

    def slopes(self, numbers: Array, columns: list[int]) -> tuple[Array, Array]:
        """Return what is told of a start, and how it changes with each number.

        Returns:
            (columns,) and (columns, P).
        """
        moved = np.concatenate([numbers[None], numbers + _STEP * np.eye(numbers.size)])
        told = self.reported(moved)[:, columns]
        return told[0], (told[1:] - told[0]).T / _STEP

    def _numbers(self, draws: Sequence[InitialState]) -> Array:
        """Return draws as numbers, (draws, P)."""
        count = self.layout.objects
        objects = np.stack([draw.object_pose[:count] for draw in draws])
        marks = np.stack([draw.goal_position for draw in draws])
        turned = np.stack([draw.goal_orientation() for draw in draws])
        both = [
            np.concatenate([place, _yaws(turn, first)[..., None]], axis=-1)
            for place, turn, first in (
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
    """Return the turns about z from quaternions (w, x, y, z) to others, [rad]."""
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
