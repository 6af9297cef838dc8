"""From a finished search to what is said: names, rivals, intervals, what is left."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from rlco.gap.fit import candidates_of, fit, linearise
from rlco.gap.intervals import NORMAL, half_widths
from rlco.gap.left_over import describe_left
from rlco.gap.log import Array
from rlco.gap.probe import probe, start_of
from rlco.gap.problem import Candidate, Finding, Gap, Hypothesis, Value, Verdict
from rlco.gap.search import (
    BETTER,
    NEAR_FLOOR,
    at_bounds,
    first_look,
    ranked,
    refined,
)
from rlco.gap.search_start import spread_beside
from rlco.gap.search_state import Scored, Search
from rlco.physics.effects import EFFECTS, AppliedEffect

QUIET = ("no_gap", "no_improvement", "not_identifiable")
ENOUGH = 0.5  # share of the gap that effects must explain to be named
HOPELESS = 10.0  # times the best cost, after two steps
SENSITIVE = 3.0  # times, in squares, that effects may enlarge what the spread does
LOUD = 3.0  # times the noise floor, that no spread explains either
DOUBT = "something more is missing, or something else than what is named"
RIVALS = 5  # others that are tried in the place of each named effect


def conclude(search: Search, seconds: float, complete: bool) -> Verdict:
    """Return the verdict of a search.

    Args:
        search: The search, with its best set of effects.
        seconds: How long it took.
        complete: False where it was interrupted.
    """
    best, none = search.best, search.scores[frozenset()]
    if best is None:
        best = none
    rivals: list[tuple[tuple[Candidate, ...], dict[str, float]]] = []
    if best.effects and complete:
        best, rivals = find_rivals(search, best)
        within = _within_bounds(search, best)
        if within is not best:
            best, rivals = find_rivals(search, within)
    kind = _kind(search, none, best, rivals)
    named = kind in ("named", "ambiguous")
    found = best if named else none
    effects = _findings(search, best, rivals) if named else ()
    gap = _gap(search, found)
    return Verdict(
        complete=complete,
        verdict=kind,
        effects=effects,
        gap=gap,
        unexplained=_unexplained(search, kind, found),
        closest=() if named else _closest(search, none),
        seconds=seconds,
        hypothesis=Hypothesis(found.effects),
        train=search.train,
        heldout=search.heldout,
        trail=tuple(search.trail),
    )


def _unexplained(search: Search, kind: str, found: Scored) -> Mapping[str, object]:
    """Say what is left in held-out recordings, and whether it may be the spread."""
    after, likely = search.heldout_error(found), found.error < NEAR_FLOOR
    spread = f"numbers that are about {np.max(search.prior, initial=0.0):.0%} off"
    if kind in QUIET and after > NEAR_FLOOR:
        note = f"nothing beyond what the noise and {spread} would leave"
        return {"share": 0.0, "target": None, "note": note}
    if kind in QUIET or (likely and after < NEAR_FLOOR):
        note = "nothing beyond the noise"
        if found.effects and not len(search.prior):
            note += ", where every other number of the model is taken to be right"
        return {"share": 0.0, "target": None, "note": note}
    before = max(search.heldout_error(search.scores[frozenset()]) ** 2 - 1.0, 1e-9)
    share = min(max(after**2 - 1.0, 0.0) / before, 1.0) if found.effects else 1.0
    told = dict(describe_left(search.problem, found.effects, share))
    if likely:
        told["note"] = f"{told['note']}; {spread} would leave as much"
    elif found.effects and after > LOUD:
        told["note"] = f"{told['note']}; {DOUBT}"
    return told


def left_share(none: Scored, best: Scored) -> float:
    """Return the share of the gap above the noise that a set of effects leaves."""
    before = max(float(np.mean(none.everything**2)) - 1.0, 1e-9)
    after = max(float(np.mean(best.everything**2)) - 1.0, 0.0)
    return min(after / before, 1.0)


def _kind(
    search: Search,
    none: Scored,
    best: Scored,
    rivals: list[tuple[tuple[Candidate, ...], dict[str, float]]],
) -> str:
    if best.effects and _holds(search, none, best):
        return "ambiguous" if any(names for names, _ in rivals) else "named"
    if best.effects:
        return "unexplained" if none.error > NEAR_FLOOR else "no_gap"
    # A gap of the fitted recordings alone weighs on the others by the spread.
    if none.error > NEAR_FLOOR and search.heldout_error(none) > NEAR_FLOOR:
        return "unexplained"
    if not search.visible:
        return "not_identifiable"
    others = [one for one in search.scores.values() if one.effects]
    trained = min((one.fit.cost for one in others), default=np.inf)
    better = trained < (1.0 - BETTER) ** 2 * float(np.mean(none.fit.residual**2))
    return "no_improvement" if better else "no_gap"


def _holds(search: Search, none: Scored, best: Scored) -> bool:
    """Return whether effects explain most of the gap, and help without any spread."""
    if left_share(none, best) > 1.0 - ENOUGH and best.error > NEAR_FLOOR:
        return False
    before, after = search.heldout_error(none), search.heldout_error(best)
    return not at_bounds(search, best) and after < (1.0 - BETTER) * before


def find_rivals(
    search: Search, best: Scored
) -> tuple[Scored, list[tuple[tuple[Candidate, ...], dict[str, float]]]]:
    """Try others in the place of each named effect.

    Returns:
        The best set (another, should one of the others do better), and for each of its
        effects the rivals that do as well, with how much worse each is, held out.
    """
    for _ in range(3):
        options = [
            one
            for place in range(len(best.effects))
            for one in _others(search, best, place)
        ]
        winner = min(options, key=lambda one: one.fit.cost, default=best)
        if not (winner.fit.cost < best.fit.cost and search.better(winner, best)):
            break
        best = search.best = winner
    rivals = []
    for effect in best.effects:
        own = Candidate(effect.name, effect.target)
        rest = best.names - {own}
        names, evidence = [], {}
        for one in search.scores.values():
            other = one.names - rest
            if one.names == best.names or len(other) != 1 or not rest <= one.names:
                continue
            (candidate,) = other
            worse = one.error / best.error - 1.0
            evidence[f"{candidate.name} {candidate.target or ''}".strip()] = worse
            if is_rival(search, best, one):
                names.append((one.fit.cost, candidate))
        names.sort(key=lambda pair: pair[0])
        near = dict(sorted(evidence.items(), key=lambda item: item[1])[:RIVALS])
        rivals.append((tuple(candidate for _, candidate in names), near))
    return best, rivals


def _within_bounds(search: Search, best: Scored) -> Scored:
    """Return what does as well with no number at its bounds, where there is such."""
    if not at_bounds(search, best):
        return best
    likely = [
        one
        for one in search.scores.values()
        if 0 < len(one.effects) <= len(best.effects)
        and is_rival(search, best, one)
        and not at_bounds(search, one)
    ]
    return min(likely, key=lambda one: one.fit.cost, default=best)


def is_rival(search: Search, best: Scored, one: Scored) -> bool:
    """Return whether another set explains the data as well, as far as can be told.

    Where both leave more than noise, neither is the truth, and a small difference
    between them means less.
    """
    near = one.error < 1.03 * best.error and best.error > NEAR_FLOOR
    return near or not search.better(best, one)


def _others(search: Search, best: Scored, place: int) -> list[Scored]:
    """Fit the most telling others in the place of one effect."""
    out = best.effects[place]
    rest = tuple(effect for effect in best.effects if effect is not out)
    look = first_look(search)
    known = search.scores.get(frozenset(candidates_of(rest)))
    kept = known.effects if known else fit(look.library, [rest], look.weigh)[0].effects
    at = linearise(look.library, kept, look.weigh)
    names = frozenset(candidates_of(kept))
    likely = [
        candidate
        for candidate in search.library
        if candidate not in best.names
        and (
            candidate.target == out.target
            or candidate.name in EFFECTS[out.name].confused_with
            or candidate.target is None
        )
    ]
    fresh = [c for c in likely if frozenset((*names, c)) not in search.scores]
    seen = {one.candidate for one in search.probes}
    unseen = [c for c in fresh if c not in seen]
    search.probes += probe(look.library, unseen, kept, at.residual, look.weigh)
    probes = [one for one in search.probes if one.candidate in fresh]
    once = [
        (*kept, effect)
        for candidate, effect in _once_as_good(search, out, best.names)
        if candidate in fresh
    ]
    starts: dict[Candidate, tuple[AppliedEffect, ...]] = {}
    for one in ranked(probes, at):
        start = start_of(search.library, one, at.residual)
        starts.setdefault(one.candidate, kept + start)
    (rows,) = look.weigh([best.effects])
    most = HOPELESS * float(np.mean(rows**2))
    return refined(search, look, once + list(starts.values())[:RIVALS], at, most)


def _once_as_good(
    search: Search, out: AppliedEffect, names: frozenset[Candidate]
) -> Iterator[tuple[Candidate, AppliedEffect]]:
    """Yield others that did as well as an effect beside fewer of the named ones.

    A first look, from afar, would rank some of them low.
    """
    own = Candidate(out.name, out.target)
    for one in search.scores.values():
        for other, effect in zip(candidates_of(one.effects), one.effects, strict=True):
            beside = one.names - {other}
            before = search.scores.get(beside | {own})
            if other in names or not beside <= names - {own} or before is None:
                continue
            if is_rival(search, before, one):
                yield other, effect


def _findings(
    search: Search,
    best: Scored,
    rivals: list[tuple[tuple[Candidate, ...], dict[str, float]]],
) -> tuple[Finding, ...]:
    widths = _widths(search, best)
    found, at = [], 0
    for i, effect in enumerate(best.effects):
        known = search.library[Candidate(effect.name, effect.target)]
        values = {}
        for parameter, number in zip(known, effect.values, strict=True):
            width = float(widths[at])
            at += 1
            low = max(parameter.low, number - width)
            high = min(parameter.high, number + width)
            values[parameter.name] = Value(number, low, high, parameter.unit)
        names, evidence = rivals[i] if rivals else ((), {})
        found.append(Finding(effect.name, effect.target, values, names, evidence))
    return tuple(found)


def _widths(search: Search, best: Scored) -> Array:
    """Half widths of all numbers, from differences at the best numbers."""
    known = [
        parameter
        for effect in best.effects
        for parameter in search.library[Candidate(effect.name, effect.target)]
    ]
    # What jumps has no slope: its interval is the jump.
    widths = np.array([parameter.resolution for parameter in known])
    smooth = widths == 0.0
    if smooth.any():
        once = replace(search, weighting=spread_beside(search, best.effects))
        here = linearise(search.library, best.effects, search.weigh)
        free = linearise(search.library, best.effects, once.weigh)
        rows = search.blocks[: len(here.residual)]
        widths[smooth] = half_widths(
            here.jacobian[smooth], here.residual, rows, free.jacobian[smooth]
        )
    if search.sensitivity > SENSITIVE:
        # Differences are no guide there: a limit is told in units of the arm's weight.
        values = np.concatenate([effect.values for effect in best.effects])
        # Half a factor is half a change; half a limit is half of what moves the arm.
        away = [parameter.neutral if parameter.scales else 0.0 for parameter in known]
        least = NORMAL * np.max(search.prior, initial=0.0) * np.abs(values - away)
        widths[smooth] = np.maximum(widths, least)[smooth]
    return widths


def _gap(search: Search, found: Scored) -> Gap:
    def rms(effects: tuple[AppliedEffect, ...], recordings: tuple[int, ...]) -> float:
        rows = search.residuals([effects], recordings)
        return float(np.sqrt(np.mean(rows**2)))

    floor = search.problem.noise[search.problem.layout.channel]
    units = search.problem.layout.units
    return Gap(
        units[0] if len(set(units)) == 1 else "mixed",
        rms((), search.train),
        rms((), search.heldout),
        rms(found.effects, search.train),
        rms(found.effects, search.heldout),
        float(np.sqrt(np.mean(floor**2))),
    )


def _closest(search: Search, none: Scored) -> tuple[tuple[Candidate, float], ...]:
    """The single effects that come nearest, with the share each would explain."""
    singles = [one for one in search.scores.values() if len(one.effects) == 1]
    singles.sort(key=lambda one: one.fit.cost)
    return tuple(
        (next(iter(one.names)), 1.0 - left_share(none, one)) for one in singles[:5]
    )
