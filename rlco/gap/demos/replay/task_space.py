"""Logs of a task's own actions: measured against simulated tool and objects.

The actions are replayed in the task's own simulator, with its controller and contacts.
They are relative to the tool's pose, so a replay drifts away from the recording. It
therefore restarts from the measurement at intervals (`segment`), where nothing touches:
a tenth of a millimetre too far into a contact is a blow.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import batched

import mujoco
import numpy as np

from rlco.errors import DataError, counted
from rlco.gap.compare.noise import measurement_noise
from rlco.gap.compare.problem import Candidate, Hypothesis, Layout, Problem
from rlco.gap.demos.replay.channels import (
    Channels,
    channels_of,
    has_column,
    known_names,
    measured,
    report,
)
from rlco.gap.demos.replay.plants import TOLERANCES, Plant, Plants
from rlco.gap.demos.replay.rollouts import ROWS, Job, Rollouts
from rlco.gap.demos.replay.segments import RUN_IN, Mask, Segment, segments_of
from rlco.gap.demos.replay.tracks import Track, Tracker, robot_geoms
from rlco.gap.logs.log import Array, Log, Recording
from rlco.physics.effects import AppliedEffect, Effect, searched
from rlco.physics.effects.command import COMMAND_DELAY, RANDOM_DELAY
from rlco.physics.effects.friction import VISCOUS_DAMPING
from rlco.physics.effects.targets import holding_torque
from rlco.physics.spec.domain import GivenDomain, make_domain
from rlco.physics.spec.names import ACTION_NAMES
from rlco.physics.spec.task import Task
from rlco.physics.tasks.make_task import make_task

_TOUCH = 0.002  # distance that counts as contact [m]
_MOVING = 0.02  # speed that counts as motion [m/s]
_LAGGING = 4  # further rows after which lagging actuators have settled
_DAMPING = (0.03, 0.2)  # of the torque that holds a joint's links, at 1 rad/s
_FINEST = 1e-5  # smallest noise of a channel [m or rad]


class TaskSpaceProblem(Problem):
    """A `Problem` for a task's own actions and the reports of its sensors and camera.

    Args:
        task: The task or its name.
        log: Recordings with `command` (T, A), the task's actions, and `extra` columns
            named as in rlco's data sets (``tool.x``, ``red_cube.x``).
        domain: The simulator that is compared with the log.
        segment: Seconds of a simulation from a measured state; None for whole episodes.
        whole_contacts: Whether a simulation goes on where something touches or an
            object moves at its end, up to three times as long.
        threads: Python threads; one per core by default.
        rollouts: Existing simulations of this task and domain, to reuse.
        draws: Number of draws of initial states that estimate the effect of their
            uncertainty; with 0 the noise is that of the sensors alone.

    Raises:
        DataError: If the log has no such actions, no tool pose, or an unsupported rate.

    Example:
        >>> TaskSpaceProblem("push_cube", Log(()))
        Traceback (most recent call last):
        ...
        rlco.errors.DataError: the log holds no recordings; give one episode at least.
    """

    has_outliers = True

    def __init__(
        self,
        task: str | Task,
        log: Log,
        *,
        domain: GivenDomain = "sim",
        segment: float | None = 1.0,
        whole_contacts: bool = True,
        threads: int | None = None,
        rollouts: Rollouts | None = None,
        draws: int = 2,
    ) -> None:
        self.task = task_at_rate(make_task(task), log)
        self.domain, self.log = make_domain(domain), log
        self.channels: Channels = channels_of(self.task, log)
        self.rollouts = rollouts or Rollouts(Plants(self.task, self.domain), threads)
        self.plants = self.rollouts.plants
        self.model: mujoco.MjModel = self.plants.nominal.model
        self.tolerance_names: tuple[str, ...] = TOLERANCES
        self._period = 1.0 / self.task.control_frequency
        self._actions = [np.asarray(r.command, dtype=float) for r in log.recordings]
        observed = [name for name in known_names(self.task) if has_column(log, name)]
        values = [measured(log, i, observed) for i in range(len(log.recordings))]
        compared = [observed.index(name) for name in self.channels.names]
        self._measured = [rows[:, compared] for rows in values]
        timed = [(r.time, v) for r, v in zip(log.recordings, values, strict=True)]
        noise = measurement_noise(timed).deviation
        self._columns = values
        self._tracker = Tracker(self.rollouts, observed, noise)
        self.tracks = self._tracker.tracks(values, self._actions)
        steps = None if segment is None else max(2, round(segment / self._period))
        self.segments = [
            segment
            for index, one in enumerate(log.recordings)
            for segment in segments_of(
                index,
                one,
                self._period,
                steps,
                self.touching(index) if whole_contacts else np.zeros(one.rows, bool),
            )
        ]
        self.layout = self._layout()
        self.noise: Array = self._noise(noise[compared], draws)

    def candidates(self) -> list[Candidate]:
        """Return each effect at each target that the tool or an object can reveal."""
        arm = self.task.robot.model_joints
        found = []
        for effect in searched("task"):
            targets = effect.targets(self.model)
            if effect.on_measurement is not None:
                # The controller also reads the encoders of joints driven by motors.
                targets = arm
            found += [
                Candidate(effect.name, target)
                for target in targets
                if self._shows(effect, target)
            ]
        return found

    def usual_sizes(self) -> Mapping[Candidate, tuple[float, ...]]:
        """Return damping that a task's controller feels, for each joint of the arm.

        Models give an arm a damping that its controller makes nothing of; from there no
        gradient leads to one that moves the tool.
        """
        found = {}
        for joint in self.task.robot.model_joints:
            torque = holding_torque(self.model, joint)
            starts = tuple(part * torque for part in _DAMPING)
            found[Candidate(VISCOUS_DAMPING.name, joint)] = starts
        return found

    def residuals(
        self, hypotheses: Sequence[Hypothesis], recordings: Sequence[int] | None = None
    ) -> Array:
        """Return measured minus simulated, (hypotheses, N), as `Problem.residuals`."""
        return self._residuals(hypotheses, recordings, self.tracks)

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        """Return the signals of one recording, as `Problem.traces`."""
        observed = self._measured[recording]
        residual = self.residuals([hypothesis], [recording])[0]
        simulated = observed.copy()
        rows = [s for s in self.segments if s.recording == recording]
        index = np.concatenate([np.arange(s.first + 1, s.last + 1) for s in rows])
        simulated[index] -= residual.reshape(len(index), -1)
        speed = np.gradient(observed, self._period, axis=0)
        return {
            "time": self.log.recordings[recording].time,
            "measured": observed,
            "simulated": simulated,
            "velocity": speed,
            "acceleration": np.gradient(speed, self._period, axis=0),
            "contact": self.touching(recording),
        }

    def touching(self, recording: int) -> Mask:
        """Return the rows with contact of the robot or motion of an object, (T,).

        Judged by the measured state; what is within 2 mm touches.
        """
        model, track = copy.copy(self.model), self.tracks[recording]
        model.geom_margin[:] = _TOUCH
        data = mujoco.MjData(model)
        robot = robot_geoms(model)
        marks = self.plants.nominal.tracked.mocap
        touching = np.zeros(len(track.qpos), dtype=bool)
        for row, qpos in enumerate(track.qpos):
            data.qpos[:] = qpos
            data.mocap_pos[marks] = track.marks[:, :3]
            data.mocap_quat[marks] = track.marks[:, 3:]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
            ours = robot[data.contact.geom]
            touching[row] = bool((ours.sum(axis=1) == 1).any())
        scene = np.ones(model.nv, dtype=bool)
        scene[self.plants.control.arm_dof] = False
        moving = np.abs(track.qvel[:, scene]).max(axis=1, initial=0.0) > _MOVING
        return np.asarray(touching | moving)

    def _shows(self, effect: Effect, target: str | None) -> bool:
        """Return whether an effect can be observed and simulated here."""
        if "goal" in effect.acts_on:
            return False  # these actions move the tool, not single joints
        if target is None:
            return True
        if target in self.task.fixture_joints:
            return effect.at_fixtures
        if target in self.plants.objects:
            name = self.task.objects[list(self.plants.objects).index(target)]
            return any(column.startswith(f"{name}.") for column in self.channels.names)
        if effect.held:
            return target == self.task.robot.hand
        return target.startswith(self.task.robot.prefixes[0])

    def _layout(self) -> Layout:
        count = len(self.channels.names)
        recording, time = [], []
        for segment in self.segments:
            rows = np.arange(segment.first + 1, segment.last + 1)
            times = self.log.recordings[segment.recording].time[rows]
            recording.append(np.full(len(rows) * count, segment.recording))
            time.append(np.repeat(times, count))
        total = sum(len(part) for part in time)
        return Layout(
            np.concatenate(recording),
            np.concatenate(time),
            np.tile(np.arange(count), total // count),
            self.channels.names,
            self.channels.units,
        )

    def _noise(self, sensors: Array, draws: int) -> Array:
        """Return the noise of each channel, including that of inexact initial states.

        A measured state is not the true one. Simulations from two estimates of it
        diverge, most of all where a contact is made or missed.
        """
        total = np.maximum(sensors, _FINEST) ** 2
        if not draws:
            return np.asarray(np.sqrt(total))
        nominal = self._residuals([Hypothesis()], None, self.tracks)[0]
        rng = np.random.default_rng(0)
        for _ in range(draws):
            tracks = self._tracker.tracks(self._columns, self._actions, rng)
            apart = self._residuals([Hypothesis()], None, tracks)[0] - nominal
            apart[~np.isfinite(apart)] = 0.0
            for channel in range(len(total)):
                part = apart[self.layout.channel == channel]
                total[channel] += float(np.mean(part**2)) / draws
        return np.asarray(np.sqrt(total))

    def _residuals(
        self,
        hypotheses: Sequence[Hypothesis],
        recordings: Sequence[int] | None,
        tracks: Sequence[Track],
    ) -> Array:
        segments = [
            s for s in self.segments if recordings is None or s.recording in recordings
        ]
        weighted = [
            (row, *pair)
            for row, hypothesis in enumerate(hypotheses)
            for pair in self._whole_steps(hypothesis)
        ]
        observed = self._measured_in(segments)
        out = np.zeros((len(hypotheses), observed.size))
        # A compiled model takes megabytes: limit how many exist at once.
        at_once = max(2, ROWS // len(segments))
        for part in batched(weighted, at_once):
            jobs = []
            for _, _, hypothesis in part:
                plant = self.plants.plant(hypothesis)
                jobs += [self._job(plant, s, tracks[s.recording]) for s in segments]
            rollouts = batched(self.rollouts.run(jobs), len(segments))
            for (row, weight, _), features in zip(part, rollouts, strict=True):
                out[row] += weight * self._residual(observed, segments, features)
        return out

    def _job(self, plant: Plant, segment: Segment, track: Track) -> Job:
        actions, first = self._actions[segment.recording], segment.first
        start = track.start(plant.control, actions, first)
        rows = RUN_IN + _LAGGING * plant.control.acting.lags
        earlier = max(segment.begin, first - rows)
        way = track.start(plant.control, actions, earlier)
        before = way, actions[earlier:first]
        return Job(plant, start, actions[first : segment.last], before)

    def _whole_steps(self, hypothesis: Hypothesis) -> list[tuple[float, Hypothesis]]:
        """Split a hypothesis into a weighted mean of ones with whole-step delays.

        A rounded delay would have no gradient for the fit.
        """
        step = float(self.model.opt.timestep)
        for index, effect in enumerate(hypothesis.effects):
            if effect.name not in (COMMAND_DELAY.name, RANDOM_DELAY.name):
                continue
            steps = float(effect.values[0]) / step
            below = np.floor(steps)
            out = []
            for weight, whole in (
                (1.0 - steps + below, below),
                (steps - below, below + 1),
            ):
                late = AppliedEffect(COMMAND_DELAY.name, None, {"delay": whole * step})
                effects = list(hypothesis.effects)
                effects[index] = late
                out.append((weight, replace(hypothesis, effects=tuple(effects))))
            return [pair for pair in out if pair[0] > 1e-9]
        return [(1.0, hypothesis)]

    def _measured_in(self, segments: Sequence[Segment]) -> Array:
        return np.concatenate(
            [self._measured[s.recording][s.first + 1 : s.last + 1] for s in segments]
        )

    def _residual(
        self,
        observed: Array,
        segments: Sequence[Segment],
        found: Sequence[Array | None],
    ) -> Array:
        """Return measured minus simulated over the segments of one plant, (N,)."""
        residual = np.full(observed.shape, np.inf)
        rows = np.repeat(
            [features is not None for features in found],
            [s.last - s.first for s in segments],
        )
        sound = [features for features in found if features is not None]
        if sound:
            state = self.rollouts.scene(np.concatenate(sound))
            columns = list(self.channels.columns)
            simulated = report(self.task, self.domain, state)[:, columns]
            residual[rows] = self.channels.difference(observed[rows], simulated)
        return residual.ravel()


def task_at_rate(task: Task, log: Log) -> Task:
    """Return a task, controlled at the rate of a log.

    Raises:
        DataError: If the log holds no recordings, no actions of seven dimensions, too
            few rows, or a rate whose control step is not a multiple of 2 ms.
    """
    if not log.recordings:
        raise DataError("the log holds no recordings; give one episode at least.")
    for recording in log.recordings:
        _check_recording(recording, task)
    periods = np.concatenate([np.diff(r.time) for r in log.recordings])
    rate = 1.0 / float(np.median(periods))
    steps = 1.0 / (round(rate) * 0.002) if rate > 0.5 else 0.0
    if abs(rate / max(round(rate), 1) - 1.0) > 0.02 or abs(steps - round(steps)) > 0.01:
        raise DataError(
            f"the log has {rate:.4g} rows per second, at which a control step is not a "
            "multiple of the physics step of 2 ms; resample it to the rate of the "
            f"task, {task.control_frequency} Hz, or to 10, 25 or 50 Hz."
        )
    return replace(task, control_frequency=round(rate))


def _check_recording(recording: Recording, task: Task) -> None:
    command, size = recording.command, len(ACTION_NAMES)
    if command is None or command.shape != (recording.rows, size):
        shape = None if command is None else command.shape
        raise DataError(
            f"{recording.name} has actions of shape {shape}, but {task.name!r} takes "
            f"{size} values per row ({', '.join(ACTION_NAMES)}); give a log of the "
            "task's own actions."
        )
    if recording.rows < 5:
        raise DataError(
            f"{recording.name} has {counted(recording.rows, 'row')}; give five or more."
        )
