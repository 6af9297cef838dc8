"""The search for missing effects: forward, swap and backward steps over rollouts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from rlco.gap.comparison import block_sums
from rlco.gap.fit import Fit, candidates_of, fit, linearise, usual_size
from rlco.gap.log import Array
from rlco.gap.probe import Probe, explained, probe, start_of
from rlco.gap.problem import Candidate
from rlco.gap.search_jumps import best_values, better_start, elsewhere, jumps
from rlco.gap.search_start import with_most_left, with_spread_at
from rlco.gap.search_state import Scored, Search
from rlco.gap.weighting import Weighting
from rlco.physics.effects import AppliedEffect

LARGEST = 4  # effects at once
NEAR_FLOOR = 1.3  # error over the noise floor; beyond it something is missing
FITTED = 6  # candidates that are fitted in a forward step
SEEN = 0.05  # mean square beyond the spread that an effect changes by itself
CLEAN = 1.1  # mean square, over the typical, of a joint that needs no effect
LOOKED_AGAIN = 24  # candidates of a first look beside effects
FITTABLE = 0.985  # part of the mean square that two steps must not leave
HINT = 0.015  # part of the mean square that a first look must explain
BETTER = 0.03  # part of the held-out error that an effect must take away
WORTH_BOUNDS = 0.1  # the same where a number ran to its bounds: all others are in doubt


def search_effects(search: Search) -> Scored:
    """Add, swap and drop effects until none of these clearly helps.

    Returns:
        The best set; `search.best` is it too, at any time, for an interruption.
    """
    best = search.best = search.scores[frozenset()]
    while len(best.effects) < LARGEST:
        look = first_look(search)
        at = linearise(look.library, best.effects, look.weigh)
        candidates = _worth_a_look(search, best, at)
        done = len(best.effects) / LARGEST
        search.on_step(f"looking at {len(candidates)} effects", done)
        probes = probe(look.library, candidates, best.effects, at.residual, look.weigh)
        known = {one.candidate for one in probes}
        search.probes = [p for p in search.probes if p.candidate not in known] + probes
        if not best.effects:
            sizes = [float(np.mean(one.first**2)) for one in probes]
            search.visible = sum(size > 1.0 for size in sizes) > 0.2 * len(sizes)
        starts = starts_beside(search, probes, at)
        if at.cost > NEAR_FLOOR**2:
            starts = _tried_values(look, starts, at)
        options = refined(search, look, starts, at, FITTABLE * at.cost)
        swaps = _swaps(search, look, probes, options[:2])
        options += refined(search, look, swaps)
        found = _pick(search, options, best)
        if found is None:
            # Perhaps what is missing shows in other recordings.
            others = tuple(sorted(with_most_left(search, best.fit.residual)))
            if best.error < NEAR_FLOOR or others == search.looked_at:
                break
            search.looked_at = others
            search.probes.clear()
            continue
        best = _drop(search, polished(search, found))
        best = search.best = with_spread_at(search, best)
        search.on_step(_sentence(best), len(best.effects) / LARGEST)
    best = search.best = _without_unseen(search, best)
    return best


def _without_unseen(search: Search, best: Scored) -> Scored:
    """Drop effects that could not be told from the spread but for the others.

    A robot on the brink shows numbers that are a hundredth off as if they were news.
    Where a number ran to its bounds all of them are in doubt, and are left as they are.
    """
    while len(best.effects) > 1 and not at_bounds(search, best):
        lists = [(), *((effect,) for effect in best.effects)]
        parts = [search.residuals(lists, p) for p in (search.train, search.heldout)]
        rows = np.hstack(parts)
        if not np.isfinite(rows).all():
            return best
        weighted = search.at_first.weigh(rows)
        seen = np.mean((weighted[1:] - weighted[0]) ** 2, axis=1)
        least = int(seen.argmin())
        if seen[least] > SEEN:
            return best
        left = best.effects[least]
        fits = search.fit([tuple(e for e in best.effects if e is not left)])
        if not fits:
            return best
        best = fits[0]
        search.trail.append({"effects": best.effects, "dropped": True})
    return best


def at_bounds(search: Search, best: Scored) -> bool:
    """Return whether a number went as far as it may: something else was meant."""
    for effect in best.effects:
        known = search.library[Candidate(effect.name, effect.target)]
        for parameter, value in zip(known, effect.values, strict=True):
            # A limit of torque may be anything up to a hundred times what is there.
            near = 1e-3 * min(parameter.high - parameter.low, usual_size(parameter))
            away = abs(value - parameter.neutral) > near
            low, high = value - parameter.low < near, parameter.high - value < near
            if away and (low or high):
                return True
    return False


def first_look(search: Search) -> Search:
    """Return a search over some of the training recordings, for a first look."""
    return look_at(search, search.looked_at)


def look_at(search: Search, some: tuple[int, ...]) -> Search:
    """Return a search over some of the recordings."""
    layout = search.problem.layout
    near = np.isin(layout.recording, some)
    scale = search.problem.noise[layout.channel][near]
    moved, rows = search.moved[:, near], len(layout.recording)
    outliers = search.outliers and search.outliers.part(near)
    weighting = Weighting.of(scale, moved, search.prior, rows, outliers)
    return replace(search, train=some, weighting=weighting)


def _worth_a_look(search: Search, best: Scored, at: Fit) -> list[Candidate]:
    """Candidates that may explain something of what is left, in the library's order.

    Whatever an effect of a joint does to others, it does more to that joint. And what
    an effect changes hardly depends on the others: those that told nothing where one
    effect fewer acted tell nothing now.
    """
    fresh = [c for c in search.library if c not in best.names]
    if not best.effects:
        return fresh
    layout = search.problem.layout
    near = np.isin(layout.recording, search.train)
    sizes = block_sums(best.fit.residual**2, layout.channel[near])
    sizes /= np.bincount(layout.channel[near])
    clean = CLEAN * min(1.0, float(np.median(sizes)))
    done = {layout.channels[i] for i in np.flatnonzero(sizes < clean)}
    found = [c for c in fresh if c.target not in done]
    seen = {one.candidate for one in search.probes}
    telling = dict.fromkeys(one.candidate for one in ranked(search.probes, at))
    again = set(list(telling)[:LOOKED_AGAIN])
    return [c for c in found if c in again or c not in seen]


def refined(
    search: Search,
    look: Search,
    starts: list[tuple[AppliedEffect, ...]],
    at: Fit | None = None,
    most: float = np.inf,
) -> list[Scored]:
    """Fit a little from each start to some recordings, and on where that went best.

    Args:
        search: The search.
        look: The same with fewer recordings, for the first steps.
        starts: Effects with the numbers to start from.
        at: A fit of the first look's recordings with the first effects of each start.
        most: Cost of the first steps from which it is not worth going on.
    """
    rough = fit(look.library, starts, look.weigh, steps=2, near=at)
    best: dict[frozenset[Candidate], Fit] = {}
    for one in sorted(rough, key=lambda one: one.cost):
        best.setdefault(frozenset(candidates_of(one.effects)), one)
    ranking = list(best.values())
    near = [one for one in ranking if one.cost < min(2.0 * ranking[0].cost, most)][:4]
    return search.fit([one.effects for one in near], steps=5)


def polished(search: Search, found: Scored) -> Scored:
    """Fit to the end: what a half-way fit leaves looks like one more effect."""
    starts = [found.effects]
    if found.error > NEAR_FLOOR:
        alone = look_at(search, with_most_left(search, found.fit.residual)[:1])
        starts += elsewhere(alone, found.effects)
    fits = fit(search.library, starts, search.weigh, steps=12, tolerance=1e-4)
    scored = search.score(sorted(fits, key=lambda one: one.cost)[:1])
    return next(iter(scored), found)


def _pick(search: Search, options: list[Scored], best: Scored) -> Scored | None:
    """Return the best option that is clearly better than what there is."""
    for one in sorted(options, key=lambda one: one.fit.cost):
        gain = 1.0 - one.error / best.error
        # A number that ran to its bounds explains nothing: something else was meant.
        ran = at_bounds(search, one) and not at_bounds(search, best)
        least = WORTH_BOUNDS if ran else BETTER
        sure = gain > least and search.better(one, best)
        search.trail.append(
            {"effects": one.effects, "error": one.error, "gain": gain, "taken": sure}
        )
        if sure:
            return one
    return None


def _drop(search: Search, found: Scored) -> Scored:
    """Drop effects without which the others, fitted again, do as well."""
    while len(found.effects) > 1:
        fewer = [
            tuple(e for e in found.effects if e is not left) for left in found.effects
        ]
        for one in search.fit(fewer):
            loss = 1.0 - found.error / one.error
            if loss < BETTER or not search.better(found, one):
                search.trail.append({"effects": one.effects, "dropped": True})
                found = one
                break
        else:
            return found
    return found


def _beside(at: Fit) -> Array:
    """Directions that the numbers of the present effects explain already."""
    if not at.effects:
        return np.zeros((0, len(at.residual)))
    basis, _ = np.linalg.qr(at.jacobian.T)
    return np.ascontiguousarray(basis.T)


def ranked(probes: Iterable[Probe], at: Fit, hint: float = HINT) -> list[Probe]:
    """Return the probes that would explain something beside a fit, most telling first.

    Args:
        probes: What effects would change.
        at: The fit beside which they are looked at, of the same recordings.
        hint: Part of the mean square that a probe must explain.
    """
    beside = _beside(at)
    left = at.residual - (at.residual @ beside.T) @ beside
    gains = [(explained(one, left, beside), i, one) for i, one in enumerate(probes)]
    # Fitting explains more than a first look, not many times as much.
    least = hint * float(np.mean(at.residual**2))
    return [one for gain, _, one in sorted(gains, key=lambda g: -g[0]) if gain > least]


def _tried_values(
    look: Search, starts: list[tuple[AppliedEffect, ...]], at: Fit
) -> list[tuple[AppliedEffect, ...]]:
    """Return starts with those that values tried in one recording show beside them."""
    alone = look_at(look, with_most_left(look, at.residual)[:1])
    jumping = [
        start
        for candidate in look.library
        if jumps(look, candidate) and candidate not in candidates_of(at.effects)
        for start in best_values(alone, at.effects, candidate)
    ]
    sizes = [other for one in starts for other in better_start(alone, one)]
    return jumping + starts + sizes


def starts_beside(
    search: Search, probes: list[Probe], at: Fit
) -> list[tuple[AppliedEffect, ...]]:
    """Starts of the most telling candidates, beside the present effects."""
    starts, counts = [], dict[Candidate, int]()
    for one in ranked(probes, at):
        count = counts.get(one.candidate, 0)
        if count == 2 or (count == 0 and len(counts) == FITTED):
            continue
        counts[one.candidate] = count + 1
        start = start_of(search.library, one, at.residual)
        starts.append(at.effects + start)
    return starts


def _swaps(
    search: Search, look: Search, probes: list[Probe], options: list[Scored]
) -> list[tuple[AppliedEffect, ...]]:
    """Replace each effect of a good set by the others that tell most without it."""
    starts = []
    for option in options:
        if len(option.effects) < 2:
            continue
        for out in option.effects[:-1]:
            rest = tuple(effect for effect in option.effects if effect is not out)
            known = search.scores.get(frozenset(candidates_of(rest)))
            kept = (known or search.fit([rest])[0]).effects
            at = linearise(look.library, kept, look.weigh)
            names = frozenset(candidates_of(kept))
            fresh = [p for p in probes if p.candidate not in names]
            for one in ranked(fresh, at)[:3]:
                if one.candidate == Candidate(out.name, out.target):
                    continue
                start = start_of(search.library, one, at.residual)
                if frozenset((*names, one.candidate)) not in search.scores:
                    starts.append(kept + start)
    return starts


def _sentence(one: Scored) -> str:
    names = [f"{e.name} {e.target or ''}".strip() for e in one.effects]
    return ", ".join(names) or "nothing"
