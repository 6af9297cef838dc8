"""Position-commanded arms: measured against simulated joint positions.

Each recording is rolled out open loop from its first row, with the recorded commands.
A servo forgets where it started, so that the longest rollouts tell most; where a robot
does not, the rollout is anchored to the measurement again and again (`shots`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
from scipy.signal import savgol_filter

from rlco.gap.log import Array, Log, Recording
from rlco.gap.problem import Candidate, Hypothesis, Integers, Layout
from rlco.gap.rollout_kernel import roll_out, roll_out_terms
from rlco.gap.spread import apply_spread, spread_names
from rlco.physics.effects import EFFECTS, StepTerms
from rlco.physics.effects.apply import (
    apply_to_commands,
    apply_to_measurement,
    apply_to_spec,
    step_terms,
    true_from_told,
)
from rlco.physics.effects.joint_compliance import SUFFIX
from rlco.physics.effects.targets import actuator_of, dof_of
from rlco.physics.libmujoco import unsaid_warnings

SETTLE = 0.3  # seconds in which an arm forgets a wrong initial speed
# A limit is felt where it is below what is needed, and a joint that has far too little
# falls, whatever else it does: limits to start from, as close as a fit reaches.
_CLOSE = 1.4
_MOST_STARTS = 8


@dataclass(frozen=True)
class Shot:
    """A part of a recording that is rolled out from a measured state.

    Attributes:
        recording: Index of the recording.
        first: Its first row, where it is rolled out from.
        begin: The first row that is compared.
        last: Its last row.
        steps: Physics steps from the recording's first row to this one's first.
        commands: Physics steps of this shot.
        frames: Step of the shot before each compared row, (rows,).
        weights: Where the row lies between that step and the next, (rows,).
        state: Positions and velocities at the first row, (2, joints).
    """

    recording: int
    first: int
    begin: int
    last: int
    steps: int
    commands: int
    frames: Integers
    weights: Array
    state: Array


class ArmRollouts:
    """A `Problem` of an arm whose joints were commanded and logged.

    Args:
        spec: The model, slim enough to be compiled for each hypothesis.
        log: Commands and positions.
        noise: Standard deviation of each joint's measurement [rad or m], (joints,).
        horizon: Seconds of a rollout; None for whole recordings.
        threads: Rollouts at a time.
    """

    def __init__(
        self,
        spec: mujoco.MjSpec,
        log: Log,
        noise: Array,
        *,
        horizon: float | None = None,
        threads: int = 2,
    ) -> None:
        self.spec, self.log, self.noise = spec, log, np.asarray(noise, dtype=float)
        self.model: mujoco.MjModel = spec.copy().compile()
        self.threads = threads
        self.spread_names = spread_names(self.model)
        self.has_outliers = False
        self._pool = ThreadPoolExecutor(threads)
        self._columns = [self.model.actuator(name).id for name in log.actuators]
        self._positions = [
            np.asarray(recording.position, dtype=float) for recording in log.recordings
        ]
        step = float(self.model.opt.timestep)
        self._commands = [
            _held(recording, step, self.model.nu, self._columns)
            for recording in log.recordings
        ]
        self.shots = [
            shot
            for index, recording in enumerate(log.recordings)
            for shot in _shots(index, recording, step, horizon)
        ]
        self.layout = self._layout()

    def candidates(self) -> list[Candidate]:
        """Return each effect at each target that moves these joints."""
        found = []
        driven = set(self.log.joints)
        for effect in EFFECTS.values():
            for target in effect.targets(self.model):
                joint = target if target in _joint_names(self.model) else None
                if joint is None or joint in driven:
                    found.append(Candidate(effect.name, target))
        return found

    def usual_sizes(self) -> Mapping[Candidate, tuple[float, ...]]:
        """Return limits of torque a little below what each joint would need.

        How much that is depends on the motion: a joint that turns about the vertical
        holds nothing, and one that the log moves slowly never needs what it could give.
        """
        return {
            Candidate("torque_limit", name): _limits(np.abs(torque))
            for name, torque in zip(self.log.joints, self._needed().T, strict=True)
            if np.isfinite(torque).all() and torque.any()
        }

    def residuals(
        self, hypotheses: Sequence[Hypothesis], recordings: Sequence[int] | None = None
    ) -> Array:
        """Return measured minus simulated positions, (hypotheses, N)."""
        shots = [
            shot
            for shot in self.shots
            if recordings is None or shot.recording in recordings
        ]
        jobs = [
            (hypothesis, part)
            for hypothesis in hypotheses
            for part in _parts(shots, len(hypotheses), self.threads)
        ]
        with unsaid_warnings():
            rows = list(self._pool.map(lambda job: self.simulate(*job), jobs))
        parts = len(jobs) // max(len(hypotheses), 1)
        return np.stack(
            [
                np.concatenate(rows[i * parts : (i + 1) * parts])
                for i in range(len(hypotheses))
            ]
        )

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        """Return signals of one recording, see `Problem.traces`."""
        log = self.log.recordings[recording]
        position, velocity = log.position, _velocity(log)
        simulated = np.array(position, dtype=float)
        left = self.residuals([hypothesis], [recording])[0]
        rows = np.concatenate(
            [
                np.arange(shot.begin, shot.last + 1)
                for shot in self.shots
                if shot.recording == recording
            ]
        )
        simulated[rows] -= left.reshape(len(rows), -1)
        return {
            "time": log.time,
            "measured": np.array(position, dtype=float),
            "simulated": simulated,
            "velocity": velocity,
            "acceleration": np.gradient(velocity, log.time, axis=0),
            "command": self._joint_commands(log),
            "torque": self._static_torque(np.array(position, dtype=float)),
        }

    def _joint_commands(self, log: Recording) -> Array:
        commands = np.array(log.position, dtype=float)
        sent = np.array(log.command, dtype=float)
        for column, name in enumerate(self.log.joints):
            actuator = actuator_of(self.model, name)
            if actuator in self._columns:
                commands[:, column] = sent[:, self._columns.index(actuator)]
        return commands

    def _needed(self) -> Array:
        """The torque of each joint's actuator without any effect, (rows, joints)."""
        left = self.residuals([Hypothesis()])[0]
        at, needed = 0, left.reshape(-1, len(self.log.joints)).copy()
        for shot in self.shots:
            log, part = (
                self.log.recordings[shot.recording],
                slice(shot.begin, shot.last + 1),
            )
            rows = needed[at : at + shot.last + 1 - shot.begin]
            at += len(rows)
            position = np.asarray(log.position)[part] - rows
            velocity = _velocity(log)[part]
            command = self._joint_commands(log)[part]
            for column, name in enumerate(self.log.joints):
                actuator = actuator_of(self.model, name)
                gain, gear = (
                    self.model.actuator_gainprm[actuator, 0],
                    self.model.actuator_gear[actuator, 0],
                )
                bias = self.model.actuator_biasprm[actuator]
                force = gain * command[:, column] + bias[0]
                force += gear * bias[1] * position[:, column]
                force += gear * bias[2] * velocity[:, column]
                rows[:, column] = force if actuator >= 0 else 0.0
        return np.asarray(needed)

    def _static_torque(self, position: Array) -> Array:
        """Torque against gravity in each row, (T, joints)."""
        data = mujoco.MjData(self.model)
        torque = np.empty_like(position)
        for row, joints in enumerate(position):
            for column, name in enumerate(self.log.joints):
                data.qpos[self.model.joint(name).qposadr[0]] = joints[column]
            mujoco.mj_forward(self.model, data)
            for column, name in enumerate(self.log.joints):
                torque[row, column] = data.qfrc_bias[dof_of(self.model, name)]
        return torque

    def _layout(self) -> Layout:
        joints = len(self.log.joints)
        recording, time = [], []
        for shot in self.shots:
            rows = np.arange(shot.begin, shot.last + 1)
            times = self.log.recordings[shot.recording].time[rows]
            recording.append(np.full(len(rows) * joints, shot.recording))
            time.append(np.repeat(times, joints))
        total = sum(len(part) for part in time)
        slides = mujoco.mjtJoint.mjJNT_SLIDE
        units = tuple(
            "m" if self.model.joint(name).type[0] == slides else "rad"
            for name in self.log.joints
        )
        channel = np.tile(np.arange(joints), total // joints)
        return Layout(
            np.concatenate(recording),
            np.concatenate(time),
            channel,
            tuple(self.log.joints),
            units,
        )

    def simulate(self, hypothesis: Hypothesis, shots: Sequence[Shot]) -> Array:
        """Return measured minus simulated positions of some shots, in order, (N,)."""
        spec = self.spec.copy()
        if hypothesis.spread:
            apply_spread(spec, self.spread_names, hypothesis.spread)
        effects, joints = hypothesis.effects, self.log.joints
        apply_to_spec(spec, effects)
        model = spec.compile()
        terms = step_terms(model, effects)
        data = mujoco.MjData(model)
        read, write = _addresses(model, joints)
        filtered: dict[int, Array] = {}
        out = []
        for shot in shots:
            index = shot.recording
            if index not in filtered:
                sent = self._commands[index]
                filtered[index] = apply_to_commands(sent, model, effects)
            commands = filtered[index][shot.steps : shot.steps + shot.commands]
            start = true_from_told(shot.state[0], joints, effects)
            mujoco.mj_resetData(model, data)
            data.qpos[write[0]] = start
            data.qvel[write[1]] = shot.state[1]
            track = np.zeros((shot.commands + 1, len(joints)))
            _run(model, data, commands, read, track, terms)
            rows = track[shot.frames]
            rows += shot.weights[:, None] * (track[shot.frames + 1] - rows)
            rows = apply_to_measurement(rows, joints, effects)
            left = self._positions[index][shot.begin : shot.last + 1] - rows
            if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number or not (
                np.isfinite(left).all()
            ):
                left = np.full_like(left, np.inf)
            out.append(left.ravel())
        return np.concatenate(out)


def _run(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    commands: Array,
    read: Integers,
    track: Array,
    terms: StepTerms,
) -> None:
    views = (data.qpos, data.ctrl)
    addresses = (model._address, data._address)
    commands = np.ascontiguousarray(commands)
    if not terms.act:
        roll_out(*addresses, views, commands, read, track)
        return
    own = model.dof_frictionloss.copy()
    forces = (
        model.dof_frictionloss,
        data.qvel,
        data.qfrc_bias,
        data.qfrc_actuator,
        data.qfrc_applied,
    )
    numbers = (terms.static, terms.stribeck_speed, terms.load, terms.drive, own)
    mujoco.mj_forward(model, data)
    roll_out_terms(
        *addresses, views, commands, read, track, forces, numbers, _drives(model)
    )
    model.dof_frictionloss[:] = own


def _drives(model: mujoco.MjModel) -> tuple[Integers, Integers, Array, Array]:
    """What `roll_out_terms` needs to know of each actuator."""
    dofs, places = np.full((2, model.nu), -1)
    driven = model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT
    joints = model.actuator_trnid[driven, 0]
    dofs[driven], places[driven] = model.jnt_dofadr[joints], model.jnt_qposadr[joints]
    limited = model.actuator_forcelimited.astype(bool)[:, None]
    limits = np.where(limited, model.actuator_forcerange, [-np.inf, np.inf])
    laws = [model.actuator_gainprm[:, :1], model.actuator_biasprm[:, :3], limits]
    return dofs, places, model.actuator_gear[:, 0].copy(), np.hstack(laws)


def _addresses(
    model: mujoco.MjModel, joints: tuple[str, ...]
) -> tuple[Integers, tuple[Any, Any]]:
    read = []
    for column, name in enumerate(joints):
        read.append((column, int(model.joint(name).qposadr[0])))
        link = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name + SUFFIX)
        if link >= 0:
            read.append((column, int(model.jnt_qposadr[link])))
    positions = [int(model.joint(name).qposadr[0]) for name in joints]
    velocities = [dof_of(model, name) for name in joints]
    return np.array(read), (positions, velocities)


def _limits(torque: Array) -> tuple[float, ...]:
    """Return limits from just below the largest torque to below the usual one."""
    high = 0.9 * float(np.quantile(torque, 0.995))
    low = max(0.6 * float(np.median(torque)), 0.08 * high)
    count = int(np.ceil(np.log(high / low) / np.log(_CLOSE))) + 1
    return tuple(np.geomspace(high, low, min(max(count, 2), _MOST_STARTS)).tolist())


def _joint_names(model: mujoco.MjModel) -> set[str]:
    return {model.joint(i).name for i in range(model.njnt)}


def _held(recording: Recording, step: float, size: int, columns: list[int]) -> Array:
    """Return the commands at each physics step, held between rows, (steps, nu)."""
    steps = round(recording.seconds / step) + 1
    times = recording.time[0] + step * np.arange(steps)
    # A row counts from the step that is nearest to it in time.
    row = np.searchsorted(recording.time, times + 0.5 * step, side="right") - 1
    commands = np.zeros((steps, size))
    commands[:, columns] = np.asarray(recording.command, dtype=float)[row]
    return commands


def _velocity(recording: Recording) -> Array:
    if recording.velocity is not None:
        return np.asarray(recording.velocity, dtype=float)
    period = float(np.median(np.diff(recording.time)))
    rows = min(9, recording.rows - (recording.rows + 1) % 2)
    return np.asarray(
        savgol_filter(recording.position, rows, min(3, rows - 1), 1, period, axis=0)
    )


def _shots(
    index: int, recording: Recording, step: float, horizon: float | None
) -> list[Shot]:
    rows = recording.rows
    period = float(np.median(np.diff(recording.time)))
    length = rows - 1 if horizon is None else max(2, round(horizon / period))
    velocity = _velocity(recording)
    position = np.asarray(recording.position, dtype=float)
    # A speed told from positions is poor at the first row of a recording.
    settle = 0 if recording.velocity is not None else round(SETTLE / period)
    settle = min(settle, max(0, rows - 3))
    shots = []
    for first in range(0, rows - 2, length):
        last = min(first + length, rows - 1)
        begin = round((recording.time[first] - recording.time[0]) / step)
        begin_row = first + 1 + (settle if horizon is None else 0)
        exact = (recording.time[begin_row : last + 1] - recording.time[0]) / step
        exact = exact - begin
        near = np.round(exact)
        exact = np.where(np.abs(exact - near) < 1e-3, near, exact)
        frames = np.floor(exact).astype(np.int64)
        steps = int(frames[-1]) + 1
        state = np.stack([position[first], velocity[first]])
        shots.append(
            Shot(
                index,
                first,
                begin_row,
                last,
                begin,
                steps,
                frames,
                exact - frames,
                state,
            )
        )
    return shots


def _parts(shots: list[Shot], hypotheses: int, threads: int) -> list[list[Shot]]:
    """Split the shots where there are fewer hypotheses than threads could take."""
    if hypotheses >= 4 * threads or len(shots) < threads:
        return [shots]
    bounds = np.linspace(0, len(shots), threads + 1).astype(int)
    return [shots[a:b] for a, b in pairwise(bounds)]
