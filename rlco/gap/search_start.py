"""Where a search begins: which recordings are held out, and what the spread does."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace

import numpy as np

from rlco.errors import DataError
from rlco.gap.fit import library_of, linearise
from rlco.gap.log import Array
from rlco.gap.outliers import Outliers, Rows
from rlco.gap.problem import Hypothesis, Integers, Problem
from rlco.gap.search_state import Scored, Search
from rlco.gap.weighting import Weighting
from rlco.physics.effects import AppliedEffect

GREW = 30.0  # times as sensitive to the spread, in squares: looked at again
LOOKED_AT = 3  # recordings of a first look
_STEP = 0.01  # of a number, to see what the spread does


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
    nominal, moved = moved_by_spread(problem, ())
    layout = problem.layout
    scale = problem.noise[layout.channel]
    prior = np.full(len(moved), spread)
    order = training_first(problem, train, heldout)
    seconds = layout.recording * 10_000 + layout.time.astype(np.int64)
    blocks = seconds[order]
    outliers = Outliers.of(nominal / scale, seconds) if problem.has_outliers else None
    weights = weightings(problem, train, heldout, moved, prior, outliers)
    search = Search(
        problem,
        library_of(problem, exclude),
        train,
        heldout,
        *weights,
        blocks,
        blocks * len(layout.channels) + layout.channel[order],
        on_step or (lambda said, part: None),
        moved,
        prior,
        outliers,
        weights[1],
        train,
        _squares(moved, prior, scale),
    )
    nothing = linearise(search.library, (), search.weigh)
    if not search.score([nothing]):
        raise DataError(
            "the simulation of these recordings diverges without any effect: check "
            "that the model is the robot's, and that it is stable at its time step."
        )
    search.looked_at = _some_recordings(search, nothing.residual)
    return search


def _some_recordings(search: Search, residual: Array) -> tuple[int, ...]:
    """Return a few training recordings: one with most of the gap, others all over.

    Args:
        search: The search.
        residual: Weighted, of the training recordings, (N,).
    """
    some = list(search.train[:: max(1, -(-len(search.train) // LOOKED_AT))])
    most = search.train[int(_left(search, residual).argmax())]
    if most not in some:
        some[int(np.argmin([abs(one - most) for one in some]))] = most
    return tuple(sorted(some))


def with_most_left(search: Search, residual: Array) -> tuple[int, ...]:
    """Return as many training recordings as are looked at, those with most left first.

    Args:
        search: The search.
        residual: Weighted, of the training recordings, (N,).
    """
    order = np.argsort(-_left(search, residual), kind="stable")
    most = order[: len(search.looked_at)]
    return tuple(search.train[i] for i in most)


def _left(search: Search, residual: Array) -> Array:
    """Return the mean square of a residual in each training recording, (train,)."""
    recording = search.problem.layout.recording
    of = recording[np.isin(recording, search.train)]
    return np.array([np.mean(residual[of == one] ** 2) for one in search.train])


def moved_by_spread(
    problem: Problem,
    effects: tuple[AppliedEffect, ...],
    recordings: tuple[int, ...] | None = None,
) -> tuple[Array, Array]:
    """Return residuals (N,), and what a unit of each spread number does (spread, N).

    Args:
        problem: Robot and log.
        effects: What acts beside it.
        recordings: Some of the recordings; None for all.
    """
    names = len(problem.spread_names)
    hypotheses = [Hypothesis(effects)] + [
        Hypothesis(effects, tuple(_STEP * (i == j) for j in range(names)))
        for i in range(names)
    ]
    rows = problem.residuals(hypotheses, recordings)
    with np.errstate(invalid="ignore"):  # infinite where a simulation diverges
        return rows[0], (rows[1:] - rows[0]) / _STEP


def weightings(
    problem: Problem,
    train: tuple[int, ...],
    heldout: tuple[int, ...],
    moved: Array,
    prior: Array,
    outliers: Outliers | None,
) -> tuple[Weighting, Weighting, Weighting]:
    """Return the weights of training rows, of all rows, and with the prior once.

    Args:
        problem: Robot and log.
        train: Recordings that are fitted.
        heldout: Recordings that are not.
        moved: What each spread number does to the residuals, (spread, N).
        prior: Standard deviation of each spread number, (spread,).
        outliers: What a second may cost at most.
    """
    scale = problem.noise[problem.layout.channel]
    order = training_first(problem, train, heldout)
    near = np.isin(problem.layout.recording, train)

    def weighting(part: Rows, count: int) -> Weighting:
        some = outliers and outliers.part(part)
        return Weighting.of(scale[part], moved[:, part], prior, count, some)

    return (
        weighting(near, len(scale)),
        weighting(order, len(scale)),
        weighting(near, -1),
    )


def training_first(
    problem: Problem, train: tuple[int, ...], heldout: tuple[int, ...]
) -> Integers:
    """Return the rows of the layout, those of training recordings first."""
    recording = problem.layout.recording
    return np.concatenate(
        [np.flatnonzero(np.isin(recording, p)) for p in (train, heldout)]
    )


def with_spread_at(search: Search, best: Scored) -> Scored:
    """Look at the spread again, where effects make the robot more sensitive to it.

    A motor that can hardly hold its arm drops it a little earlier or later for any
    small difference, which one that has plenty hides.
    """
    layout, prior = search.problem.layout, search.prior
    scale = search.problem.noise[layout.channel]
    looked = np.isin(layout.recording, search.looked_at)
    _, moved = moved_by_spread(search.problem, best.effects, search.looked_at)
    after = float(_squares(moved, prior, scale[looked]).sum())
    calm = float(search.calm[looked].sum())
    search.sensitivity = after / calm if calm > 0.0 else 1.0
    before = float(_squares(search.moved[:, looked], prior, scale[looked]).sum())
    if not GREW * before < after < np.inf:
        return best
    _, moved = moved_by_spread(search.problem, best.effects)
    if not np.isfinite(moved).all():
        return best
    parts = search.problem, search.train, search.heldout
    weighting, together, once = weightings(*parts, moved, prior, search.outliers)
    # An interruption finds the search as it was, or as it will be.
    fresh = replace(
        search, weighting=weighting, together=together, counted_once=once, scores={}
    )
    fresh.score([linearise(fresh.library, (), fresh.weigh)])
    again = next(iter(fresh.fit([best.effects])), None)
    if again is None:
        return best
    search.best, search.scores, search.probes = again, fresh.scores, []
    search.moved, search.counted_once = moved, once
    search.weighting, search.together = weighting, together
    return again


def spread_beside(search: Search, effects: tuple[AppliedEffect, ...]) -> Weighting:
    """Return `Search.counted_once` with what the spread does beside effects.

    Friction is told in units of the servo's stiffness: a stiffness that is a little off
    changes what a joint with friction does, and nothing where there is none.
    """
    if not effects or not len(search.prior):
        return search.counted_once
    if search.beside is not None and search.beside[0] is effects:
        return search.beside[1]
    _, moved = moved_by_spread(search.problem, effects, search.train)
    if not np.isfinite(moved).all():
        return search.counted_once
    near = np.isin(search.problem.layout.recording, search.train)
    scale = search.problem.noise[search.problem.layout.channel][near]
    outliers = search.outliers and search.outliers.part(near)
    search.beside = effects, Weighting.of(scale, moved, search.prior, -1, outliers)
    return search.beside[1]


def _squares(moved: Array, prior: Array, scale: Array) -> Array:
    """Return the square of what the spread does, in units of the noise, (N,)."""
    return np.asarray(np.sum((moved * prior[:, None] / scale) ** 2, axis=0))
