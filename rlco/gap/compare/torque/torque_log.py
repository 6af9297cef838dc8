"""Positions and torques: measured torques against inverse dynamics, without rollouts.

The motion is taken as measured. Nothing drifts, and a hypothesis costs milliseconds. An
effect acts on the torque that the motion requires, through the model it produces and
its forces at each step:

- changes of masses, springs, damping, armature or gravity change inverse dynamics;
- friction opposes the measured velocity, smoothed near zero;
- a torque that an effect adds reduces what the drive has to supply;
- an actuator's bias also pushes, so that less torque is measured;
- a gain is a torque constant that the drive does not know;
- a delay shifts the clock of the torques against that of the positions;
- an encoder error changes the motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.gap.compare.noise import measurement_noise
from rlco.gap.compare.problem import (
    Calibrated,
    Candidate,
    Hypothesis,
    Layout,
    Problem,
)
from rlco.gap.compare.torque.inverse_dynamics import inverse_dynamics
from rlco.gap.compare.torque.model_tolerance import (
    apply_torque_tolerance,
    torque_tolerance_names,
)
from rlco.gap.compare.torque.smooth_motion import Motion, joined, smoothed
from rlco.gap.logs.log import Array, Log
from rlco.gap.prune import prune
from rlco.physics.effects import AppliedEffect, Effect, searched
from rlco.physics.effects.actuator import ACTUATOR_GAIN
from rlco.physics.effects.apply import apply_to_spec, step_forces, true_positions
from rlco.physics.effects.command import COMMAND_DELAY, RANDOM_DELAY
from rlco.physics.effects.link_parameters import TORQUE_OFFSET, TORQUE_SCALE
from rlco.physics.effects.step_forces import Laws, law_along
from rlco.physics.effects.targets import actuator_of, dof_of, driven_joints

# Range of velocities over which friction changes sign [rad/s].
SIGN_SPEED = 0.01
_TOGETHER = 0.8
BoolArray = NDArray[np.bool_]


class TorqueLog(Problem):
    """A `Problem`: measured torques against those that the measured motion requires.

    Args:
        spec: The model; every logged joint is a hinge or a slide.
        log: Positions and torques of its joints.
        window: Seconds over which positions are smoothed to derive accelerations.
        noise: Standard deviation of the measured torques, (joints,) [N m]; by default
            the part of them that is too fast for an arm.
        calibration: The calibration that `spec` has, and what it leaves open; None: a
            few per cent of each parameter.

    Attributes:
        motions: The smoothed motion of each recording.

    Raises:
        DataError: If torques are missing, or a recording is shorter than the window.

    Example:
        >>> spec = mujoco.MjSpec.from_string(
        ...     "<mujoco><worldbody><body name='arm'><joint name='j' axis='0 1 0'/>"
        ...     "<inertial mass='2' pos='0.5 0 0' diaginertia='1 1 1'/></body>"
        ...     "</worldbody><actuator><motor joint='j'/></actuator></mujoco>")
        >>> still = np.zeros((50, 1))
        >>> from rlco.gap.logs.log import Recording
        >>> level = Recording("level", 0.02 * np.arange(50), still, torque=still - 9.0)
        >>> problem = TorqueLog(spec, Log((level,), joints=("j",)))
        >>> # Holding against gravity takes 9.81 N m.
        >>> bias = AppliedEffect("torque_bias", "j", {"torque": -0.81})
        >>> problem.residuals([Hypothesis(), Hypothesis((bias,))])[:, 0].round(3)
        array([0.81, 0.  ])
    """

    def __init__(
        self,
        spec: mujoco.MjSpec,
        log: Log,
        *,
        window: float = 0.4,
        noise: Array | None = None,
        calibration: Calibrated | None = None,
    ) -> None:
        self.log, self.calibration, self.window = log, calibration, window
        self.model: mujoco.MjModel = spec.copy().compile()
        self._spec = _unconstrained(spec)
        if calibration is not None:
            self._nominal = _unconstrained(calibration.nominal)
            self._calibrated = calibration.effects()
        self.motions = [smoothed(recording, window) for recording in log.recordings]
        self._dofs = np.array([dof_of(self.model, name) for name in log.joints])
        self._actuators = [actuator_of(self.model, name) for name in log.joints]
        self.tolerance_names = (
            torque_tolerance_names(self.model)
            if calibration is None
            else calibration.names
        )
        self.layout = self._layout()
        self.noise = self._noise() if noise is None else np.asarray(noise)

    def candidates(self, *, uncommon: bool = False) -> list[Candidate]:
        """Return each effect that changes a torque, at each target.

        A torque constant is a candidate only where a joint's torque correlates with the
        model's. Where friction dominates, such a factor could stand for anything.
        Between two recordings of one robot it is one of what is reported, and an offset
        of that stands for a bias of drives that the model lacks.

        Args:
            uncommon: Of the effects that are tried only where the others leave
                something.
        """
        gain, driven = ACTUATOR_GAIN.name, driven_joints(self.model)
        joints = {self.model.joint(i).name for i in range(self.model.njnt)}
        correlated = [
            name
            for name, together in zip(self.log.joints, self._together(), strict=True)
            if together > _TOGETHER
        ]
        found = [
            Candidate(effect.name, target)
            for effect in searched("torques", uncommon=uncommon)
            for target in _targets(effect, self.model)
            if target not in joints or target in self.log.joints
            if effect.name != gain or target in correlated
        ]
        if self.calibration is None or uncommon:
            return found
        found = [one for one in found if one.name != gain]
        found += [Candidate(TORQUE_SCALE.name, joint) for joint in correlated]
        undriven = [joint for joint in self.log.joints if joint not in driven]
        return found + [Candidate(TORQUE_OFFSET.name, joint) for joint in undriven]

    def _together(self) -> list[float]:
        """Return each joint's correlation of measured and modelled torque."""
        motion = joined(self.motions)
        computed = self.torque(Hypothesis(), motion)
        return [
            float(np.corrcoef(one, other)[0, 1]) if one.any() and other.any() else 0.0
            for one, other in zip(motion.torque.T, computed.T, strict=True)
        ]

    def residuals(
        self, hypotheses: Sequence[Hypothesis], recordings: Sequence[int] | None = None
    ) -> Array:
        """Return measured minus computed torques, (hypotheses, N) [N m]."""
        every = range(len(self.motions))
        chosen = [i for i in every if recordings is None or i in recordings]
        motion = joined([self.motions[i] for i in chosen])
        residuals = [motion.torque - self.torque(one, motion) for one in hypotheses]
        return np.stack([rows.ravel() for rows in residuals])

    def standing(self) -> BoolArray:
        """Return where a joint is so slow that its friction's sign is smoothed, (N,).

        Friction at rest takes any value up to that in motion, and either sign.
        """
        velocity = np.concatenate([motion.velocity for motion in self.motions])
        return np.asarray(np.abs(velocity) < 2.0 * SIGN_SPEED).ravel()

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        """Return signals of one recording, see `Problem.traces`.

        Besides the usual ones, ``position``; ``torque`` is the model's torque against
        gravity.
        """
        motion = self.motions[recording]
        still = np.zeros_like(motion.position)
        model = self._spec.copy().compile()
        weight, _ = inverse_dynamics(model, self._dofs, (motion.position, still, still))
        return {
            "time": motion.time,
            "measured": motion.torque,
            "simulated": self.torque(hypothesis, motion),
            "position": motion.position,
            "velocity": motion.velocity,
            "acceleration": motion.acceleration,
            "torque": weight,
        }

    def torque(self, hypothesis: Hypothesis, motion: Motion) -> Array:
        """Return the torque that a drive would have measured, (rows, joints) [N m]."""
        spec = self._spec.copy()
        reported: tuple[AppliedEffect, ...] = hypothesis.effects
        if self.calibration is not None:
            calibrated = self._calibrated
            if hypothesis.spread:
                calibrated = self.calibration.effects(hypothesis.spread)
                spec = self._nominal.copy()
                apply_to_spec(spec, calibrated)
            reported = (*calibrated, *reported)
        elif hypothesis.spread:
            apply_torque_tolerance(spec, self.tolerance_names, hypothesis.spread)
        apply_to_spec(spec, hypothesis.effects)
        forces = step_forces(self.model, hypothesis.effects)
        model = spec.compile()
        position, velocity, acceleration = self._true_motion(motion, hypothesis.effects)
        torque, load = inverse_dynamics(
            model, self._dofs, (position, velocity, acceleration)
        )
        dofs = self._dofs
        moving = position, velocity, torque, abs(torque + load)
        friction = model.dof_frictionloss[dofs] + self._forces(forces.friction, moving)
        added = self._forces(forces.torque, moving)
        torque += friction * np.tanh(velocity / SIGN_SPEED) - added
        for column, actuator in enumerate(self._actuators):
            if actuator >= 0:
                bias, gain = _changed_drive(self.model, model, actuator)
                torque[:, column] = (torque[:, column] - bias) / gain
        for applied in hypothesis.effects:
            if applied.name in (COMMAND_DELAY.name, RANDOM_DELAY.name):
                torque = _ahead(motion, torque, float(applied.values[0]))
        return self._as_reported(torque, reported)

    def _as_reported(self, torque: Array, effects: Sequence[AppliedEffect]) -> Array:
        """Return torques with the factors and offsets of effects, (rows, joints)."""
        for applied in effects:
            if applied.target not in self.log.joints:
                continue
            column = self.log.joints.index(applied.target)
            if applied.name == TORQUE_SCALE.name:
                torque[:, column] *= applied.values[0]
            elif applied.name == TORQUE_OFFSET.name:
                torque[:, column] += applied.values[0]
        return torque

    def _forces(self, laws: Laws, moving: tuple[Array, ...]) -> Array:
        """Return the forces of laws at each joint of the log, (rows, joints)."""
        found = np.zeros_like(moving[0])
        for row, dof in enumerate(laws.rows[:, 1]):
            for column in np.flatnonzero(self._dofs == dof):
                signals = [np.ascontiguousarray(one[:, column]) for one in moving]
                found[:, column] += law_along(laws, row, *signals)
        return found

    def _true_motion(
        self, motion: Motion, effects: tuple[AppliedEffect, ...]
    ) -> list[Array]:
        def true(measured: Array) -> Array:
            return true_positions(measured, self.log.joints, effects)

        # An encoder's offset must not enter the derivatives.
        offset = true(np.zeros_like(motion.position))
        speeds = [
            true(part) - offset for part in (motion.velocity, motion.acceleration)
        ]
        return [true(motion.position), *speeds]

    def _noise(self) -> Array:
        parts = [(motion.time, motion.torque) for motion in self.motions]
        return measurement_noise(parts).deviation

    def _layout(self) -> Layout:
        joints = len(self.log.joints)
        rows = [len(motion.time) for motion in self.motions]
        slide = mujoco.mjtJoint.mjJNT_SLIDE
        kinds = self.model.jnt_type[self.model.dof_jntid[self._dofs]]
        return Layout(
            np.repeat(np.arange(len(rows)), np.array(rows) * joints),
            np.repeat(np.concatenate([m.time for m in self.motions]), joints),
            np.tile(np.arange(joints), sum(rows)),
            self.log.joints,
            tuple("N" if kind == slide else "N m" for kind in kinds),
        )


def _targets(effect: Effect, model: mujoco.MjModel) -> tuple[str | None, ...]:
    """Return an effect's targets; an encoder may be wrong whatever drives its joint."""
    encoder = effect.on_measurement is not None
    return driven_joints(model) if encoder else effect.targets(model)


def _unconstrained(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Return a pruned model without contacts, limits and MuJoCo's friction.

    Inverse dynamics cannot know the sign of a friction constraint at rest.
    """
    free = spec.copy()
    free.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    free.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    return prune(free)


def _changed_drive(
    nominal: mujoco.MjModel, model: mujoco.MjModel, actuator: int
) -> tuple[float, float]:
    """Return a drive's additional torque, and the ratio of its gains."""
    added = model.actuator_biasprm[actuator, 0] - nominal.actuator_biasprm[actuator, 0]
    gain = model.actuator_gainprm[actuator, 0] / nominal.actuator_gainprm[actuator, 0]
    return float(added * nominal.actuator_gear[actuator, 0]), float(gain)


def _ahead(motion: Motion, torque: Array, delay: float) -> Array:
    """Return torques sent earlier by the delay, so that they act in time."""
    ahead = np.empty_like(torque)
    for rows in motion.recordings:
        time = motion.time[rows]
        for column in range(torque.shape[1]):
            ahead[rows, column] = np.interp(time + delay, time, torque[rows, column])
    return ahead
