"""The verdict of a finished search. Nothing is fitted or simulated here."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from rlco.gap.compare.problem import Candidate, Hypothesis
from rlco.gap.compare.verdict import NamedEffect, Value, Verdict
from rlco.gap.logs.log import Array
from rlco.gap.search.judge import (
    LOUD,
    NAMED,
    NEAR_FLOOR,
    QUIET,
    found,
    is_noise,
    kind,
    reached_bounds,
    residual_share,
)
from rlco.gap.search.posterior import sample
from rlco.gap.search.state import Residual, Rivals, State
from rlco.physics.effects.actuator import TORQUE_BIAS
from rlco.physics.effects.friction import COULOMB_FRICTION, DIRECTIONAL_FRICTION

CLOSEST = 5  # effects that are reported where none is named
DOUBT = "more is missing than what is named, or something else"
NOTHING_SEARCHED = "Nothing was searched: interrupted before any effect was fitted."


def conclude(state: State, *, complete: bool = True, seconds: float = 0.0) -> Verdict:
    """Return the verdict of a search.

    Args:
        state: The last state, after the steps `intervals` and `residual`.
        complete: False where the search was interrupted.
        seconds: Duration of the search [s].

    Raises:
        ValueError: One of these steps is missing.
    """
    if state.residual is None:
        raise ValueError("the state lacks its residual: take the steps that close it")
    named = kind(state) in NAMED
    effects = _named_effects(state) if named else ()
    closest = () if named else _closest(state)
    unexplained = _unexplained(state, state.residual)
    if not (complete or effects or closest or state.trail):
        # A share of 1 would suggest that the whole library had been tried in vain.
        note = f"{NOTHING_SEARCHED} {unexplained['note']}".rstrip()
        unexplained = {**unexplained, "note": note}
    return Verdict(
        complete=complete,
        verdict=kind(state),
        effects=effects,
        gap=state.residual.gap,
        unexplained=unexplained,
        closest=closest,
        seconds=seconds,
        hypothesis=Hypothesis(found(state).effects),
        train=state.setting.train,
        heldout=state.setting.heldout,
        trail=state.trail,
        remarks=(*_by_direction(state), *_late_commands(state)) if named else (),
        free_form=state.free_form,
        sample=_sample(state) if named else None,
    )


def _unexplained(state: State, residual: Residual) -> Mapping[str, object]:
    """Describe the held-out residual, and whether model tolerance may explain it."""
    setting, best, named = state.setting, found(state), kind(state)
    if state.as_it_is is not None:
        return _beside_outside(residual)
    after = setting.heldout_error(best)
    calibrated = setting.problem.calibration
    tolerance = (
        f"parameters that are about {np.max(setting.prior, initial=0.0):.0%} off"
        if calibrated is None
        else calibrated.words
    )
    if is_noise(state):
        note = "nothing beyond the noise"
        if named in QUIET and after > NEAR_FLOOR:
            note = f"nothing beyond what the noise and {tolerance} would leave"
        elif best.effects and not len(setting.prior):
            note += ", if every other parameter of the model is exact"
        return {"share": 0.0, "target": None, "note": note}
    before = max(setting.heldout_error(state.none) ** 2 - 1.0, 1e-9)
    share = min(max(after**2 - 1.0, 0.0) / before, 1.0) if best.effects else 1.0
    note = residual.note
    if best.error < NEAR_FLOOR:
        note = f"{note}; {tolerance} would leave as much"
    elif best.effects and after > LOUD:
        note = f"{note}; {DOUBT}"
    elif not best.effects:
        note = "; ".join((note, *_at_bounds(state)))
    return {"share": share, "target": residual.target, "note": note}


def _at_bounds(state: State) -> list[str]:
    """Say which effects are not named because no value that is searched suffices."""
    sentences = []
    for effect, parameter in reached_bounds(state.setting.library, state.best.effects):
        value = effect.parameters[parameter.name]
        size = f"{value:.3g} {parameter.unit}".strip()
        most = "most" if value > parameter.neutral else "least"
        place = f"{effect.name} {effect.target or ''}".strip()
        sentences.append(
            f"{place} is not named: its {parameter.name} reached {size}, the {most} "
            "that is searched"
        )
    return sentences


def _beside_outside(residual: Residual) -> Mapping[str, object]:
    """Describe what remains where a joint has a torque that no effect describes."""
    gap = residual.gap
    noise = gap.noise_floor**2
    before, after = gap.before_heldout**2 - noise, gap.after_heldout**2 - noise
    share = min(max(after, 0.0) / max(before, 1e-300), 1.0)
    return {"share": share, "target": residual.target, "note": residual.note}


def _named_effects(state: State) -> tuple[NamedEffect, ...]:
    effects = state.best.effects
    widths = iter(state.widths)
    rivals = state.rivals or (Rivals((), {}),) * len(effects)
    named = []
    for effect, others in zip(effects, rivals, strict=True):
        known = state.setting.library[Candidate(effect.name, effect.target)]
        values = {}
        for parameter, number in zip(known, effect.values, strict=True):
            width = next(widths)
            low = max(parameter.low, number - width)
            high = min(parameter.high, number + width)
            values[parameter.name] = Value(number, low, high, parameter.unit)
        named.append(
            NamedEffect(
                effect.name, effect.target, values, others.as_good, others.evidence
            )
        )
    return tuple(named)


def _by_direction(state: State) -> tuple[str, ...]:
    """Say which frictions are as well one that depends on the direction of motion."""
    at = {(e.name, e.target): float(e.values[0]) for e in state.best.effects}
    remarks = []
    for (name, joint), bias in at.items():
        friction = at.get((COULOMB_FRICTION.name, joint), 0.0)
        if name != TORQUE_BIAS.name or abs(bias) > friction:
            continue
        forward, backward = friction - bias, friction + bias
        remarks.append(
            f"The two torques at {joint} are as well one friction that depends on the "
            f"direction of motion: {forward:.3g} forwards and {backward:.3g} backwards "
            f"({DIRECTIONAL_FRICTION.name}); no recording tells the two apart."
        )
    return tuple(remarks)


def _late_commands(state: State) -> tuple[str, ...]:
    """Say what a gap after is of, where each command has a time of its own."""
    if state.lateness is None:
        return ()
    return (
        "The gap after is with each command at the time that is estimated for it from "
        "the motion. In figures all of them are late by the mean.",
    )


def _sample(state: State) -> Array | None:
    """Return parameter sets from the intervals, with their correlations."""
    if state.correlation is None:
        return None
    effects = state.best.effects
    known = [
        parameter
        for effect in effects
        for parameter in state.setting.library[Candidate(effect.name, effect.target)]
    ]
    values = np.concatenate([effect.values for effect in effects])
    return sample(known, values, np.array(state.widths), state.correlation)


def _closest(state: State) -> tuple[tuple[Candidate, float], ...]:
    """Return the single effects that come nearest, with the share each explains."""
    singles = [one for one in state.scores.values() if len(one.effects) == 1]
    singles.sort(key=lambda one: one.fit.cost)
    shares = {
        next(iter(one.names)): 1.0 - residual_share(state.none, one) for one in singles
    }
    if not state.plain:
        return tuple(shares.items())[:CLOSEST]
    for one, share in state.plain.items():
        shares[one] = max(share, shares.get(one, 0.0))
    best = sorted(shares.items(), key=lambda pair: -pair[1])
    return tuple(best[:CLOSEST])
