"""Positions and torques: measured torques against inverse dynamics, without rollouts.

Motion is taken as measured, so that nothing drifts and a hypothesis costs milliseconds.
An effect means here what it does to the torque that a motion takes, all read from the
model it gives and from `StepTerms`:

- what changes masses, springs, damping, armature or gravity changes inverse dynamics;
- friction acts against the sign of the measured speed, smoothed near zero;
- a bias of the actuator pushes along, so that less is measured;
- another gain is a torque constant that the drive does not know of;
- a delay is one between the torques' clock and the positions';
- what an encoder tells wrongly changes the motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from rlco.gap.inverse_dynamics import inverse_dynamics
from rlco.gap.log import Array, Log
from rlco.gap.noise import measurement_noise
from rlco.gap.problem import Candidate, Hypothesis, Layout, Problem
from rlco.gap.slim import slim_down
from rlco.gap.smooth_motion import Motion, joined, smoothed
from rlco.gap.torque_spread import apply_torque_spread, torque_spread_names
from rlco.physics.effects import EFFECTS, AppliedEffect, Effect, StepTerms
from rlco.physics.effects.apply import true_from_told
from rlco.physics.effects.targets import actuator_of, dof_of, driven_joints

# Not to be seen where the motion is given: the way of a command, contacts, and a link
# whose own motion was not measured.
_NOT_SHOWN = (
    "actuator_lag",
    "torque_limit",
    "velocity_limit",
    "control_rate",
    "backlash",
    "joint_compliance",
    "drive_loss",
    "contact_friction",
    "contact_stiffness",
    "object_mass",
)
# Friction changes its sign over speeds of this size [rad/s].
_SIGN_SPEED = 0.01
_TOGETHER = 0.8


class TorqueLog(Problem):
    """A `Problem`: torques that were measured against those that the motion takes.

    Args:
        spec: The model; every logged joint a hinge or a slide.
        log: Positions and torques of its joints.
        window: Seconds over which positions are smoothed to get accelerations.
        noise: Standard deviation of the measured torques, (joints,) [N m]; by default
            what in them is too fast for an arm.

    Raises:
        DataError: If torques are missing, or a recording is shorter than the window.

    Example:
        >>> spec = mujoco.MjSpec.from_string(
        ...     "<mujoco><worldbody><body name='arm'><joint name='j' axis='0 1 0'/>"
        ...     "<inertial mass='2' pos='0.5 0 0' diaginertia='1 1 1'/></body>"
        ...     "</worldbody><actuator><motor joint='j'/></actuator></mujoco>")
        >>> still = np.zeros((50, 1))
        >>> from rlco.gap.log import Recording
        >>> level = Recording("level", 0.02 * np.arange(50), still, torque=still - 9.0)
        >>> problem = TorqueLog(spec, Log((level,), joints=("j",)))
        >>> # Gravity wants 9.81 N m.
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
    ) -> None:
        self.log = log
        self.model: mujoco.MjModel = spec.copy().compile()
        self._spec = _unconstrained(spec)
        self._motions = [smoothed(recording, window) for recording in log.recordings]
        self._dofs = np.array([dof_of(self.model, name) for name in log.joints])
        self._actuators = [actuator_of(self.model, name) for name in log.joints]
        self.spread_names = torque_spread_names(self.model)
        self.layout = self._layout()
        self.noise = self._noise() if noise is None else np.asarray(noise)

    def candidates(self) -> list[Candidate]:
        """Return each effect that changes a torque, at each target.

        Another torque constant is one only where a joint's torque goes with the
        model's: where friction is most of it, a factor would be of anything.
        """
        joints = {self.model.joint(i).name for i in range(self.model.njnt)}
        told = [
            name
            for name, together in zip(self.log.joints, self._together(), strict=True)
            if together > _TOGETHER
        ]
        return [
            Candidate(effect.name, target)
            for effect in EFFECTS.values()
            if effect.name not in _NOT_SHOWN
            for target in _targets(effect, self.model)
            if target not in joints or target in self.log.joints
            if effect.name != "actuator_gain" or target in told
        ]

    def _together(self) -> list[float]:
        """Correlation of each joint's measured torque with the model's."""
        motion = joined(self._motions)
        computed = self.torque(Hypothesis(), motion)
        return [
            float(np.corrcoef(one, other)[0, 1]) if one.any() and other.any() else 0.0
            for one, other in zip(motion.torque.T, computed.T, strict=True)
        ]

    def residuals(
        self, hypotheses: Sequence[Hypothesis], recordings: Sequence[int] | None = None
    ) -> Array:
        """Return measured minus computed torques, (hypotheses, N) [N m]."""
        every = range(len(self._motions))
        chosen = [i for i in every if recordings is None or i in recordings]
        motion = joined([self._motions[i] for i in chosen])
        left = [motion.torque - self.torque(one, motion) for one in hypotheses]
        return np.stack([rows.ravel() for rows in left])

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        """Return signals of one recording, see `Problem.traces`.

        Besides the usual ones, ``position``; ``torque`` is what the model's weight
        takes.
        """
        motion = self._motions[recording]
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
        """Return what a drive would have measured, (rows, joints) [N m]."""
        spec = self._spec.copy()
        if hypothesis.spread:
            apply_torque_spread(spec, self.spread_names, hypothesis.spread)
        terms = StepTerms.none(self.model)
        for applied in hypothesis.effects:
            effect, target = EFFECTS[applied.name], str(applied.target)
            if effect.on_spec is not None:
                effect.on_spec(spec, applied.target, applied.values)
            if effect.on_step is not None:
                dof, actuator = (of(self.model, target) for of in (dof_of, actuator_of))
                effect.on_step(terms, dof, actuator, applied.values)
        model = spec.compile()
        position, velocity, acceleration = self._true_motion(motion, hypothesis.effects)
        torque, load = inverse_dynamics(
            model, self._dofs, (position, velocity, acceleration)
        )
        dofs = self._dofs
        friction = model.dof_frictionloss[dofs] + terms.load[dofs] * abs(torque + load)
        slowness = np.exp(-((velocity / terms.stribeck_speed[dofs]) ** 2))
        friction += terms.static[dofs] * slowness
        torque += friction * np.tanh(velocity / _SIGN_SPEED)
        for column, actuator in enumerate(self._actuators):
            if actuator >= 0:
                bias, gain = _changed_drive(self.model, model, actuator)
                torque[:, column] = (torque[:, column] - bias) / gain
        for applied in hypothesis.effects:
            if applied.name == "command_delay":
                torque = _ahead(motion, torque, float(applied.values[0]))
        return torque

    def _true_motion(
        self, motion: Motion, effects: tuple[AppliedEffect, ...]
    ) -> list[Array]:
        def true(told: Array) -> Array:
            return true_from_told(told, self.log.joints, effects)

        # Of an encoder's error, an offset is none of its derivatives.
        offset = true(np.zeros_like(motion.position))
        speeds = [
            true(part) - offset for part in (motion.velocity, motion.acceleration)
        ]
        return [true(motion.position), *speeds]

    def _noise(self) -> Array:
        parts = [(motion.time, motion.torque) for motion in self._motions]
        return measurement_noise(parts).deviation

    def _layout(self) -> Layout:
        joints = len(self.log.joints)
        rows = [len(motion.time) for motion in self._motions]
        slide = mujoco.mjtJoint.mjJNT_SLIDE
        kinds = self.model.jnt_type[self.model.dof_jntid[self._dofs]]
        return Layout(
            np.repeat(np.arange(len(rows)), np.array(rows) * joints),
            np.repeat(np.concatenate([m.time for m in self._motions]), joints),
            np.tile(np.arange(joints), sum(rows)),
            self.log.joints,
            tuple("N" if kind == slide else "N m" for kind in kinds),
        )


def _targets(effect: Effect, model: mujoco.MjModel) -> tuple[str | None, ...]:
    """Return what an effect may act on: an encoder tells wrongly whatever drives."""
    encoder = effect.on_measurement is not None
    return driven_joints(model) if encoder else effect.targets(model)


def _unconstrained(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Return a slim model without contacts, limits and MuJoCo's friction.

    Inverse dynamics could not know the sign of a friction constraint at rest.
    """
    free = spec.copy()
    free.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    free.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    return slim_down(free)


def _changed_drive(
    nominal: mujoco.MjModel, model: mujoco.MjModel, actuator: int
) -> tuple[float, float]:
    """Return a drive's added torque, and by which factor it is stronger."""
    added = model.actuator_biasprm[actuator, 0] - nominal.actuator_biasprm[actuator, 0]
    gain = model.actuator_gainprm[actuator, 0] / nominal.actuator_gainprm[actuator, 0]
    return float(added * nominal.actuator_gear[actuator, 0]), float(gain)


def _ahead(motion: Motion, torque: Array, delay: float) -> Array:
    """Return torques that must be sent earlier to act in time."""
    ahead = np.empty_like(torque)
    for rows in motion.recordings:
        time = motion.time[rows]
        for column in range(torque.shape[1]):
            ahead[rows, column] = np.interp(time + delay, time, torque[rows, column])
    return ahead
