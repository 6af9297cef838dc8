"""What was known of a robot before a search, number by number, for reports."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from rlco.gap.calibrate.fit import Calibration
from rlco.gap.compare.problem import Hypothesis, Integers, Problem
from rlco.gap.compare.verdict import NamedEffect, Value
from rlco.gap.logs.log import Array
from rlco.gap.search.intervals import NORMAL
from rlco.physics.effects import EFFECTS, AppliedEffect

BEYOND = 1.96  # standard deviations of a prior that hold 95 % of it
_KNOWN = 0.5  # deviation that a number may have left to be told, in priors


@dataclass(frozen=True)
class Summary:
    """What is taken as known before a search, and what it does to the disagreement.

    Attributes:
        calibration: The numbers as fitted; None for demonstrations of a task, of which
            none are.
        effects: What is known, as effects on the model.
        channels: Names of the channels.
        units: Their units.
        nominal: Disagreement of the model as it is, root mean square, (channels,).
        calibrated: The same of the model with what is known.
        lacking: What a search named before, where nothing is calibrated.
    """

    calibration: Calibration | None
    effects: tuple[AppliedEffect, ...]
    channels: tuple[str, ...]
    units: tuple[str, ...]
    nominal: Array
    calibrated: Array
    lacking: tuple[NamedEffect, ...] = ()

    def rows(self, model: mujoco.MjModel) -> list[dict[str, object]]:
        """Return each fitted number, those furthest from the model first.

        Args:
            model: The model without the calibration, for units.
        """
        calibration = self.calibration
        if calibration is None:
            return []
        beyond, deviation = _beyond(calibration), calibration.deviation
        rows = []
        for i in np.argsort(-np.abs(calibration.amounts)):
            number, amount = calibration.numbers[i], float(calibration.amounts[i])
            ends = amount + NORMAL * deviation[i] * np.array([-1.0, 1.0])
            known = EFFECTS[number.name].parameters(model, number.target)
            unit = next(p.unit for p in known if p.name == number.parameter)
            rows.append(
                {
                    "name": number.name,
                    "target": number.target,
                    "parameter": number.parameter,
                    "value": number.value(amount),
                    "low": number.value(float(ends[0])),
                    "high": number.value(float(ends[1])),
                    "unit": unit,
                    "prior_deviations": amount,
                    "beyond_prior": bool(beyond[i]),
                }
            )
        return rows

    def named(self, model: mujoco.MjModel) -> tuple[NamedEffect, ...]:
        """Return the effects of which a number is beyond its prior's 95 %."""
        calibration = self.calibration
        if calibration is None:
            return ()
        beyond, deviation = _beyond(calibration), calibration.deviation
        found = []
        for effect in self.effects:
            mine = [
                i
                for i, number in enumerate(calibration.numbers)
                if (number.name, number.target) == (effect.name, effect.target)
            ]
            if not beyond[mine].any():
                continue
            known = EFFECTS[effect.name].parameters(model, effect.target)
            units = {parameter.name: parameter.unit for parameter in known}
            values = {}
            for i in mine:
                number, amount = calibration.numbers[i], float(calibration.amounts[i])
                away = NORMAL * float(deviation[i])
                values[number.parameter] = Value(
                    number.value(amount),
                    number.value(amount - away),
                    number.value(amount + away),
                    units[number.parameter],
                )
            found.append(
                NamedEffect(effect.name, effect.target, values, calibrated=True)
            )
        return tuple(found)


def _beyond(calibration: Calibration) -> Array:
    far = np.abs(calibration.amounts) > BEYOND
    return np.asarray(far & (calibration.deviation < _KNOWN))


@dataclass(frozen=True)
class Before:
    """What recordings made before say of those made later, of each channel.

    Attributes:
        explained: Part of the calibrated model's mean square that a regression over
            the motion predicts in seconds that it was not fitted to, (channels,).
        unknown: Standard deviation of what is not known in the later recordings,
            (channels,).
        after: Disagreement of the later recordings with all that is known, root mean
            square, (channels,).
        changed: The same with what changed, as named.
        recordings: How many there were before.
        seconds: How long [s].
    """

    explained: Array
    unknown: Array
    after: Array
    changed: Array
    recordings: int
    seconds: float


def sizes_of(problem: Problem, hypothesis: Hypothesis) -> Array:
    """Return the root mean square of a problem's residual in each channel."""
    layout = problem.layout
    residual = problem.residuals([hypothesis])[0]
    return sizes(residual, layout.channel, len(layout.channels))


def sizes(residual: Array, channel: Integers, channels: int) -> Array:
    """Return the root mean square of a residual in each channel, (channels,)."""
    squares = np.bincount(channel, weights=residual**2, minlength=channels)
    counts = np.maximum(np.bincount(channel, minlength=channels), 1)
    return np.asarray(np.sqrt(squares / counts))
