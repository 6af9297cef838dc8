"""Setting of a search: hypotheses, recordings and weights, which rarely change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rlco.gap.compare.problem import Candidate, Hypothesis, Integers, Problem
from rlco.gap.logs.log import Array
from rlco.gap.search.comparison import better_by_both, clearly_better
from rlco.gap.search.fit import Fit, Library, candidates_of
from rlco.gap.search.outliers import Outliers, Rows
from rlco.gap.search.whitening import Whitening, often
from rlco.physics.effects import AppliedEffect

_STEP = 0.01  # finite difference of a tolerance parameter


@dataclass(frozen=True)
class Scored:
    """A fit with the residual of held-out recordings.

    Attributes:
        fit: The fit to the training recordings.
        everything: Whitened residual of all recordings, training first, (N,).
    """

    fit: Fit
    everything: Array

    @property
    def effects(self) -> tuple[AppliedEffect, ...]:
        """The effects, with their parameters."""
        return self.fit.effects

    @property
    def names(self) -> frozenset[Candidate]:
        """Its effects, without parameters."""
        return frozenset(candidates_of(self.fit.effects))

    @property
    def error(self) -> float:
        """Root mean square of the whitened held-out residual; 1 at the noise floor."""
        heldout = self.everything[len(self.fit.residual) :]
        return float(np.sqrt(np.mean(heldout**2)))


@dataclass(frozen=True)
class Free:
    """Changes of the residuals that cost nothing, besides those by the tolerance.

    Attributes:
        columns: Changes of a usual size, (free, N).
    """

    columns: Array

    def beside(
        self, moved: Array, prior: Array, part: Rows, count: int
    ) -> tuple[Array, Array]:
        """Return the tolerance's changes and priors with these added.

        Args:
            moved: Change of some residuals by each tolerance parameter, (spread, n).
            prior: Standard deviation of each, (spread,).
            part: Which residuals these are.
            count: How many residuals the prior counts against, see `Whitening.of`.
        """
        # The prior of a tolerance counts several times; what is free counts once.
        wide = np.full(len(self.columns), np.sqrt(often(count)))
        columns = np.concatenate([moved, self.columns[:, part]])
        return columns, np.concatenate([prior, wide])


@dataclass(frozen=True)
class Weights:
    """Whitening of residuals under the model tolerance.

    Attributes:
        moved: Change of the residuals by each tolerance parameter, (spread, N).
        training: Whitening of the training residuals.
        together: Whitening of all residuals, training first. A tolerance that shows
            only in held-out recordings does not count against an effect.
        counted_once: As `training`, but the prior counts once, for intervals.
    """

    moved: Array
    training: Whitening
    together: Whitening
    counted_once: Whitening

    @classmethod
    def of(
        cls,
        problem: Problem,
        train: tuple[int, ...],
        heldout: tuple[int, ...],
        moved: Array,
        prior: Array,
        outliers: Outliers | None,
        free: Free | None = None,
    ) -> Weights:
        """Return the weights for given changes by the model tolerance.

        Args:
            problem: Robot and log.
            train: Recordings that are fitted.
            heldout: Recordings that are held out.
            moved: Change of the residuals by each tolerance parameter, (spread, N).
            prior: Standard deviation of each tolerance parameter, (spread,).
            outliers: Maximum cost of a second.
            free: What may change besides.
        """
        scale = problem.noise[problem.layout.channel]
        order = training_first(problem, train, heldout)
        near = np.isin(problem.layout.recording, train)

        # A calibration's covariance is known; a tolerance of each parameter is not.
        often = len(scale) if problem.calibration is None else -1

        def whitening(part: Rows, count: int) -> Whitening:
            some = outliers and outliers.part(part)
            columns, width = moved[:, part], prior
            if free is not None:
                columns, width = free.beside(columns, prior, part, count)
            return Whitening.of(scale[part], columns, width, count, some)

        return cls(
            moved,
            whitening(near, often),
            whitening(order, often),
            whitening(near, -1),
        )


@dataclass(frozen=True)
class Setting:
    """Hypotheses, recordings and weights of a fit.

    Attributes:
        problem: Robot and log.
        library: All candidates.
        train: Recordings that are fitted.
        heldout: Recordings that are held out.
        prior: Standard deviation of each tolerance parameter, (spread,).
        outliers: Maximum cost of a second, in the layout's order.
        weights: Whitening of the residuals.
        at_first: `weights.together` without any effect.
        calm: Square of the change by the tolerance without any effect, in units of the
            noise, (N,).
        blocks: Block of time of each residual, training first, (N,).
        series: Block and channel of each residual, training first, (N,).
        excluded: Names of effects that are left out.
        guessed: Changes of the residuals by what of the log is guessed, see
            `Problem.by_guesses`, (K, N).
        free: What may change at no cost besides; None for nothing.
    """

    problem: Problem
    library: Library
    train: tuple[int, ...]
    heldout: tuple[int, ...]
    prior: Array
    outliers: Outliers | None
    weights: Weights
    at_first: Whitening
    calm: Array
    blocks: Integers
    series: Integers
    guessed: Array
    excluded: frozenset[str] = frozenset()
    free: Free | None = None

    def costless(self) -> Free | None:
        """Return all that may change at no cost; None where nothing may."""
        return costless(self.guessed, self.free)

    def residuals(
        self, lists: Sequence[tuple[AppliedEffect, ...]], recordings: tuple[int, ...]
    ) -> Array:
        """Return measured minus simulated under lists of effects, (lists, N)."""
        hypotheses = [Hypothesis(effects) for effects in lists]
        return self.problem.residuals(hypotheses, recordings)

    def whiten(self, lists: Sequence[tuple[AppliedEffect, ...]]) -> Array:
        """Return whitened training residuals, (lists, N); infinite where diverged."""
        rows = self.residuals(lists, self.train)
        fine = np.isfinite(rows).all(axis=1)
        whitened = np.full_like(rows, np.inf)
        whitened[fine] = self.weights.training.whiten(rows[fine])
        return whitened

    def score(self, fits: Sequence[Fit]) -> list[Scored]:
        """Return the fits that do not diverge on held-out recordings."""
        if not fits:
            return []
        lists = [one.effects for one in fits]
        trained = self.residuals(lists, self.train)
        held = self.residuals(lists, self.heldout)
        return [
            Scored(one, self.weights.together.whiten(rows))
            for one, rows in zip(fits, np.hstack([trained, held]), strict=True)
            if np.isfinite(rows).all()
        ]

    def heldout_error(self, one: Scored) -> float:
        """Return the root mean square, in units of the noise, without any tolerance."""
        scaled = self.weights.together.scaled_from(one.everything)
        return float(np.sqrt(np.mean(scaled[len(one.fit.residual) :] ** 2)))

    @property
    def parts(self) -> int:
        """Number of parts of the residual that an effect may help one of, 1 or more.

        What a model leaves in recordings made before is known channel by channel: there
        an effect may be small beside the whole error, and plain in one channel. In one
        log alone, so little may be an error of any other number of the model.
        """
        problem = self.problem
        return len(problem.layout.channels) if problem.noise_was_observed else 1

    def heldout_squares(self, residual: Array) -> Array:
        """Return the sum of squares of each part of the held-out rows, (parts,).

        Args:
            residual: Of all recordings, training first, (N,).
        """
        first = int(np.isin(self.problem.layout.recording, self.train).sum())
        part = self.series[first:] % self.parts
        squares = residual[first:] ** 2
        found = np.bincount(part, weights=squares, minlength=self.parts)
        return np.asarray(found, dtype=float)

    def better(self, one: Scored, other: Scored) -> bool:
        """Return whether a fit is significantly better than another."""
        return clearly_better(
            one.everything, other.everything, self.blocks, self.series
        )

    def better_by_both(self, one: Scored, other: Scored) -> bool:
        """Return whether a fit is significantly better by both tests."""
        return better_by_both(
            one.everything, other.everything, self.blocks, self.series
        )

    def restricted_to(self, some: tuple[int, ...]) -> Setting:
        """Return a setting that fits only some of the recordings."""
        layout = self.problem.layout
        near = np.isin(layout.recording, some)
        scale = self.problem.noise[layout.channel][near]
        moved = self.weights.moved[:, near]
        rows = len(layout.recording) if self.problem.calibration is None else -1
        outliers = self.outliers and self.outliers.part(near)
        prior = self.prior
        if (costless := self.costless()) is not None:
            moved, prior = costless.beside(moved, prior, near, rows)
        training = Whitening.of(scale, moved, prior, rows, outliers)
        return replace(
            self, train=some, weights=replace(self.weights, training=training)
        )

    def largest_residuals(self, residual: Array, count: int) -> tuple[int, ...]:
        """Return the training recordings with the largest mean squares, largest first.

        Args:
            residual: Whitened, of the training recordings, (N,).
            count: Number of recordings.
        """
        order = np.argsort(-self.mean_squares(residual), kind="stable")
        return tuple(self.train[i] for i in order[:count])

    def mean_squares(self, residual: Array) -> Array:
        """Return the mean square of a residual in each training recording, (train,)."""
        recording = self.problem.layout.recording
        of = recording[np.isin(recording, self.train)]
        return np.array([np.mean(residual[of == one] ** 2) for one in self.train])


def costless(guessed: Array, free: Free | None) -> Free | None:
    """Return what is guessed, and what is free besides, as one; None for nothing."""
    if not len(guessed):
        return free
    return Free(guessed if free is None else np.concatenate([guessed, free.columns]))


def training_first(
    problem: Problem, train: tuple[int, ...], heldout: tuple[int, ...]
) -> Integers:
    """Return the rows of the layout, with those of training recordings first."""
    recording = problem.layout.recording
    return np.concatenate(
        [np.flatnonzero(np.isin(recording, p)) for p in (train, heldout)]
    )


def moved_by_tolerance(
    problem: Problem,
    effects: tuple[AppliedEffect, ...],
    recordings: tuple[int, ...] | None = None,
) -> tuple[Array, Array]:
    """Return residuals (N,), and their change per tolerance parameter, (spread, N).

    Args:
        problem: Robot and log.
        effects: Effects that act.
        recordings: Some of the recordings; None for all.
    """
    names = len(problem.tolerance_names)
    hypotheses = [Hypothesis(effects)] + [
        Hypothesis(effects, tuple(_STEP * (i == j) for j in range(names)))
        for i in range(names)
    ]
    rows = problem.residuals(hypotheses, recordings)
    with np.errstate(invalid="ignore"):  # infinite where a simulation diverges
        return rows[0], (rows[1:] - rows[0]) / _STEP


def in_noise(moved: Array, prior: Array, scale: Array) -> Array:
    """Return the squared change by the tolerance in units of the noise, (N,)."""
    return np.asarray(np.sum((moved * prior[:, None] / scale) ** 2, axis=0))
