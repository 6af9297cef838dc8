"""What was known of a robot and what was found beside it, as one list of effects.

A calibration and a change may be of one number, such as a joint's friction, which
became less than it was and is still more than the model's. A file of effects lists it
once, from the model's value to the present one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.verdict import Verdict
from rlco.gap.logs.log import Array
from rlco.physics.effects import EFFECTS, AppliedEffect, Parameter


def combined(
    known: Sequence[AppliedEffect], verdict: Verdict, model: mujoco.MjModel
) -> Verdict:
    """Return a verdict whose effects hold what was known before, too.

    Args:
        known: What was known; the verdict was found beside it.
        verdict: The verdict.
        model: The model without either.
    """
    before = {(one.name, one.target): one for one in known}
    found: list[AppliedEffect] = []
    joined: set[tuple[str, str | None]] = set()
    for effect in verdict.hypothesis.effects:
        place = effect.name, effect.target
        parameters = EFFECTS[effect.name].parameters(model, effect.target)
        if place not in before or any(p.present is None for p in parameters):
            found.append(effect)
            continue
        joined.add(place)
        values = _together(parameters, before[place].values, effect.values)
        numbers = zip(effect.parameters, values, strict=True)
        found.append(replace(effect, parameters={k: float(v) for k, v in numbers}))
    others = [one for place, one in before.items() if place not in joined]
    sample = verdict.sample
    if sample is not None:
        sample, first = np.array(sample, dtype=float), 0
        for named in verdict.effects:
            parameters = EFFECTS[named.name].parameters(model, named.target)
            columns = slice(first, first + len(parameters))
            first += len(parameters)
            if (place := (named.name, named.target)) in joined:
                sample[:, columns] = _together(
                    parameters, before[place].values, sample[:, columns]
                )
    effects = Hypothesis((*others, *found))
    return replace(verdict, hypothesis=effects, sample=sample)


def _together(parameters: Sequence[Parameter], known: Array, found: Array) -> Array:
    """Return values of parameters, (..., parameters), as one change of the model."""
    factors = [
        one.present is not None and bool(one.present.multiplied) for one in parameters
    ]
    neutral = np.array([one.neutral for one in parameters])
    return np.asarray(np.where(factors, known * found, known + found - neutral))
