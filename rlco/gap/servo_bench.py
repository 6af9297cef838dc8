"""A servo of its own firmware that drives a pendulum: one joint, in microseconds.

The bench of BAM (arXiv 2410.08650): the firmware turns the error into a duty, the
duty is a voltage behind a resistance. One kernel steps all recordings of a hypothesis;
every number of it is read from the compiled model and from `StepTerms`:

- the actuator's gain is the torque of the full duty at standstill, ``kt vin / R``, and
  its velocity feedback the back-EMF ``kt^2 / R``; both are gone while the drive is off;
- `actuator_gain` is another gain of the firmware, before its duty is limited;
- `torque_limit` and `drive_loss` act on the torque of the drive, as in MuJoCo.

Nobody knows the motor constants of a hobby servo beforehand, nor its encoder's zero.
These six numbers are `servo_numbers`: fitted along with every hypothesis, counted as
parameters, and never named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from rlco.errors import DataError
from rlco.gap.log import Array, Log
from rlco.gap.noise import position_noise
from rlco.gap.problem import Candidate, Hypothesis, Layout, Problem
from rlco.gap.servo_kernel import Plant, Runs, simulate
from rlco.gap.servo_plant import OWN, SERVO_NUMBERS, plant_of, spread_plant
from rlco.gap.servo_runs import at_rows, enabled, joined, run_of
from rlco.physics.effects import EFFECTS, AppliedEffect, StepTerms

# They need more than one joint, or contacts; what is held is the pendulum's own mass.
_NOT_SHOWN = (
    "backlash",
    "joint_compliance",
    "contact_friction",
    "contact_stiffness",
    "object_mass",
    "payload",
)
# Duty for each radian and unit of gain of a Dynamixel XL330: 4096 steps a turn, in
# 256ths, of a largest duty of 885.
XL330 = 4096.0 / (2.0 * np.pi) / (256.0 * 885.0)


class ServoBench(Problem):
    """A `Problem` of one joint: positions that were logged against simulated ones.

    Args:
        spec: One hinge with one actuator whose command is the duty, see `pendulum`.
        log: Positions and commanded positions of that joint. The `facts` of each
            recording hold ``kp``, the firmware's gain; its `extra` may hold
            ``torque_enable``, zero while the drive was off.
        duty_gain: Duty for each radian of error and unit of ``kp`` [1/rad].

    Raises:
        DataError: If the model has more than one joint, or a channel is missing.
    """

    def __init__(
        self,
        spec: mujoco.MjSpec,
        log: Log,
        *,
        duty_gain: float = XL330,
    ) -> None:
        self.spec, self.log = spec, log
        self.model: mujoco.MjModel = spec.copy().compile()
        if self.model.nv != 1 or self.model.nu != 1:
            raise DataError(
                f"the model has {self.model.nv} degrees of freedom and {self.model.nu} "
                "actuators; a servo bench has one of each, use position logs' "
                "rollouts for arms."
            )
        self._data = mujoco.MjData(self.model)
        self.spread_names = OWN
        self._step = float(self.model.opt.timestep)
        self._runs = [run_of(one, self._step, duty_gain) for one in log.recordings]
        self._joined: dict[tuple[int, ...], Runs] = {}
        rows = np.array([recording.rows for recording in log.recordings])
        self.layout = Layout(
            np.repeat(np.arange(len(rows)), rows),
            np.concatenate([recording.time for recording in log.recordings]),
            np.zeros(rows.sum(), dtype=np.int64),
            log.joints,
            ("rad",),
        )
        self.noise = position_noise(log).deviation

    def candidates(self) -> list[Candidate]:
        """Return each effect that one commanded joint can show."""
        joint = self.model.joint(0).name
        found = []
        for effect in EFFECTS.values():
            if effect.name in _NOT_SHOWN:
                continue
            # That a firmware closes the loop, not MuJoCo, hides some from `targets`.
            targets = effect.targets(self.model)
            if not targets and effect.on_command is not None:
                targets = (joint,)
            found += [Candidate(effect.name, target) for target in targets]
        return found

    def residuals(
        self, hypotheses: Sequence[Hypothesis], recordings: Sequence[int] | None = None
    ) -> Array:
        """Return measured minus simulated positions, (hypotheses, N) [rad]."""
        every = range(len(self._runs))
        chosen = [i for i in every if recordings is None or i in recordings]
        measured = self._measured(chosen)
        simulated = [self._simulate(hypothesis, chosen) for hypothesis in hypotheses]
        found = measured - np.stack(simulated)
        return np.where(np.isfinite(found), found, np.inf)

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        """Return signals of one recording, see `Problem.traces`.

        Besides the usual ones, ``duty`` is what the firmware asks for, in [-1, 1].
        """
        log = self.log.recordings[recording]
        position = np.asarray(log.position, dtype=float)
        velocity = np.gradient(position, log.time, axis=0)
        plant = self.plant(Hypothesis())
        weight = plant.gravity_sin * np.sin(position)
        command = np.asarray(log.command, dtype=float)
        return {
            "time": log.time,
            "measured": position,
            "simulated": self._simulate(hypothesis, [recording])[:, None],
            "velocity": velocity,
            "acceleration": np.gradient(velocity, log.time, axis=0),
            "command": command,
            "torque": weight + plant.gravity_cos * np.cos(position),
            "duty": self.duty(recording),
        }

    def duty(self, recording: int) -> Array:
        """Return the duty that the firmware asks for, by what was measured, (T, 1)."""
        log = self.log.recordings[recording]
        error = np.asarray(log.command) - np.asarray(log.position)
        on = enabled(log)[:, None]
        asked: Array = np.clip(self._runs[recording].gain * error, -1.0, 1.0) * on
        return asked

    def plant(self, hypothesis: Hypothesis) -> Plant:
        """Return the kernel's numbers under a hypothesis."""
        spec = self.spec.copy()
        terms = StepTerms.none(self.model)
        parts, _, effects = _split(hypothesis)
        for applied in effects:
            effect = EFFECTS[applied.name]
            if effect.on_spec is not None:
                effect.on_spec(spec, applied.target, applied.values)
            if effect.on_step is not None:
                effect.on_step(terms, 0, 0, applied.values)
        plant = plant_of(self.model, self._data, spec.compile(), terms)
        return spread_plant(plant, self.model, parts)

    def _measured(self, recordings: Sequence[int]) -> Array:
        rows = [np.asarray(self.log.recordings[i].position)[:, 0] for i in recordings]
        return np.concatenate(rows)

    def _simulate(self, hypothesis: Hypothesis, recordings: Sequence[int]) -> Array:
        """Return what the encoder would have told in the recordings' rows, (rows,)."""
        _, zero, effects = _split(hypothesis)
        runs = self._sent(recordings, effects)
        # The servo pulls what its encoder tells to the goal.
        start = runs.start - [zero, 0.0]
        true = runs._replace(goal=runs.goal - zero, start=start)
        track = simulate(self.plant(hypothesis), true, self._step)
        rows = at_rows(track, runs.place) + zero
        for applied in effects:
            told = EFFECTS[applied.name].on_measurement
            if told is not None:
                rows = told(rows[:, None], 0, applied.values)[:, 0]
        return rows

    def _sent(
        self, recordings: Sequence[int], effects: Sequence[AppliedEffect]
    ) -> Runs:
        """Return what the servo was sent, as effects on the way have it."""
        on_the_way = [e for e in effects if EFFECTS[e.name].on_command is not None]
        if on_the_way:
            return joined(
                [self._changed(self._runs[i], on_the_way) for i in recordings]
            )
        key = tuple(recordings)
        if key not in self._joined:
            self._joined[key] = joined([self._runs[i] for i in recordings])
        return self._joined[key]

    def _changed(self, run: Runs, effects: Sequence[AppliedEffect]) -> Runs:
        goal, start = run.goal[:, None], run.start.copy()
        for applied in effects:
            effect = EFFECTS[applied.name]
            if effect.on_command is not None:
                goal = effect.on_command(goal, 0, self._step, applied.values)
            if effect.on_start is not None:
                start[:, :1] = effect.on_start(start[:, :1], 0, applied.values)
        return run._replace(goal=np.ascontiguousarray(goal[:, 0]), start=start)


def _split(hypothesis: Hypothesis) -> tuple[Array, float, list[AppliedEffect]]:
    """Return the servo's own numbers, its zero [rad], and the effects beside them."""
    numbers = np.zeros(len(OWN) + 1)
    if hypothesis.spread:
        numbers[:-1] += hypothesis.spread
    for applied in hypothesis.effects:
        if applied.name == SERVO_NUMBERS:
            numbers += applied.values
    others = [one for one in hypothesis.effects if one.name != SERVO_NUMBERS]
    return numbers[:-1], float(numbers[-1]), others
