"""A servo with its firmware that drives a pendulum: one joint, in microseconds.

The bench of BAM (arXiv 2410.08650): the firmware turns the error into a duty, which
sets the voltage across the winding. One kernel steps all recordings of a hypothesis;
all its parameters are read from the compiled model and from the effects' forces:

- the actuator's gain is the stall torque at full duty, ``kt vin / R``, and its velocity
  feedback the back-EMF ``kt^2 / R``; both are zero while the drive is off;
- `actuator_gain` scales the firmware's gain, before its duty is limited;
- `torque_limit` and `drive_loss` act on the torque of the drive, as in MuJoCo.

The motor constants of a hobby servo and its encoder's zero are unknown beforehand.
These six parameters are `servo_numbers`: fitted along with every hypothesis, counted as
parameters, and never named. The pendulum's mass and length and the voltage are taken
from each recording.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from rlco.gap.compare.noise import position_noise
from rlco.gap.compare.problem import Candidate, Hypothesis, Layout, Problem
from rlco.gap.compare.servo.kernel import Plant, Runs, simulate
from rlco.gap.compare.servo.plant import OWN, SERVO_NUMBERS, plant_of, tolerance_plant
from rlco.gap.compare.servo.runs import at_rows, enabled, joined, pendulum_of, run_of
from rlco.gap.logs.log import Array, Log
from rlco.gap.servo_models import JOINT, TIMESTEP, Pendulum, Servo, pendulum_xml
from rlco.physics.effects import EFFECTS, AppliedEffect, searched
from rlco.physics.effects.apply import apply_to_spec, step_forces


class ServoBench(Problem):
    """A `Problem` of one joint: logged positions against simulated ones.

    Args:
        servo: Its published parameters.
        log: Positions and commanded positions of one joint. The `facts` of each
            recording hold the pendulum's ``mass`` and ``length``, the supply's ``vin``
            and ``kp``, the firmware's gain, and may hold ``arm_mass``; its `extra` may
            hold ``torque_enable``, zero while the drive was off.

    Raises:
        DataError: If a channel or a fact is missing, or a fact is impossible.
    """

    def __init__(self, servo: Servo, log: Log) -> None:
        self.servo, self.log = servo, log
        self._runs = [run_of(one, TIMESTEP, servo.duty_gain) for one in log.recordings]
        self.pendulums = [pendulum_of(one) for one in log.recordings]
        self._specs = {
            one: mujoco.MjSpec.from_string(pendulum_xml(servo, one))
            for one in dict.fromkeys(self.pendulums)
        }
        self._models: dict[Pendulum, mujoco.MjModel] = {
            one: spec.copy().compile() for one, spec in self._specs.items()
        }
        # The first model sets the bounds and the usual sizes of effects.
        self.model = self._models[self.pendulums[0]]
        self._data = mujoco.MjData(self.model)
        self.tolerance_names = OWN
        self._joined: dict[tuple[int, ...], Runs] = {}
        rows = np.array([recording.rows for recording in log.recordings])
        self.layout = Layout(
            np.repeat(np.arange(len(rows)), rows),
            np.concatenate([recording.time for recording in log.recordings]),
            np.zeros(rows.sum(), dtype=np.int64),
            (JOINT,),
            ("rad",),
        )
        self.noise = position_noise(log).deviation

    def candidates(self) -> list[Candidate]:
        """Return each effect that one commanded joint can show."""
        found = []
        for effect in searched("servo"):
            # `targets` misses some, as the firmware closes the loop, not MuJoCo.
            targets = effect.targets(self.model)
            if not targets and effect.on_command is not None:
                targets = (JOINT,)
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
        plant = self.plant(Hypothesis(), self.pendulums[recording])
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
        """Return the duty that the firmware requests when measured, (T, 1)."""
        log = self.log.recordings[recording]
        error = np.asarray(log.command) - np.asarray(log.position)
        on = enabled(log)[:, None]
        asked: Array = np.clip(self._runs[recording].gain * error, -1.0, 1.0) * on
        return asked

    def plant(self, hypothesis: Hypothesis, pendulum: Pendulum) -> Plant:
        """Return the kernel's parameters under a hypothesis, for one pendulum."""
        spec, nominal = self._specs[pendulum].copy(), self._models[pendulum]
        parts, _, effects = _split(hypothesis)
        apply_to_spec(spec, effects)
        forces = step_forces(nominal, effects)
        plant = plant_of(nominal, self._data, spec.compile(), forces)
        return tolerance_plant(plant, nominal, parts)

    def _measured(self, recordings: Sequence[int]) -> Array:
        rows = [np.asarray(self.log.recordings[i].position)[:, 0] for i in recordings]
        return np.concatenate(rows)

    def _simulate(self, hypothesis: Hypothesis, recordings: Sequence[int]) -> Array:
        """Return what the encoder would have read in the recordings' rows, (rows,)."""
        found: dict[int, Array] = {}
        for pendulum in self._specs:
            chosen = [i for i in recordings if self.pendulums[i] == pendulum]
            if chosen:
                rows = self._swing(hypothesis, pendulum, chosen)
                ends = np.cumsum([self.log.recordings[i].rows for i in chosen])
                found |= zip(chosen, np.split(rows, ends[:-1]), strict=True)
        return np.concatenate([found[i] for i in recordings])

    def _swing(
        self, hypothesis: Hypothesis, pendulum: Pendulum, recordings: Sequence[int]
    ) -> Array:
        """Return what the encoder would have read with one pendulum, (rows,)."""
        _, zero, effects = _split(hypothesis)
        runs = self._sent(recordings, effects)
        # The servo drives its encoder's reading to the goal.
        start = runs.start - [zero, 0.0]
        true = runs._replace(goal=runs.goal - zero, start=start)
        track = simulate(self.plant(hypothesis, pendulum), true, TIMESTEP)
        rows = at_rows(track, runs.place) + zero
        for applied in effects:
            reading = EFFECTS[applied.name].on_measurement
            if reading is not None:
                rows = reading(rows[:, None], 0, applied.values)[:, 0]
        return rows

    def _sent(
        self, recordings: Sequence[int], effects: Sequence[AppliedEffect]
    ) -> Runs:
        """Return the commands that the servo received, after effects on the command."""
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
                goal = effect.on_command(goal, 0, TIMESTEP, applied.values)
            if effect.on_start is not None:
                start[:, :1] = effect.on_start(start[:, :1], 0, applied.values)
        return run._replace(goal=np.ascontiguousarray(goal[:, 0]), start=start)


def _split(hypothesis: Hypothesis) -> tuple[Array, float, list[AppliedEffect]]:
    """Return the servo's own parameters, its zero [rad], and the other effects."""
    numbers = np.zeros(len(OWN) + 1)
    if hypothesis.spread:
        numbers[:-1] += hypothesis.spread
    for applied in hypothesis.effects:
        if applied.name == SERVO_NUMBERS:
            numbers += applied.values
    others = [one for one in hypothesis.effects if one.name != SERVO_NUMBERS]
    return numbers[:-1], float(numbers[-1]), others
