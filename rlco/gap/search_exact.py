"""A small effect that a spread of all numbers would explain too, but not more simply.

Numbers that are all a little off make up for one that is off by a little more. But
where one effect by itself leaves nothing but noise, and no more than all of them
together, they have nothing else to make up for: the model is exact but for that effect.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rlco.gap.fit import Fit, linearise
from rlco.gap.log import Array
from rlco.gap.probe import Probe, orthonormal
from rlco.gap.problem import Integers
from rlco.gap.search import (
    BETTER,
    CLEAN,
    first_look,
    polished,
    ranked,
    refined,
    starts_beside,
)
from rlco.gap.search_start import moved_by_spread
from rlco.gap.search_state import Search
from rlco.gap.weighting import Weighting
from rlco.physics.effects import AppliedEffect

AS_WELL = 1.0 + BETTER  # times what the spread leaves that one effect may leave
FEWER = 3  # numbers of the spread, at least, in the place of which one effect comes
HINT = 0.3  # part of what the spread explains that a first look must explain
HALF_WAY = 0.6  # part of it that two steps must explain


def with_exact_model(search: Search) -> Search:
    """Look for one more effect as if all other numbers of the model were right.

    Args:
        search: A finished search.

    Returns:
        A search without a spread that has found one more effect, or the search that
        was given, where no effect explains as much as a spread of all numbers.
    """
    if search.best is None or not len(search.prior):
        return search
    exact, effects = _exact(search), search.best.effects
    nothing = exact.score([linearise(exact.library, (), exact.weigh)])
    best = next(iter(exact.fit([effects]) if effects else nothing), None)
    if best is None or best.error < CLEAN:
        return search
    spread = _Spread.beside(search, effects)
    search.counted_once = spread.weighting(spread.train)
    left = _rms(spread.left(spread.both, best.everything))
    # On the brink the last digits of a simulation show, as if they were news.
    if search.on_the_brink or not search.probes or spread.numbers < FEWER:
        return search
    look = first_look(exact)
    at = linearise(look.library, best.effects, look.weigh)
    near = spread.left(_rows(search, look.train), at.residual)
    explained = at.cost - float(np.mean(near**2))
    telling = ranked(_as_exact(search, at), at, HINT * explained / at.cost)
    if not telling:
        return search
    starts = starts_beside(exact, look, telling, at)
    for one in refined(exact, look, starts, at, at.cost - HALF_WAY * explained):
        one = polished(exact, one)
        gain = 1.0 - one.error / best.error
        alone = one.error < CLEAN and _rms(one.everything) < AS_WELL * left
        if alone and gain > BETTER and exact.better(one, best):
            exact.best = one
            exact.trail.append(
                {
                    "effects": one.effects,
                    "error": one.error,
                    "gain": gain,
                    "taken": True,
                }
            )
            return exact
    return search


@dataclass(frozen=True)
class _Spread:
    """What the spread does beside effects, its prior counted once.

    Friction is told in units of the servo's stiffness: a stiffness that is a little off
    changes what a joint with friction does, and nothing where there is none.
    """

    search: Search
    moved: Array

    @classmethod
    def beside(cls, search: Search, effects: tuple[AppliedEffect, ...]) -> _Spread:
        """Measure it."""
        if not effects:
            return cls(search, search.moved)
        _, moved = moved_by_spread(search.problem, effects)
        return cls(search, moved if np.isfinite(moved).all() else search.moved)

    @property
    def train(self) -> Integers:
        """Rows of the training recordings."""
        return _rows(self.search, self.search.train)

    @property
    def both(self) -> Integers:
        """All rows, those of the training recordings first."""
        return np.concatenate([self.train, _rows(self.search, self.search.heldout)])

    @property
    def numbers(self) -> int:
        """How many of its numbers the recordings fit well."""
        return int((self.weighting(self.both).shrink < 0.1).sum())

    def weighting(self, rows: Integers) -> Weighting:
        """Return the weights of some rows."""
        search = self.search
        scale = search.problem.noise[search.problem.layout.channel][rows]
        outliers = search.outliers and search.outliers.part(rows)
        return Weighting.of(scale, self.moved[:, rows], search.prior, -1, outliers)

    def left(self, rows: Integers, scaled: Array) -> Array:
        """Return what the best spread leaves of a residual in units of the noise."""
        once = self.weighting(rows)
        # What ridge regression leaves of a direction is the square of its weight.
        along = once.basis.T @ scaled
        return np.asarray(scaled - once.basis @ (along * (1.0 - once.shrink**2)))


def _exact(search: Search) -> Search:
    """Return a search that allows for no spread."""
    scale = search.problem.noise[search.problem.layout.channel]

    def weighting(rows: Integers) -> Weighting:
        outliers = search.outliers and search.outliers.part(rows)
        none = np.zeros((0, len(rows)))
        return Weighting.of(scale[rows], none, np.zeros(0), outliers=outliers)

    rows = _rows(search, search.train)
    trained = weighting(rows)
    together = weighting(np.concatenate([rows, _rows(search, search.heldout)]))
    return replace(
        search,
        weighting=trained,
        together=together,
        counted_once=trained,
        at_first=together,
        moved=np.zeros((0, len(scale))),
        prior=np.zeros(0),
        probes=[],
        scores={},
    )


def _rows(search: Search, recordings: tuple[int, ...]) -> Integers:
    """Return which rows of the layout are of some recordings."""
    return np.flatnonzero(np.isin(search.problem.layout.recording, recordings))


def _as_exact(search: Search, at: Fit) -> list[Probe]:
    """Return the last first look at each effect beside a fit, as it was unweighed."""
    weighting = first_look(search).weighting
    names = {(effect.name, effect.target) for effect in at.effects}
    return [
        replace(
            one,
            columns=orthonormal(weighting.scaled_from(one.columns)),
            first=weighting.scaled_from(one.first),
        )
        for one in search.probes
        if (one.candidate.name, one.candidate.target) not in names
    ]


def _rms(rows: Array) -> float:
    return float(np.sqrt(np.mean(rows**2)))
