"""Estimate the simulator's state at each row of a log.

A log contains less than a state: the tool's pose but perhaps no joints, the objects'
positions but perhaps not their orientations. What is not observed comes from the
distribution of the task's initial states, and from the controller, which pulls an arm
to its initial posture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from rlco.gap.demos.replay.channels import ARM_JOINTS, known_names
from rlco.gap.demos.replay.commands_in_flight import (
    Path,
    grip_after,
    in_flight,
    is_late,
)
from rlco.gap.demos.replay.overlap import separate
from rlco.gap.demos.replay.rollouts import Job, Rollouts, Start
from rlco.gap.demos.replay.start_prior import Starts
from rlco.gap.logs.log import Array
from rlco.physics.spec.control import Control
from rlco.physics.spec.names import STATE_NAMES
from rlco.physics.spec.robot import GRIPPER, PANDA, POSE, POSITION, ROTATION

_WIDE = 0.5  # standard deviation of the motion of objects and drawers [m]
_WINDOW = 4  # rows to either side that are averaged at rest
# A tool that is measured away from where it was simulated also had another velocity, by
# this much per metre: a velocity error decays to a fifth in a control step of 50 ms
# (critically damped, 150 / s^2), and its displacement is 27 ms of it.
_PULL = 8.0
_ROUNDS = 3  # Newton iterations; a control step moves a joint by about 0.05 rad
_FINEST = 1e-5  # smallest noise of a column [m or rad]


@dataclass(frozen=True)
class Track:
    """The state at each row of one recording; T rows.

    Attributes:
        qpos: (T, nq).
        qvel: (T, nv).
        marks: Poses of what is fixed for the episode, (G, 7).
        grip: The gripper's goals before the first action, (2,).
        posture: Joint positions that the controller pulls the arm to, (n,) [rad].
        path: The tool's pose.
    """

    qpos: Array
    qvel: Array
    marks: Array
    grip: Array
    posture: Array
    path: Path

    def start(self, control: Control, actions: Array, row: int) -> Start:
        """Return the state at a row, under a controller that received these actions."""
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
class _Observations:
    """The observations of one recording, in the model's terms; T rows.

    Attributes:
        path: The tool's pose.
        joints: The arm's, (T, n); None where they are not logged.
        opening: Between the fingers, (T,); None where it is not logged.
        parameters: In the order of `Starts`, (T, P).
        poses: Of the objects, (T, K, 7).
    """

    path: Path
    joints: Array | None
    opening: Array | None
    parameters: Array
    poses: Array


class Tracker:
    """Estimate tracks.

    The simulator follows the recording. After each control step its tool is moved to
    the measured pose, and its objects to their measured positions. What is not observed
    (the elbow, an object's orientation) continues as simulated.

    Args:
        rollouts: Simulations of the task.
        names: Names of the observed columns.
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
        # Parameters of the scene that the columns observe.
        columns = [self._columns[i] for i in self._scene]
        _, slope = self._starts.slopes(self._starts.mean, columns)
        self._is_observed = np.abs(slope).max(axis=0, initial=0.0) > 1e-6

    def tracks(
        self,
        observed: Sequence[Array],
        actions: Sequence[Array],
        rng: np.random.Generator | None = None,
    ) -> list[Track]:
        """Estimate the states of recordings.

        Args:
            observed: The columns of each, (T, names).
            actions: The actions of each, (T, A).
            rng: If given, observations get additional noise of their own size, and
                what is not observed comes from a random initial state. Two such tracks
                differ as two estimates of the same track do.
        """
        ready, nominal = (
            [self._ready(rows, rng) for rows in observed],
            self._plants.nominal,
        )
        jobs = [
            Job(nominal, self._starts.start(one.parameters[0]), rows[:-1])
            for one, rows in zip(ready, actions, strict=True)
        ]
        qpos = [np.empty((len(rows), self._model.nq)) for rows in observed]
        qvel = [np.empty((len(rows), self._model.nv)) for rows in observed]
        speeds = [np.gradient(one.parameters, self._period, axis=0) for one in ready]

        def correct(job: int, row: int, data: mujoco.MjData) -> None:
            self._correct(ready[job], row, data)
            self._set_speeds(speeds[job][row], data)
            qpos[job][row], qvel[job][row] = data.qpos, data.qvel

        self._rollouts.follow(jobs, correct)
        return [
            Track(q, v, job.start.marks, job.start.grip, job.start.posture, one.path)
            for q, v, job, one in zip(qpos, qvel, jobs, ready, strict=True)
        ]

    def _ready(self, observed: Array, rng: np.random.Generator | None) -> _Observations:
        observed, mean = observed.copy(), self._starts.mean
        if rng is not None:
            observed += self._noise * rng.standard_normal(observed.shape)
            mean = mean + self._starts.deviation * rng.standard_normal(mean.shape)
        observed[:, self._scene] = rested(
            observed[:, self._scene], self._noise[self._scene]
        )
        first = self._starts.likeliest(observed[0], self._columns, self._noise, mean)
        path, joints = self._path(observed), self._of(observed, ARM_JOINTS)
        parameters = self._moved(observed, first)
        part = self._starts.layout.joint_part
        found = self._reach(path, 0, first[part]) if joints is None else joints
        parameters[:, part] = found
        opening = self._of(observed, STATE_NAMES[GRIPPER:])
        if opening is not None:
            opening = opening[:, 0] - self._plants.domain.sensors.gripper_offset
            opening = np.clip(opening, 0.0, self._plants.task.robot.widest)
            parameters[:, self._starts.layout.joints] = opening
        return _Observations(
            path, joints, opening, parameters, self._starts.poses(parameters)[0]
        )

    def _moved(self, observed: Array, first: Array) -> Array:
        """Return initial parameters, updated by each row's observation, (T, P)."""
        layout = self._starts.layout
        moving = np.r_[layout.object_part, layout.fixture_part]
        parameters = np.tile(first, (len(observed), 1))
        columns = [self._columns[i] for i in self._scene]
        if not columns or not moving.size:
            return parameters
        noise = self._noise[self._scene]
        # Linear in positions and openings, so one step of least squares is enough.
        here, slope = self._starts.slopes(first, columns)
        slope, residual = (
            slope[:, moving] / noise[:, None],
            observed[:, self._scene] - here,
        )
        residual = residual / noise
        normal = slope.T @ slope + np.eye(moving.size) / _WIDE**2
        parameters[:, moving] += np.linalg.solve(normal, slope.T @ residual.T).T
        for column, (low, high) in enumerate(self._fixture_ranges()):
            part = parameters[:, layout.fixture_part][:, column]
            np.clip(part, low, high, out=part)
        return parameters

    def _correct(self, observed: _Observations, row: int, data: mujoco.MjData) -> None:
        """Move a simulation to the observations of a row."""
        tracked, layout = self._plants.nominal.tracked, self._starts.layout
        parameters, dofs = observed.parameters[row], self._plants.control.arm_dof
        if observed.joints is not None:
            data.qpos[tracked.arm_qpos] = observed.joints[row]
        elif row > 0:
            simulated = data.qpos[tracked.arm_qpos].copy()
            # Like robosuite, the simulator reports the tool's pose one step late.
            ahead = float(self._model.opt.timestep) * data.qvel[dofs]
            joints = self._reach(observed.path, row, simulated - ahead) + ahead
            data.qpos[tracked.arm_qpos] = joints
            data.qvel[dofs] += _PULL * (joints - simulated)
        if observed.opening is not None:
            fingers = self._plants.task.robot.fingers(observed.opening[row])
            data.qpos[[tracked.finger, tracked.finger + 1]] = fingers
        poses = observed.poses[row]
        mask = self._is_observed[layout.object_part].reshape(-1, 4)
        for index, address in enumerate(tracked.object_joints):
            position = data.qpos[address : address + 3]
            position[mask[index, :3]] = poses[index, :3][mask[index, :3]]
            if mask[index, 3]:
                data.qpos[address + 3 : address + 7] = poses[index, 3:]
        fixtures = parameters[layout.fixture_part]
        fixture_mask = self._is_observed[layout.fixture_part]
        data.qpos[tracked.fixture_qpos[fixture_mask]] = fixtures[fixture_mask]
        if row > 0 and mask.any():
            scratch = self._data
            scratch.qpos[:], scratch.mocap_pos[:] = data.qpos, data.mocap_pos
            scratch.mocap_quat[:] = data.mocap_quat
            addresses = tracked.object_joints
            separate(self._model, scratch, addresses, self._robot, mask[:, :3])
            for address in addresses:
                data.qpos[address : address + 3] = scratch.qpos[address : address + 3]

    def _set_speeds(self, speeds: Array, data: mujoco.MjData) -> None:
        """Set the measured velocities of objects and drawers."""
        tracked, layout, model = (
            self._plants.nominal.tracked,
            self._starts.layout,
            self._model,
        )
        mask = self._is_observed[layout.object_part].reshape(-1, 4)[:, :3]
        rows = speeds[layout.object_part].reshape(-1, 4)[:, :3]
        for index, address in enumerate(tracked.object_joints):
            dof = model.jnt_dofadr[_joint_at(model, address)]
            data.qvel[dof : dof + 3][mask[index]] = rows[index][mask[index]]
        fixture_mask = self._is_observed[layout.fixture_part]
        for column in np.flatnonzero(fixture_mask):
            dof = model.jnt_dofadr[_joint_at(model, tracked.fixture_qpos[column])]
            data.qvel[dof] = speeds[layout.fixture_part][column]

    def _path(self, observed: Array) -> Path:
        """Return the tool's pose, world frame."""
        pose = self._of(observed, STATE_NAMES[POSE])
        if pose is None:
            raise RuntimeError("a track needs the tool's pose")
        position = pose[:, POSITION] + self._plants.task.robot.base
        position[:, 2] -= self._plants.domain.sensors.tool_offset
        return Path(position, pose[:, ROTATION])

    def _of(self, observed: Array, names: Sequence[str]) -> Array | None:
        """Return columns by their names, None where one is not logged."""
        if not all(name in self._names for name in names):
            return None
        return observed[:, [self._names.index(name) for name in names]]

    def _reach(self, path: Path, row: int, joints: Array) -> Array:
        """Return the joints nearest to `joints` that bring the tool to its pose."""
        model, data = self._model, self._data
        tracked, dofs = self._plants.nominal.tracked, self._plants.control.arm_dof
        jacobian = np.zeros((6, model.nv))
        position, turn = path.position[row], path.turn(row)
        quaternion, error = np.zeros(4), np.zeros(6)
        for _ in range(_ROUNDS):
            data.qpos[tracked.arm_qpos] = joints
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], tracked.site)
            here = data.site_xmat[tracked.site].reshape(3, 3)
            mujoco.mju_mat2Quat(quaternion, (turn @ here.T).ravel())
            mujoco.mju_quat2Vel(error[3:], quaternion, 1.0)
            error[:3] = position - data.site_xpos[tracked.site]
            joints = joints + np.linalg.lstsq(jacobian[:, dofs], error, rcond=None)[0]
        return joints

    def _fixture_ranges(self) -> list[Array]:
        model, tracked = self._model, self._plants.nominal.tracked
        return [model.jnt_range[_joint_at(model, a)] for a in tracked.fixture_qpos]


def robot_geoms(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Return a mask of the geoms of the robot and its mount, (ngeom,)."""
    root = model.body_rootid[model.geom_bodyid]
    return np.isin(root, [model.body(name).rootid[0] for name in PANDA.bases])


def _joint_at(model: mujoco.MjModel, address: int) -> int:
    """Return the joint whose position is at an address."""
    return int(np.flatnonzero(model.jnt_qposadr == address)[0])


def rested(values: Array, noise: Array) -> Array:
    """Smooth columns: means at rest, short quadratic fits in motion.

    Args:
        values: (T, columns).
        noise: Standard deviation of one sample, (columns,).

    Example:
        >>> samples = np.array([0.0, 0.2, -0.2, 0.1, -0.1, 0.1, 0.0])[:, None]
        >>> rested(samples, np.array([0.1])).round(2)[0].tolist()
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
