"""What a search on a servo's bench found, in words and numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy.stats import t

from rlco.errors import DataError
from rlco.gap.compare.problem import Candidate, Hypothesis
from rlco.gap.compare.servo.independent_channel import supply_sag
from rlco.gap.compare.servo.plant import fitted_servo
from rlco.gap.compare.verdict import (
    Gap,
    HeldOut,
    HeldOutGroup,
    NamedEffect,
    Value,
    Verdict,
)
from rlco.gap.compare.wording import amount
from rlco.gap.logs.log import Array
from rlco.gap.search.intervals import COVERED
from rlco.gap.search.judge import ENOUGH, NEAR_FLOOR
from rlco.gap.search.servo.ladder import Effects, Judged, fit_all, without_own_numbers
from rlco.gap.search.servo.state import ServoState, better
from rlco.gap.search.verdict import DOUBT as IN_DOUBT
from rlco.physics.effects import AppliedEffect, Parameter

CLOSEST = 5  # single effects in the report where none is named


def conclude(state: ServoState, *, complete: bool, seconds: float) -> Verdict:
    """Return what a search found, in words and numbers.

    Args:
        state: The last state.
        complete: False where the search was interrupted.
        seconds: How long it took.
    """
    problem, none = state.ladder.problem, state.none
    floor = float(problem.noise[0])
    before, after = none.rms, state.best.rms
    kind = _kind(state, before, after, floor)
    best = state.best if kind in ("named", "ambiguous") else none
    fits = {one.effects: fit_all(state.ladder, one) for one in (none, best)}
    trained = [_trained(state, fits[one.effects].effects) for one in (none, best)]
    fitted = fits[best.effects].effects
    held_out = _held_out(state, best)
    effects = _named_effects(state, best, fitted) if best.effects else ()
    every = tuple(range(len(problem.log.recordings)))
    return Verdict(
        complete=complete,
        verdict=kind,
        effects=effects,
        gap=Gap("rad", trained[0], before, trained[1], best.rms, floor),
        unexplained=_unexplained(best, held_out, before, floor),
        closest=() if effects else _closest(state),
        seconds=seconds,
        hypothesis=Hypothesis(fitted),
        train=every,
        heldout=every,
        trail=tuple(_row(state, one) for one in state.known.values()),
        held_out=held_out,
        remarks=(*_of_volts(state, best), _of_own_numbers(state, fitted)),
    )


def half_widths(values: Array) -> Array:
    """Return half the width of each number's interval, (numbers,).

    The jackknife that leaves out a group (Efron and Stein 1981), with the quantile of
    Student's t for so few groups: the same numbers, fitted without each of them.

    Args:
        values: Numbers as fitted with each group held out, (groups, numbers).

    Example:
        >>> half_widths(np.array([[1.0], [3.0]])).round(3)  # 6.314 of sqrt(1/2 * 2)
        array([6.314])
    """
    groups = len(values)
    squares = ((values - values.mean(axis=0)) ** 2).sum(axis=0)
    deviation = np.sqrt((groups - 1) / groups * squares)
    return np.asarray(t.ppf((1.0 + COVERED) / 2.0, groups - 1) * deviation)


def _kind(state: ServoState, before: float, after: float, floor: float) -> str:
    if not state.best.effects:
        return "unexplained" if before > NEAR_FLOOR * floor else "no_gap"
    share = max(after**2 - floor**2, 0.0) / max(before**2 - floor**2, 1e-30)
    if share > 1.0 - ENOUGH and after > NEAR_FLOOR * floor:
        return "unexplained"
    rivals = any(_rivals(state, one) for one in state.best.effects)
    return "ambiguous" if rivals else "named"


def _rivals(state: ServoState, effect: Candidate) -> tuple[Candidate, ...]:
    """Return which others may stand in the place of an effect, the best first."""
    others = sorted(state.others.get(effect, ()), key=lambda one: one.error)
    return tuple(
        one.effects[-1] for one in others if not better(state.ladder, state.best, one)
    )


def _named_effects(
    state: ServoState, best: Judged, fitted: Effects
) -> tuple[NamedEffect, ...]:
    named = []
    for place, effect in enumerate(without_own_numbers(fitted)):
        candidate = Candidate(effect.name, effect.target)
        held = np.array([without_own_numbers(fit)[place].values for fit in best.fits])
        known = state.ladder.library[candidate]
        others = sorted(state.others.get(candidate, ()), key=lambda one: one.error)
        named.append(
            NamedEffect(
                effect.name,
                effect.target,
                _values(effect, known, half_widths(held)),
                _rivals(state, candidate),
                {
                    f"{one.effects[-1].name} {one.effects[-1].target}": (
                        one.error / best.error - 1.0
                    )
                    for one in others
                },
            )
        )
    return tuple(named)


def _values(
    effect: AppliedEffect, known: tuple[Parameter, ...], widths: Array
) -> dict[str, Value]:
    return {
        one.name: Value(
            number,
            max(one.low, number - width),
            min(one.high, number + width),
            one.unit,
        )
        for one, number, width in zip(
            known, map(float, effect.values), map(float, widths), strict=True
        )
    }


def _held_out(state: ServoState, best: Judged) -> HeldOut:
    problem, none = state.ladder.problem, state.none
    groups = []
    for index, group in enumerate(state.ladder.groups):
        rows = problem.residuals([Hypothesis()], group.heldout)[0]
        groups.append(
            HeldOutGroup(
                group.label,
                group.heldout,
                float(np.abs(rows).mean()),
                float(none.errors[index]),
                float(best.errors[index]),
                Hypothesis(none.fits[index]),
                Hypothesis(best.fits[index]),
            )
        )
    return HeldOut("rad", none.parameters, best.parameters, tuple(groups))


def _unexplained(
    best: Judged, held_out: HeldOut, before: float, floor: float
) -> Mapping[str, object]:
    after = best.rms
    if after < NEAR_FLOOR * floor:
        note = "nothing beyond the noise"
        return {"share": 0.0, "target": None, "note": note}
    share = (after**2 - floor**2) / max(before**2 - floor**2, 1e-30)
    worst = max(held_out.groups, key=lambda group: group.after)
    note = f"it is largest at {worst.label}, {amount(worst.after, 'rad')} on average"
    if best.effects:
        note += f"; {IN_DOUBT}"
    return {"share": min(share, 1.0), "target": "servo", "note": note}


def _closest(state: ServoState) -> tuple[tuple[Candidate, float], ...]:
    """Return the single effects that come nearest, with the share each explains."""
    singles = [one for one in state.known.values() if len(one.effects) == 1]
    before = float(np.mean(state.none.residual**2))
    shares = [
        (one.effects[0], max(0.0, 1.0 - float(np.mean(one.residual**2)) / before))
        for one in singles
    ]
    return tuple(sorted(shares, key=lambda pair: -pair[1])[:CLOSEST])


def _row(state: ServoState, one: Judged) -> Mapping[str, object]:
    errors = zip(state.ladder.groups, one.errors, strict=True)
    return {
        "effects": one.effects,
        "numbers": one.parameters,
        "held-out error [mrad]": round(1e3 * one.error, 1),
        **{group.label: round(1e3 * float(error), 1) for group, error in errors},
        "taken": one.effects in state.path or not one.effects,
    }


def _of_own_numbers(state: ServoState, fitted: Effects) -> str:
    """Say what the servo's own numbers are, as published and as fitted."""
    servo = state.ladder.problem.servo
    own, zero = fitted_servo(servo, fitted)
    changes = [
        f"{word} {getattr(servo, name):.3g} -> {getattr(own, name):.3g} {unit}"
        for name, word, unit in (
            ("torque_constant", "torque constant", "N m/A"),
            ("resistance", "resistance", "ohm"),
            ("armature", "armature", "kg m^2"),
            ("damping", "damping", "N m s/rad"),
            ("frictionloss", "friction", "N m"),
        )
    ]
    return (
        f"The servo's own numbers, as published and as fitted here: "
        f"{', '.join(changes)}; its encoder's zero is at {1e3 * zero:.3g} mrad."
    )


def _of_volts(state: ServoState, best: Judged) -> tuple[str, ...]:
    """Return what another channel says of a loss in the drive, if it was logged."""
    rivals = {
        rival.name for one in best.effects for rival in (one, *_rivals(state, one))
    }
    if "drive_loss" not in rivals:
        return ()
    lossy = [
        one
        for one in state.known.values()
        if len(one.effects) == len(best.effects)
        and any(effect.name == "drive_loss" for effect in one.effects)
    ]
    loss = min(lossy, key=lambda one: one.error)
    try:
        sag = supply_sag(state.ladder.problem, Hypothesis(loss.fits[-1]))
    except DataError:
        return ()  # no volts were logged, which is no fault of the log
    words = str(sag)
    return (f"{words[0].upper()}{words[1:]}.",)


def _trained(state: ServoState, effects: Effects) -> float:
    residual = state.ladder.problem.residuals([Hypothesis(effects)])[0]
    return math.sqrt(float(np.mean(residual**2)))
