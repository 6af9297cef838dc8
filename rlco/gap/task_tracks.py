"""What a log tells of the simulator's state at each of its rows.

A log holds less than a state: the tool's pose and perhaps not the joints, where objects
lie and perhaps not how they are turned. What is not told is taken from how the task's
episodes start, and from the controller, which pulls an arm to its first posture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from rlco.gap.log import Array
from rlco.gap.task_channels import ARM_JOINTS, known_names
from rlco.gap.task_flight import Path, grip_after, in_flight, is_late
from rlco.gap.task_overlap import separate
from rlco.gap.task_prior import Starts
from rlco.gap.task_rollouts import Job, Rollouts, Start
from rlco.physics.arm_control import Control
from rlco.physics.observation import BASE_POSITION, STATE_NAMES
from rlco.physics.task import FINGER_HALF_RANGE

_WIDE = 0.5  # by how much objects and drawers may move in an episode [m]
_WINDOW = 4  # rows to either side that tell a resting place better than one row does
# A tool that is found away from where it was simulated was also faster or slower, by
# so much for each metre: an error in speed fades to a fifth in a control step of 50 ms
# (critically damped, 150 / s^2), and leaves 27 ms of its way.
_PULL = 8.0
_ROUNDS = 3  # of Newton's method; a control step moves a joint by some 0.05 rad
_FINEST = 1e-5  # no column is believed more closely [m or rad]


@dataclass(frozen=True)
class Track:
    """The state at each row of one recording; T rows.

    Attributes:
        qpos: (T, nq).
        qvel: (T, nv).
        marks: What the episode places, (G, 7).
        grip: The gripper's goals before the first action, (2,).
        posture: Where the controller pulls the arm, (7,) [rad].
        path: Where the tool was.
    """

    qpos: Array
    qvel: Array
    marks: Array
    grip: Array
    posture: Array
    path: Path

    def start(self, control: Control, actions: Array, row: int) -> Start:
        """Return the state at a row, under a controller that was told these actions."""
        flight = None
        if row > 0 and is_late(control):
            flight = in_flight(control, actions, self.path, row)
        return Start(
            self.qpos[row],
            self.qvel[row],
            self.marks,
            self.posture,
            grip_after(control, actions, self.grip, row),
            row > 0,
            flight,
        )


@dataclass(frozen=True)
class _Told:
    """What one recording tells, in the model's terms; T rows.

    Attributes:
        path: Where the tool was.
        joints: The arm's, (T, 7); None where they are not told.
        opening: Between the fingers, (T,); None where it is not told.
        numbers: As `Starts` orders them, (T, P).
        poses: Of the objects, (T, K, 7).
    """

    path: Path
    joints: Array | None
    opening: Array | None
    numbers: Array
    poses: Array


class Tracker:
    """Estimates tracks.

    The simulator follows the recording: after each control step its tool is moved to
    where it was measured, and its objects to where they were seen. What is not told
    (how the elbow stands, how an object is turned) goes on as simulated.

    Args:
        rollouts: Simulations of the task.
        names: Names of the columns that are told.
        noise: Standard deviation of each, (names,).
    """

    def __init__(self, rollouts: Rollouts, names: Sequence[str], noise: Array) -> None:
        self._rollouts, self._plants = rollouts, rollouts.plants
        self._names = list(names)
        known = known_names(self._plants.task)
        self._columns = [known.index(name) for name in names]
        self._noise = np.maximum(noise, _FINEST)
        self._starts = Starts(self._plants)
        self._model = self._plants.nominal.model
        self._data = mujoco.MjData(self._model)
        self._robot = robot_geoms(self._model)
        self._period = 1.0 / self._plants.task.control_frequency
        robot = {*STATE_NAMES, *ARM_JOINTS}
        self._scene = [i for i, name in enumerate(names) if name not in robot]
        # Which numbers of the scene the columns tell of.
        columns = [self._columns[i] for i in self._scene]
        _, slope = self._starts.slopes(self._starts.mean, columns)
        self._seen = np.abs(slope).max(axis=0, initial=0.0) > 1e-6

    def tracks(
        self,
        told: Sequence[Array],
        actions: Sequence[Array],
        rng: np.random.Generator | None = None,
    ) -> list[Track]:
        """Estimate the states of recordings.

        Args:
            told: The columns of each, (T, names).
            actions: The actions of each, (T, 7).
            rng: Where given, what is told gets noise of its own size once more, and
                what is not told comes from a drawn start: two such tracks differ as
                two estimates of the same track do.
        """
        ready, nominal = [self._ready(rows, rng) for rows in told], self._plants.nominal
        jobs = [
            Job(nominal, self._starts.start(one.numbers[0]), rows[:-1])
            for one, rows in zip(ready, actions, strict=True)
        ]
        qpos = [np.empty((len(rows), self._model.nq)) for rows in told]
        qvel = [np.empty((len(rows), self._model.nv)) for rows in told]
        speeds = [np.gradient(one.numbers, self._period, axis=0) for one in ready]

        def correct(job: int, row: int, data: mujoco.MjData) -> None:
            self._correct(ready[job], row, data)
            self._set_speeds(speeds[job][row], data)
            qpos[job][row], qvel[job][row] = data.qpos, data.qvel

        self._rollouts.follow(jobs, correct)
        return [
            Track(q, v, job.start.marks, job.start.grip, job.start.posture, one.path)
            for q, v, job, one in zip(qpos, qvel, jobs, ready, strict=True)
        ]

    def _ready(self, told: Array, rng: np.random.Generator | None) -> _Told:
        told, mean = told.copy(), self._starts.mean
        if rng is not None:
            told += self._noise * rng.standard_normal(told.shape)
            mean = mean + self._starts.spread * rng.standard_normal(mean.shape)
        told[:, self._scene] = rested(told[:, self._scene], self._noise[self._scene])
        first = self._starts.likeliest(told[0], self._columns, self._noise, mean)
        path, joints = self._path(told), self._of(told, ARM_JOINTS)
        numbers = self._moved(told, first)
        numbers[:, :7] = self._reach(path, 0, first[:7]) if joints is None else joints
        opening = self._of(told, STATE_NAMES[6:])
        if opening is not None:
            opening = opening[:, 0] - self._plants.domain.gripper_offset
            opening = np.clip(opening, 0.0, 4 * FINGER_HALF_RANGE)
            numbers[:, 7] = opening
        return _Told(path, joints, opening, numbers, self._starts.poses(numbers)[0])

    def _moved(self, told: Array, first: Array) -> Array:
        """Return the numbers of a start, moved to what is told of the scene, (T, P)."""
        layout = self._starts.layout
        moving = np.r_[layout.object_part, layout.fixture_part]
        numbers = np.tile(first, (len(told), 1))
        columns = [self._columns[i] for i in self._scene]
        if not columns or not moving.size:
            return numbers
        noise = self._noise[self._scene]
        # Linear in places and openings, so one step of least squares is enough.
        here, slope = self._starts.slopes(first, columns)
        slope, left = slope[:, moving] / noise[:, None], told[:, self._scene] - here
        left = left / noise
        normal = slope.T @ slope + np.eye(moving.size) / _WIDE**2
        numbers[:, moving] += np.linalg.solve(normal, slope.T @ left.T).T
        for column, (low, high) in enumerate(self._fixture_ranges()):
            part = numbers[:, layout.fixture_part][:, column]
            np.clip(part, low, high, out=part)
        return numbers

    def _correct(self, told: _Told, row: int, data: mujoco.MjData) -> None:
        """Move a simulation to what is told of a row."""
        tracked, layout = self._plants.nominal.tracked, self._starts.layout
        numbers, dofs = told.numbers[row], self._plants.control.arm_dof
        if told.joints is not None:
            data.qpos[tracked.arm_qpos] = told.joints[row]
        elif row > 0:
            simulated = data.qpos[tracked.arm_qpos].copy()
            # Like robosuite, the simulator tells where the tool was one step before.
            ahead = float(self._model.opt.timestep) * data.qvel[dofs]
            joints = self._reach(told.path, row, simulated - ahead) + ahead
            data.qpos[tracked.arm_qpos] = joints
            data.qvel[dofs] += _PULL * (joints - simulated)
        if told.opening is not None:
            half = told.opening[row] / 2.0
            data.qpos[[tracked.finger, tracked.finger + 1]] = half, -half
        poses = told.poses[row]
        seen = self._seen[layout.object_part].reshape(-1, 4)
        for number, address in enumerate(tracked.object_joints):
            place = data.qpos[address : address + 3]
            place[seen[number, :3]] = poses[number, :3][seen[number, :3]]
            if seen[number, 3]:
                data.qpos[address + 3 : address + 7] = poses[number, 3:]
        fixtures = numbers[layout.fixture_part]
        told_of = self._seen[layout.fixture_part]
        data.qpos[tracked.fixture_qpos[told_of]] = fixtures[told_of]
        if row > 0 and seen.any():
            scratch = self._data
            scratch.qpos[:], scratch.mocap_pos[:] = data.qpos, data.mocap_pos
            scratch.mocap_quat[:] = data.mocap_quat
            places = tracked.object_joints
            separate(self._model, scratch, places, self._robot, seen[:, :3])
            for address in places:
                data.qpos[address : address + 3] = scratch.qpos[address : address + 3]

    def _set_speeds(self, speeds: Array, data: mujoco.MjData) -> None:
        """Give objects and drawers the speeds at which they were seen to move."""
        tracked, layout, model = (
            self._plants.nominal.tracked,
            self._starts.layout,
            self._model,
        )
        seen = self._seen[layout.object_part].reshape(-1, 4)[:, :3]
        rows = speeds[layout.object_part].reshape(-1, 4)[:, :3]
        for number, address in enumerate(tracked.object_joints):
            dof = model.jnt_dofadr[_joint_at(model, address)]
            data.qvel[dof : dof + 3][seen[number]] = rows[number][seen[number]]
        told_of = self._seen[layout.fixture_part]
        for column in np.flatnonzero(told_of):
            dof = model.jnt_dofadr[_joint_at(model, tracked.fixture_qpos[column])]
            data.qvel[dof] = speeds[layout.fixture_part][column]

    def _path(self, told: Array) -> Path:
        """Return where the tool was, world frame."""
        pose = self._of(told, STATE_NAMES[:6])
        if pose is None:
            raise RuntimeError("a track needs the tool's pose")
        place = pose[:, :3] + BASE_POSITION
        place[:, 2] -= self._plants.domain.tool_offset
        return Path(place, pose[:, 3:])

    def _of(self, told: Array, names: Sequence[str]) -> Array | None:
        """Return columns by their names, None where one is not told."""
        if not all(name in self._names for name in names):
            return None
        return told[:, [self._names.index(name) for name in names]]

    def _reach(self, path: Path, row: int, joints: Array) -> Array:
        """Return the joints nearest to `joints` that bring the tool where it was."""
        model, data = self._model, self._data
        tracked, dofs = self._plants.nominal.tracked, self._plants.control.arm_dof
        jacobian = np.zeros((6, model.nv))
        place, turn = path.place[row], path.turn(row)
        quaternion, error = np.zeros(4), np.zeros(6)
        for _ in range(_ROUNDS):
            data.qpos[tracked.arm_qpos] = joints
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], tracked.site)
            here = data.site_xmat[tracked.site].reshape(3, 3)
            mujoco.mju_mat2Quat(quaternion, (turn @ here.T).ravel())
            mujoco.mju_quat2Vel(error[3:], quaternion, 1.0)
            error[:3] = place - data.site_xpos[tracked.site]
            joints = joints + np.linalg.lstsq(jacobian[:, dofs], error, rcond=None)[0]
        return joints

    def _fixture_ranges(self) -> list[Array]:
        model, tracked = self._model, self._plants.nominal.tracked
        return [model.jnt_range[_joint_at(model, a)] for a in tracked.fixture_qpos]


def robot_geoms(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Return which geoms are those of the robot and its mount, (ngeom,)."""
    root = model.body_rootid[model.geom_bodyid]
    names = ("robot0_base", "fixed_mount0_base")
    return np.isin(root, [model.body(name).rootid[0] for name in names])


def _joint_at(model: mujoco.MjModel, address: int) -> int:
    """Return the joint whose position begins at an address."""
    return int(np.flatnonzero(model.jnt_qposadr == address)[0])


def rested(values: Array, noise: Array) -> Array:
    """Smooth columns: means where they rest, short quadratics where they move.

    Args:
        values: (T, columns).
        noise: Standard deviation of a reading, (columns,).

    Example:
        >>> told = np.array([0.0, 0.2, -0.2, 0.1, -0.1, 0.1, 0.0])[:, None]
        >>> rested(told, np.array([0.1])).round(2)[0].tolist()
        [0.0]
    """
    rows = len(values)
    out = values.copy()
    if rows >= 5 and values.size:
        out = savgol_filter(values, 5, 2, axis=0, mode="interp")
    for row in range(rows):
        near = values[max(0, row - _WINDOW) : row + _WINDOW + 1]
        mean = near.mean(axis=0)
        still = (np.abs(near - mean) < 4.0 * noise).all(axis=0)
        out[row] = np.where(still, mean, out[row])
    return out
