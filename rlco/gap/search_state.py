"""What a search knows so far: its data, its weights, and every fit that was made."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from rlco.gap.comparison import clearly_better
from rlco.gap.fit import Fit, Library, candidates_of, fit
from rlco.gap.log import Array
from rlco.gap.outliers import Outliers
from rlco.gap.probe import Probe
from rlco.gap.problem import Candidate, Hypothesis, Integers, Problem
from rlco.gap.weighting import Weighting
from rlco.physics.effects import AppliedEffect


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
        counted_once: As `weighting`, with the spread's prior as it is, for intervals.
        blocks: Block of time of each residual, training first, (N,).
        series: Block and channel of each residual, training first, (N,).
        on_step: Called with a sentence and a part done, for a progress bar.
        moved: What each spread number does to the residuals, (spread, N).
        prior: Standard deviation of each spread number, (spread,).
        outliers: What a second may cost at most, in the layout's order.
        at_first: As `together` where no effect acts.
        looked_at: Training recordings of a first look.
        calm: Square of what the spread does where no effect acts, in units of the
            noise, (N,).
        sensitivity: By how much more, in squares, the robot shows the spread with the
            effects of the last step than without: large where motors hardly hold.
        beside: Effects, and `counted_once` with what the spread does beside them.
        visible: Whether effects of typical sizes would show in these recordings.
        probes: The last first look at each candidate.
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
    counted_once: Weighting
    blocks: Integers
    series: Integers
    on_step: Callable[[str, float], None]
    moved: Array
    prior: Array
    outliers: Outliers | None
    at_first: Weighting
    looked_at: tuple[int, ...]
    calm: Array
    sensitivity: float = 1.0
    beside: tuple[tuple[AppliedEffect, ...], Weighting] | None = None
    visible: bool = True
    probes: list[Probe] = field(default_factory=list)
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

    def heldout_error(self, one: Scored) -> float:
        """Return the root mean square, in units of the noise, without any spread."""
        scaled = self.together.scaled_from(one.everything)
        return float(np.sqrt(np.mean(scaled[len(one.fit.residual) :] ** 2)))

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
