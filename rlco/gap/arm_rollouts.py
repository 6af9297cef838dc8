"""Position-commanded arms: measured against simulated joint positions.

Each recording is rolled out open loop from its first row, with the recorded commands.
A servo forgets where it started, so that the longest rollouts tell most; where a robot
does not, the rollout is anchored to the measurement again and again (`shots`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import mujoco
import numpy as np

from rlco.gap.log import Array, Log, Recording
from rlco.gap.needed_torque import limits, servo_torque
from rlco.gap.problem import Candidate, Hypothesis, Integers, Layout, Problem
from rlco.gap.rollout_kernel import roll_out, roll_out_terms
from rlco.gap.shots import (
    Shot,
    held_commands,
    joint_velocity,
    parts_of,
    shots_of,
)
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


class ArmRollouts(Problem):
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
        self._pool = ThreadPoolExecutor(threads)
        self._columns = [self.model.actuator(name).id for name in log.actuators]
        self._positions = [
            np.asarray(recording.position, dtype=float) for recording in log.recordings
        ]
        step = float(self.model.opt.timestep)
        self._commands = [
            held_commands(recording, step, self.model.nu, self._columns)
            for recording in log.recordings
        ]
        self.shots = [
            shot
            for index, recording in enumerate(log.recordings)
            for shot in shots_of(index, recording, step, horizon)
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
        found = [self.traces(Hypothesis(), i) for i in range(len(self.log.recordings))]
        command, position, velocity = (
            np.concatenate([one[name] for one in found])
            for name in ("command", "simulated", "velocity")
        )
        torque = servo_torque(self.model, self.log.joints, command, position, velocity)
        return {
            Candidate("torque_limit", name): limits(np.abs(column))
            for name, column in zip(self.log.joints, torque.T, strict=True)
            if np.isfinite(column).all() and column.any()
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
            for part in parts_of(shots, len(hypotheses), self.threads)
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
        position, velocity = log.position, joint_velocity(log)
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


def _joint_names(model: mujoco.MjModel) -> set[str]:
    return {model.joint(i).name for i in range(model.njnt)}
