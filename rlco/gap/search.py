"""The search for missing effects: forward, swap and backward steps over rollouts."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rlco.errors import DataError
from rlco.gap.comparison import block_sums, clearly_better
from rlco.gap.fit import Fit, Library, candidates_of, fit, library_of, linearise
from rlco.gap.log import Array
from rlco.gap.outliers import Outliers
from rlco.gap.probe import Probe, explained, probe, start_of
from rlco.gap.problem import Candidate, Hypothesis, Integers, Problem
from rlco.gap.weighting import Weighting
from rlco.physics.effects import AppliedEffect

LARGEST = 4  # effects at once
FITTED = 6  # candidates that are fitted in a forward step
PROBED = 3  # recordings of the first look
CLEAN = 1.1  # mean square, over the typical, of a joint that needs no effect
HINT = 0.015  # part of the mean square that a first look must explain
BETTER = 0.03  # part of the held-out error that an effect must take away


@dataclass(frozen=True)
class Scored:
    """A fit with what it leaves in recordings that were not fitted.

    Attributes:
        fit: The fit to the training recordings.
        everything: Weighted residual of all recordings, training first, (N,).
    """

    fit: Fit
    everything: Array

    @property
    def effects(self) -> tuple[AppliedEffect, ...]:
        """The effects, with their numbers."""
        return self.fit.effects

    @property
    def names(self) -> frozenset[Candidate]:
        """What its effects are."""
        return frozenset(candidates_of(self.fit.effects))

    @property
    def error(self) -> float:
        """Root mean square of the weighted held-out residual; 1 at the noise floor."""
        heldout = self.everything[len(self.fit.residual) :]
        return float(np.sqrt(np.mean(heldout**2)))


@dataclass
class Search:
    """The state of one search.

    Attributes:
        problem: Robot and log.
        library: What may be hypothesised.
        train: Recordings that are fitted.
        heldout: Recordings that are not.
        weighting: Weights of the training residuals.
        together: Weights of all residuals, training first. A spread that only shows
            in held-out recordings is not held against an effect.
        blocks: Block of time of each residual, training first, (N,).
        series: Block and channel of each residual, training first, (N,).
        on_step: Called with a sentence and a part done, for a progress bar.
        counted_once: As `weighting`, with the spread's prior as it is, for intervals.
        moved: What each spread number does to the residuals, (spread, N).
        prior: Standard deviation of each spread number, (spread,).
        outliers: What a second may cost at most, in the layout's order.
        visible: Whether effects of typical sizes would show in these recordings.
        trail: What was tried.
        best: The best set of effects so far.
        scores: Every fit that was made, by its set of candidates.
    """

    problem: Problem
    library: Library
    train: tuple[int, ...]
    heldout: tuple[int, ...]
    weighting: Weighting
    together: Weighting
    blocks: Integers
    series: Integers
    on_step: Callable[[str, float], None]
    counted_once: Weighting
    moved: Array
    prior: Array
    outliers: Outliers | None
    visible: bool = True
    trail: list[dict[str, object]] = field(default_factory=list)
    best: Scored | None = None
    scores: dict[frozenset[Candidate], Scored] = field(default_factory=dict)

    def weigh(self, lists: Sequence[tuple[AppliedEffect, ...]]) -> Array:
        """Return weighted training residuals, (lists, N); infinite where diverged."""
        rows = self.residuals(lists, self.train)
        fine = np.isfinite(rows).all(axis=1)
        weighted = np.full_like(rows, np.inf)
        weighted[fine] = self.weighting.weigh(rows[fine])
        return weighted

    def residuals(
        self, lists: Sequence[tuple[AppliedEffect, ...]], recordings: tuple[int, ...]
    ) -> Array:
        """Return measured minus simulated under lists of effects, (lists, N)."""
        hypotheses = [Hypothesis(effects) for effects in lists]
        return self.problem.residuals(hypotheses, recordings)

    def score(self, fits: Sequence[Fit]) -> list[Scored]:
        """Return the fits that hold on held-out recordings without diverging."""
        if not fits:
            return []
        lists = [one.effects for one in fits]
        trained = self.residuals(lists, self.train)
        held = self.residuals(lists, self.heldout)
        out = []
        for one, rows in zip(fits, np.hstack([trained, held]), strict=True):
            if not np.isfinite(rows).all():
                continue
            scored = Scored(one, self.together.weigh(rows))
            known = self.scores.get(scored.names)
            if known is None or known.fit.cost > one.cost:
                self.scores[scored.names] = scored
            out.append(scored)
        return out

    def fit(
        self, starts: Sequence[Sequence[AppliedEffect]], steps: int = 6
    ) -> list[Scored]:
        """Fit from each start, and score; the best of each set of effects."""
        fits = fit(self.library, starts, self.weigh, steps=steps)
        best: dict[frozenset[Candidate], Scored] = {}
        for one in self.score(fits):
            if one.names not in best or best[one.names].fit.cost > one.fit.cost:
                best[one.names] = one
        return sorted(best.values(), key=lambda one: one.fit.cost)

    def better(self, one: Scored, other: Scored) -> bool:
        """Return whether a fit is better than another beyond doubt."""
        return clearly_better(
            one.everything, other.everything, self.blocks, self.series
        )


def start_search(
    problem: Problem,
    *,
    spread: float = 0.03,
    exclude: Collection[str] = (),
    on_step: Callable[[str, float], None] | None = None,
) -> Search:
    """Prepare a search: split the recordings, and measure what the spread does.

    Args:
        problem: Robot and log.
        spread: By how much every number of the model may be off, as a part of it.
        exclude: Names of effects to leave out.
        on_step: Called with a sentence and a part done.

    Raises:
        DataError: If the nominal simulation diverges.
    """
    total = len(problem.log.recordings)
    heldout = tuple(i for i in range(total) if i % 3 == 2) or (total - 1,)
    train = tuple(i for i in range(total) if i not in heldout)
    names = len(problem.spread_names)
    step = 0.01
    hypotheses = [Hypothesis()] + [
        Hypothesis((), tuple(step * (i == j) for j in range(names)))
        for i in range(names)
    ]
    rows = problem.residuals(hypotheses)
    moved = (rows[1:] - rows[0]) / step
    layout = problem.layout
    scale = problem.noise[layout.channel]
    prior = np.full(names, spread)
    near, far = (np.isin(layout.recording, part) for part in (train, heldout))
    order = np.concatenate([np.flatnonzero(near), np.flatnonzero(far)])
    seconds = layout.recording * 10_000 + layout.time.astype(np.int64)
    blocks = seconds[order]
    outliers = Outliers.of(rows[0] / scale, seconds) if problem.has_outliers else None

    def weighting(part: Array, count: int) -> Weighting:
        some = outliers and outliers.part(part)
        return Weighting.of(scale[part], moved[:, part], prior, count, some)

    search = Search(
        problem,
        library_of(problem, exclude),
        train,
        heldout,
        weighting(near, len(scale)),
        weighting(order, len(scale)),
        blocks,
        blocks * len(layout.channels) + layout.channel[order],
        on_step or (lambda said, part: None),
        weighting(near, -1),
        moved,
        prior,
        outliers,
    )
    nothing = linearise(search.library, (), search.weigh)
    if not search.score([nothing]):
        raise DataError(
            "the simulation of these recordings diverges without any effect: check "
            "that the model is the robot's, and that it is stable at its time step."
        )
    return search


def search_effects(search: Search) -> Scored:
    """Add, swap and drop effects until none of these clearly helps.

    Returns:
        The best set; `search.best` is it too, at any time, for an interruption.
    """
    best = search.best = search.scores[frozenset()]
    while len(best.effects) < LARGEST:
        look = first_look(search)
        at = linearise(look.library, best.effects, look.weigh)
        candidates = _worth_a_look(search, best)
        done = len(best.effects) / LARGEST
        search.on_step(f"looking at {len(candidates)} effects", done)
        probes = probe(look.library, candidates, best.effects, at.residual, look.weigh)
        if not best.effects:
            sizes = [float(np.mean(one.first**2)) for one in probes]
            search.visible = sum(size > 1.0 for size in sizes) > 0.2 * len(sizes)
        options = refined(search, look, _starts(search, probes, at))
        swaps = _swaps(search, look, probes, options[:2])
        options += refined(search, look, swaps)
        found = _pick(search, options, best)
        if found is None:
            break
        best = search.best = _drop(search, _polished(search, found))
        search.on_step(_sentence(best), len(best.effects) / LARGEST)
    return best


def first_look(search: Search) -> Search:
    """Return a search over some of the training recordings, for a first look."""
    some = search.train[:: max(1, -(-len(search.train) // PROBED))]
    layout = search.problem.layout
    near = np.isin(layout.recording, some)
    scale = search.problem.noise[layout.channel][near]
    moved, rows = search.moved[:, near], len(layout.recording)
    outliers = search.outliers and search.outliers.part(near)
    weighting = Weighting.of(scale, moved, search.prior, rows, outliers)
    return replace(search, train=some, weighting=weighting)


def _worth_a_look(search: Search, best: Scored) -> list[Candidate]:
    """Candidates that may explain something of what is left, in the library's order.

    Whatever an effect of a joint does to others, it does more to that joint.
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
    return [c for c in fresh if c.target not in done]


def refined(
    search: Search, look: Search, starts: list[tuple[AppliedEffect, ...]]
) -> list[Scored]:
    """Fit a little from each start to some recordings, and on where that went best.

    Args:
        search: The search.
        look: The same with fewer recordings, for the first steps.
        starts: Effects with the numbers to start from.
    """
    rough = fit(look.library, starts, look.weigh, steps=2)
    best: dict[frozenset[Candidate], Fit] = {}
    for one in sorted(rough, key=lambda one: one.cost):
        best.setdefault(frozenset(candidates_of(one.effects)), one)
    ranking = list(best.values())
    near = [one for one in ranking if one.cost < 2.0 * ranking[0].cost][:4]
    return search.fit([one.effects for one in near], steps=5)


def _polished(search: Search, found: Scored) -> Scored:
    """Fit to the end: what a half-way fit leaves looks like one more effect."""
    fits = fit(search.library, [found.effects], search.weigh, steps=12, tolerance=1e-4)
    return next(iter(search.score(fits)), found)


def _pick(search: Search, options: list[Scored], best: Scored) -> Scored | None:
    """Return the best option that is clearly better than what there is."""
    for one in sorted(options, key=lambda one: one.fit.cost):
        gain = 1.0 - one.error / best.error
        sure = gain > BETTER and search.better(one, best)
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


def ranked(probes: Iterable[Probe], at: Fit) -> list[Probe]:
    """Return the probes that would explain something beside a fit, most telling first.

    Args:
        probes: What effects would change.
        at: The fit beside which they are looked at, of the same recordings.
    """
    beside = _beside(at)
    left = at.residual - (at.residual @ beside.T) @ beside
    gains = [(explained(one, left, beside), i, one) for i, one in enumerate(probes)]
    # Fitting explains more than a first look, not many times as much.
    least = HINT * float(np.mean(at.residual**2))
    return [one for gain, _, one in sorted(gains, key=lambda g: -g[0]) if gain > least]


def _starts(
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
