"""Position-controlled arms: residuals of measured against simulated joint positions.

Each recording is rolled out open loop from its first row, with the recorded commands.
A servo forgets its initial state, so the longest rollouts are the most informative. For
a robot that does not, rollouts restart from the measurement repeatedly (`segments`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import replace

import mujoco
import numpy as np

from rlco.gap.compare.arm.channels import (
    addresses,
    joint_commands,
    joint_names,
    layout_of,
)
from rlco.gap.compare.arm.command_changes import CommandChanges
from rlco.gap.compare.arm.divergence import diverged
from rlco.gap.compare.arm.guessed_commands import by_guesses, held_off
from rlco.gap.compare.arm.kernel import Outside
from rlco.gap.compare.arm.needed_torque import limits, servo_torque, static_torque
from rlco.gap.compare.arm.read_wrong import read_wrong
from rlco.gap.compare.arm.step_through import NONE, step_through
from rlco.gap.compare.model_tolerance import apply_tolerance, tolerance_names
from rlco.gap.compare.problem import (
    Calibrated,
    Candidate,
    Hypothesis,
    Problem,
    Run,
)
from rlco.gap.compare.segments import (
    Segment,
    held_commands,
    joint_velocity,
    parts_of,
    segments_of,
)
from rlco.gap.logs.log import Array, Log
from rlco.physics.effects import AppliedEffect, searched
from rlco.physics.effects.actuator import TORQUE_LIMIT
from rlco.physics.effects.apply import (
    apply_to_commands,
    apply_to_measurement,
    apply_to_spec,
    step_forces,
    true_positions,
)
from rlco.physics.effects.targets import actuator_of, command_at, dof_of
from rlco.physics.mj.libmujoco import silenced_warnings


class ArmRollouts(Problem):
    """A `Problem` for an arm with logged joint commands and positions.

    Args:
        spec: The model, pruned so that it compiles quickly for each hypothesis.
        log: Commands and positions.
        noise: Standard deviation of each joint's measurement [rad or m], (joints,).
        horizon: Length of a rollout [s]; None for whole recordings.
        threads: Rollouts that run in parallel.
        calibration: The calibration that `spec` has, and what it leaves open; None: a
            few per cent of each parameter.
    """

    def __init__(
        self,
        spec: mujoco.MjSpec,
        log: Log,
        noise: Array,
        *,
        horizon: float | None = None,
        threads: int = 2,
        calibration: Calibrated | None = None,
    ) -> None:
        self.spec, self.log, self.noise = spec, log, np.asarray(noise, dtype=float)
        self.model: mujoco.MjModel = spec.copy().compile()
        self.threads, self.horizon = threads, horizon
        self.calibration = calibration
        self.tolerance_names = (
            tolerance_names(self.model) if calibration is None else calibration.names
        )
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
        self.segments = [
            segment
            for index, recording in enumerate(log.recordings)
            for segment in segments_of(index, recording, step, horizon)
        ]
        self.layout = layout_of(self.model, log, self.segments)
        self._torques: tuple[str, Mapping[int, Array]] | None = None
        self._pushes: Mapping[int, Array] = {}
        self._as_read: Mapping[int, Array] = {}

    def candidates(self, *, uncommon: bool = False) -> list[Candidate]:
        """Return each effect at each target that can move these joints.

        Args:
            uncommon: Of the effects that are tried only where the others leave
                something.
        """
        found = []
        driven = set(self.log.joints)
        for effect in searched("positions", uncommon=uncommon):
            for target in effect.targets(self.model):
                joint = target if target in joint_names(self.model) else None
                if joint is None or joint in driven:
                    found.append(Candidate(effect.name, target))
        return found

    def usual_sizes(self) -> Mapping[Candidate, tuple[float, ...]]:
        """Return torque limits a little below what each joint requires.

        This depends on the motion. A joint with a vertical axis carries no weight, and
        one that moves slowly in the log never needs its full torque.
        """
        found = [self.traces(Hypothesis(), i) for i in range(len(self.log.recordings))]
        command, position, velocity = (
            np.concatenate([one[name] for one in found])
            for name in ("command", "simulated", "velocity")
        )
        torque = servo_torque(self.model, self.log.joints, command, position, velocity)
        return {
            Candidate(TORQUE_LIMIT.name, name): limits(np.abs(column))
            for name, column in zip(self.log.joints, torque.T, strict=True)
            if np.isfinite(column).all() and column.any()
        }

    def residuals(
        self, hypotheses: Sequence[Hypothesis], recordings: Sequence[int] | None = None
    ) -> Array:
        """Return measured minus simulated positions, (hypotheses, N)."""
        segments = [
            segment
            for segment in self.segments
            if recordings is None or segment.recording in recordings
        ]
        jobs = [
            (hypothesis, part)
            for hypothesis in hypotheses
            for part in parts_of(segments, len(hypotheses), self.threads)
        ]
        with silenced_warnings():
            rows = list(self._pool.map(lambda job: self.simulate(*job), jobs))
        parts = len(jobs) // max(len(hypotheses), 1)
        return np.stack(
            [
                np.concatenate(rows[i * parts : (i + 1) * parts])
                for i in range(len(hypotheses))
            ]
        )

    def pushed(
        self,
        hypothesis: Hypothesis,
        pushes: Sequence[Mapping[int, Array]],
        recordings: Sequence[int],
    ) -> Array:
        """Return residuals (pushes, N) of recordings with additions to their commands.

        Args:
            hypothesis: What acts.
            pushes: By recording, what is added to the commands as the actuators receive
                them, (steps, nu).
            recordings: Their residuals are returned, in the order of the layout.
        """
        segments = [one for one in self.segments if one.recording in recordings]
        with silenced_warnings():
            rows = self._pool.map(
                lambda push: self.simulate(hypothesis, segments, push), pushes
            )
            return np.stack(list(rows))

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        """Return the signals of one recording, see `Problem.traces`."""
        log = self.log.recordings[recording]
        measured, velocity = np.array(log.position, dtype=float), joint_velocity(log)
        simulated = measured.copy()
        residual = self.residuals([hypothesis], [recording])[0]
        rows = np.concatenate(
            [
                np.arange(segment.begin, segment.last + 1)
                for segment in self.segments
                if segment.recording == recording
            ]
        )
        simulated[rows] -= residual.reshape(len(rows), -1)
        return {
            "time": log.time,
            "measured": measured,
            "simulated": simulated,
            "velocity": velocity,
            "acceleration": np.gradient(velocity, log.time, axis=0),
            "command": joint_commands(self.model, self.log, log, self._columns),
            "torque": static_torque(self.model, self.log.joints, measured),
        }

    def runs(self, hypothesis: Hypothesis, recordings: Sequence[int]) -> list[Run]:
        """Return the rollouts of some recordings, see `Problem.runs`."""
        model, effects = self.compiled(hypothesis), hypothesis.effects
        _, (positions, speeds) = addresses(model, self.log.joints)
        found = []
        for segment in self.segments:
            if segment.recording not in recordings:
                continue
            sent = self._received(segment.recording, model, effects)
            qpos, qvel = model.qpos0.copy(), np.zeros(model.nv)
            qpos[positions] = true_positions(segment.state[0], self.log.joints, effects)
            qvel[speeds] = segment.state[1]
            time = float(self.log.recordings[segment.recording].time[segment.first])
            commands = sent[segment.steps : segment.steps + segment.commands]
            found.append(Run(segment.recording, time, model, qpos, qvel, commands))
        return found

    def compiled(self, hypothesis: Hypothesis) -> mujoco.MjModel:
        """Return the model under a hypothesis."""
        spec = self.spec.copy()
        if hypothesis.spread and self.calibration is not None:
            spec = self.calibration.nominal.copy()
            apply_to_spec(spec, self.calibration.effects(hypothesis.spread))
        elif hypothesis.spread:
            apply_tolerance(spec, self.tolerance_names, hypothesis.spread)
        apply_to_spec(spec, hypothesis.effects)
        return spec.compile()

    def changes(self, late: Sequence[Array]) -> list[CommandChanges]:
        """Return the changes of each recording's commands.

        Args:
            late: Of each recording, how much later than their rows, (rows,) [s].
        """
        step = float(self.model.opt.timestep)
        pairs = zip(self.log.recordings, late, strict=True)
        return [CommandChanges.of(one, step, times) for one, times in pairs]

    def of_actuators(self, commands: Array) -> Array:
        """Return commands (steps, actuators) as those of the model, (steps, nu)."""
        every = np.zeros((len(commands), self.model.nu))
        every[:, self._columns] = commands
        return every

    def with_late_commands(self, late: Sequence[Array]) -> ArmRollouts:
        """Return the problem with commands that take effect later, see `changes`."""
        other = copy(self)
        held = [self.of_actuators(one.held()) for one in self.changes(late)]
        other._commands = held
        return other

    def by_guesses(self, hypothesis: Hypothesis) -> Array:
        """Return changes of the residuals by guessed commands, (K, N)."""
        return by_guesses(self, hypothesis)

    def with_other_guesses(self, off: Sequence[Array | None]) -> ArmRollouts:
        """Return the problem with unread commands that are off by other amounts.

        Args:
            off: Of each recording, of each of its unread commands, (L, actuators).
        """
        other, step = copy(self), float(self.model.opt.timestep)
        other._commands = [
            sent
            if one is None
            else sent + held_off(log, one, step, self.model.nu, self._columns)
            for log, sent, one in zip(
                self.log.recordings, self._commands, off, strict=True
            )
        ]
        return other

    def with_torques(self, joint: str, torques: Mapping[int, Array]) -> ArmRollouts:
        """Return the problem with further torques at a joint, as if from outside.

        Args:
            joint: The joint; the same as in this problem, if that has such torques.
            torques: By recording, one at each physics step from the first of its
                commands, (steps,) [N m or N].

        Raises:
            ValueError: This problem has such torques at another joint.
        """
        other, (at, known) = copy(self), self._torques or (joint, {})
        if at != joint:
            raise ValueError(f"torques act at {at!r}, so none can at {joint!r} besides")
        added = {i: known.get(i, 0.0) + one for i, one in torques.items()}
        other._torques = joint, {**known, **added}
        return other

    def with_encoder_error(
        self, joint: str, error: Callable[[Array], Array]
    ) -> ArmRollouts:
        """Return the problem with the positions that an encoder reads wrong put right.

        Its servo drives what it reads to the command, so the joint is commanded to as
        much less, along the measured path.

        Args:
            joint: The joint.
            error: What its encoder reads too much [rad or m] where it reads some
                positions, (T,) to (T,).
        """
        other, step = copy(self), float(self.model.opt.timestep)
        column, actuator = self.log.joints.index(joint), actuator_of(self.model, joint)
        other._positions, other._pushes, other._as_read = [], {}, {}
        errors = [read_wrong(one, column, error, step) for one in self.log.recordings]
        for index, one in enumerate(errors):
            right = self._positions[index].copy()
            right[:, column] -= one.at_rows
            other._positions.append(right)
            push = np.zeros((len(one.at_steps), self.model.nu))
            push[:, actuator] = -command_at(self.model, actuator) * one.at_steps
            other._pushes[index] = self._pushes.get(index, 0.0) + push
            slope = 1.0 / self._as_read.get(index, np.ones_like(right))
            slope[:, column] -= one.slope
            other._as_read[index] = 1.0 / slope
        states = [one.state.copy() for one in self.segments]
        for segment, state in zip(self.segments, states, strict=True):
            state[0, column] -= errors[segment.recording].at_rows[segment.first]
        pairs = zip(self.segments, states, strict=True)
        other.segments = [replace(one, state=state) for one, state in pairs]
        return other

    def _received(
        self, index: int, model: mujoco.MjModel, effects: Iterable[AppliedEffect]
    ) -> Array:
        """Return a recording's commands as the actuators receive them, (steps, nu)."""
        received = apply_to_commands(self._commands[index], model, effects)
        if index in self._pushes:
            received = received + self._pushes[index]
        return received

    def _outside(self, model: mujoco.MjModel, segment: Segment) -> Outside | None:
        """Return a segment's torque from outside."""
        if self._torques is None or segment.recording not in self._torques[1]:
            return None
        joint, torques = self._torques
        steps = slice(segment.steps, segment.steps + segment.commands)
        torque = np.ascontiguousarray(torques[segment.recording][steps])
        return NONE._replace(dof=dof_of(model, joint), torque=torque)

    def simulate(
        self,
        hypothesis: Hypothesis,
        segments: Sequence[Segment],
        push: Mapping[int, Array] | None = None,
    ) -> Array:
        """Return measured minus simulated positions of the segments, in order, (N,).

        Args:
            hypothesis: What acts.
            segments: What is rolled out.
            push: See `pushed`.
        """
        effects, joints = hypothesis.effects, self.log.joints
        model = self.compiled(hypothesis)
        forces = step_forces(model, effects)
        data = mujoco.MjData(model)
        read, write = addresses(model, joints)
        filtered: dict[int, Array] = {}
        out = []
        for segment in segments:
            index = segment.recording
            if index not in filtered:
                filtered[index] = self._received(index, model, effects)
                if push is not None and index in push:
                    filtered[index] = filtered[index] + push[index]
            commands = filtered[index][segment.steps : segment.steps + segment.commands]
            start = true_positions(segment.state[0], joints, effects)
            mujoco.mj_resetData(model, data)
            data.qpos[write[0]] = start
            data.qvel[write[1]] = segment.state[1]
            track = np.zeros((segment.commands + 1, len(joints)))
            outside = self._outside(model, segment)
            step_through(model, data, commands, read, track, forces, outside)
            rows = track[segment.frames]
            rows += segment.weights[:, None] * (track[segment.frames + 1] - rows)
            rows = apply_to_measurement(rows, joints, effects)
            residual = self._positions[index][segment.begin : segment.last + 1] - rows
            if index in self._as_read:
                residual *= self._as_read[index][segment.begin : segment.last + 1]
            if diverged(data) or not np.isfinite(residual).all():
                residual = np.full_like(residual, np.inf)
            out.append(residual.ravel())
        return np.concatenate(out)
