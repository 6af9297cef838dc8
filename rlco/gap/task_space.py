"""Logs of a task's own actions: measured against simulated tool and objects.

The actions are replayed in the task's own simulator, controller and contacts included.
They are steps from where the tool is, so that a replay drifts away from the recording
by itself. It is therefore anchored to what was measured again and again (`shot`).
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import batched, pairwise

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import DataError
from rlco.gap.log import Array, Log, Recording
from rlco.gap.noise import measurement_noise
from rlco.gap.problem import Candidate, Hypothesis, Layout, Problem
from rlco.gap.task_channels import (
    Channels,
    channels_of,
    has_column,
    known_names,
    measured,
    report,
)
from rlco.gap.task_plants import SPREAD, Plant, Plants
from rlco.gap.task_rollouts import ROWS, Job, Rollouts
from rlco.gap.task_tracks import Track, Tracker, robot_geoms
from rlco.physics.domain import Domain, make_domain
from rlco.physics.effects import EFFECTS, AppliedEffect, Effect
from rlco.physics.observation import ACTION_NAMES
from rlco.physics.task import Task, make_task

# What acts on the goal of a single joint, of which these actions have none.
_NO_GOAL = ("velocity_limit", "backlash", "joint_compliance")
_FIXTURE_EFFECTS = ("coulomb_friction", "viscous_damping", "joint_stiffness")
_TOUCH = 0.002  # what is nearer than this counts as touching [m]
_MOVING = 0.02  # and what is faster than this as moving [m/s]
_RUN_IN = 2  # rows after which an arm has forgotten how fast it was
_LAGGING = 4  # and more, after which actuators that lag have caught up
_FINEST = 1e-5  # no channel is compared more closely [m or rad]


@dataclass(frozen=True)
class Segment:
    """Rows `first` to `last` of a recording, simulated from `first`.

    The arm's speed there comes from simulating some rows before it, from `begin` on.
    """

    recording: int
    begin: int
    first: int
    last: int


class TaskSpaceProblem(Problem):
    """A `Problem` of a task's own actions and what its sensors and camera told.

    Args:
        task: The task or its name.
        log: Recordings with `command` (T, 7), the task's actions, and `extra` columns
            named as our data sets name them (``tool.x``, ``red_cube.x``).
        domain: The simulator that is compared with the log.
        shot: Seconds of a simulation from a measured state; None for whole episodes.
        threads: Python threads; one a core by default.
        rollouts: Simulations of this task and domain, where they are there already.
        draws: How often starts are drawn to see what an inexact start does; with 0
            the noise is that of the sensors alone.

    Raises:
        DataError: If the log has no such actions or no tool pose, or another rate.

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
        domain: str | Domain = "sim",
        shot: float | None = 1.0,
        threads: int | None = None,
        rollouts: Rollouts | None = None,
        draws: int = 2,
    ) -> None:
        self.task = task_at_rate(make_task(task), log)
        self.domain, self.log = make_domain(domain), log
        self.channels: Channels = channels_of(self.task, log)
        self._rollouts = rollouts or Rollouts(Plants(self.task, self.domain), threads)
        self.plants = self._rollouts.plants
        self.model: mujoco.MjModel = self.plants.nominal.model
        self.spread_names: tuple[str, ...] = SPREAD
        self._period = 1.0 / self.task.control_frequency
        self._actions = [np.asarray(r.command, dtype=float) for r in log.recordings]
        told = [name for name in known_names(self.task) if has_column(log, name)]
        values = [measured(log, i, told) for i in range(len(log.recordings))]
        compared = [told.index(name) for name in self.channels.names]
        self._measured = [rows[:, compared] for rows in values]
        timed = [(r.time, v) for r, v in zip(log.recordings, values, strict=True)]
        noise = measurement_noise(timed).deviation
        self._columns = values
        self._tracker = Tracker(self._rollouts, told, noise)
        self.tracks = self._tracker.tracks(values, self._actions)
        steps = None if shot is None else max(2, round(shot / self._period))
        self.segments = [
            segment
            for index, recording in enumerate(log.recordings)
            for segment in _segments(index, recording, self._period, steps)
        ]
        self.layout = self._layout()
        self.noise: Array = self._noise(noise[compared], draws)

    def candidates(self) -> list[Candidate]:
        """Return each effect at each target that the tool or an object would show."""
        arm = tuple(f"robot0_joint{i}" for i in range(1, 8))
        found = []
        for effect in EFFECTS.values():
            targets = effect.targets(self.model)
            if effect.on_measurement is not None:
                # The controller reads the encoders of joints that motors drive, too.
                targets = arm
            found += [
                Candidate(effect.name, target)
                for target in targets
                if self._shows(effect, target)
            ]
        return found

    def residuals(
        self, hypotheses: Sequence[Hypothesis], recordings: Sequence[int] | None = None
    ) -> Array:
        """Return measured minus simulated, (hypotheses, N), as `Problem.residuals`."""
        return self._residuals(hypotheses, recordings, self.tracks)

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        """Return signals of one recording, as `Problem.traces`."""
        told = self._measured[recording]
        left = self.residuals([hypothesis], [recording])[0]
        simulated = told.copy()
        rows = [s for s in self.segments if s.recording == recording]
        index = np.concatenate([np.arange(s.first + 1, s.last + 1) for s in rows])
        simulated[index] -= left.reshape(len(index), -1)
        speed = np.gradient(told, self._period, axis=0)
        return {
            "time": self.log.recordings[recording].time,
            "measured": told,
            "simulated": simulated,
            "velocity": speed,
            "acceleration": np.gradient(speed, self._period, axis=0),
            "contact": self.touching(recording),
        }

    def touching(self, recording: int) -> NDArray[np.bool_]:
        """Return in which rows the robot touches something, or an object moves, (T,).

        By the measured state; what is within 2 mm touches.
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
        """Return whether an effect can be seen here, and be simulated."""
        if effect.name in _NO_GOAL:
            return False
        if target is None:
            return True
        if target in self.task.fixture_joints:
            return effect.name in _FIXTURE_EFFECTS
        if target in self.plants.objects:
            name = self.task.objects[list(self.plants.objects).index(target)]
            return any(column.startswith(f"{name}.") for column in self.channels.names)
        if effect.name == "payload":
            return target == "gripper0_right_right_gripper"
        return target.startswith("robot0_")

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
        """Return the noise of each channel, that of inexact starts included.

        A measured state is not the true one: two simulations from two estimates of it
        part, most of all where a contact is made or missed.
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
        told = self._told(segments)
        out = np.zeros((len(hypotheses), told.size))
        # A compiled model takes megabytes: only so many are there at a time.
        at_once = max(2, ROWS // len(segments))
        for part in batched(weighted, at_once):
            jobs = []
            for _, _, hypothesis in part:
                plant = self.plants.plant(hypothesis)
                jobs += [self._job(plant, s, tracks[s.recording]) for s in segments]
            rollouts = batched(self._rollouts.run(jobs), len(segments))
            for (row, weight, _), features in zip(part, rollouts, strict=True):
                out[row] += weight * self._left(told, segments, features)
        return out

    def _job(self, plant: Plant, segment: Segment, track: Track) -> Job:
        actions, first = self._actions[segment.recording], segment.first
        start = track.start(plant.control, actions, first)
        rows = _RUN_IN + _LAGGING * plant.control.acting.lags
        earlier = max(segment.begin, first - rows)
        way = track.start(plant.control, actions, earlier)
        before = way, actions[earlier:first]
        return Job(plant, start, actions[first : segment.last], before)

    def _whole_steps(self, hypothesis: Hypothesis) -> list[tuple[float, Hypothesis]]:
        """Return a hypothesis as a mean of those with delays of whole physics steps.

        A fit would see no slope in a delay that is rounded.
        """
        step = float(self.model.opt.timestep)
        for index, effect in enumerate(hypothesis.effects):
            if effect.name != "command_delay":
                continue
            steps = float(effect.values[0]) / step
            below = np.floor(steps)
            out = []
            for weight, whole in (
                (1.0 - steps + below, below),
                (steps - below, below + 1),
            ):
                late = AppliedEffect(effect.name, None, {"delay": whole * step})
                effects = list(hypothesis.effects)
                effects[index] = late
                out.append((weight, replace(hypothesis, effects=tuple(effects))))
            return [pair for pair in out if pair[0] > 1e-9]
        return [(1.0, hypothesis)]

    def _told(self, segments: Sequence[Segment]) -> Array:
        return np.concatenate(
            [self._measured[s.recording][s.first + 1 : s.last + 1] for s in segments]
        )

    def _left(
        self, told: Array, segments: Sequence[Segment], found: Sequence[Array | None]
    ) -> Array:
        """Return measured minus simulated of the segments of one plant, (N,)."""
        left = np.full(told.shape, np.inf)
        rows = np.repeat(
            [features is not None for features in found],
            [s.last - s.first for s in segments],
        )
        sound = [features for features in found if features is not None]
        if sound:
            state = self._rollouts.scene(np.concatenate(sound))
            columns = list(self.channels.columns)
            simulated = report(self.task, self.domain, state)[:, columns]
            left[rows] = self.channels.difference(told[rows], simulated)
        return left.ravel()


def task_at_rate(task: Task, log: Log) -> Task:
    """Return a task, controlled at the rate of a log.

    Raises:
        DataError: If the log holds no recordings, no actions of seven numbers, too few
            rows, or a rate at which a control step is no whole number of 2 ms.
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
            f"the log has {rate:.4g} rows a second, at which a control step is no "
            "whole number of physics steps of 2 ms; resample it to the rate of the "
            f"task, {task.control_frequency} Hz, or to 10, 25 or 50 Hz."
        )
    return replace(task, control_frequency=round(rate))


def _check_recording(recording: Recording, task: Task) -> None:
    command, size = recording.command, len(ACTION_NAMES)
    if command is None or command.shape != (recording.rows, size):
        shape = None if command is None else command.shape
        raise DataError(
            f"{recording.name} has actions of shape {shape}, but {task.name!r} takes "
            f"{size} numbers a row ({', '.join(ACTION_NAMES)}); give a log of the "
            "task's own actions."
        )
    if recording.rows < 5:
        raise DataError(
            f"{recording.name} has {recording.rows} rows; five are needed at least."
        )


def _segments(
    index: int, recording: Recording, period: float, length: int | None
) -> list[Segment]:
    """Cut a recording into stretches of about equal length, without gaps in time."""
    gaps = np.flatnonzero(np.diff(recording.time) > 1.5 * period) + 1
    found = []
    for begin, end in zip([0, *gaps], [*gaps, recording.rows], strict=True):
        first = int(begin) + _RUN_IN
        rows = int(end) - 1 - first
        if rows < 2:
            continue
        count = 1 if length is None else max(1, round(rows / length))
        edges = np.linspace(first, end - 1, count + 1).round().astype(int).tolist()
        found += [Segment(index, int(begin), a, b) for a, b in pairwise(edges)]
    return found
