"""Start of a search: split of the recordings, and the change by the tolerance."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from rlco.errors import DataError
from rlco.gap.compare.problem import Hypothesis, Problem
from rlco.gap.compare.stability.instability import check_stable
from rlco.gap.logs.log import Array
from rlco.gap.search.comparison import seconds_of
from rlco.gap.search.fit import library_of, linearise
from rlco.gap.search.outliers import Outliers
from rlco.gap.search.setting import (
    Free,
    Setting,
    Weights,
    costless,
    in_noise,
    moved_by_tolerance,
    training_first,
)
from rlco.gap.search.state import State

SCREENED = 3  # recordings of a screening


def start(
    problem: Problem,
    *,
    spread: float = 0.03,
    exclude: Collection[str] = (),
    free: Free | None = None,
) -> State:
    """Return the first state of a search, with split recordings and known tolerance.

    Args:
        problem: Robot and log.
        spread: Model tolerance: relative uncertainty of every model parameter.
        exclude: Names of effects to leave out.
        free: Changes of the residuals that cost nothing; None for none.

    Raises:
        UnstableModelError: If the nominal simulation diverges, or does with one
            parameter of the model 1 % larger.
    """
    setting = _setting(problem, spread, exclude, free)
    nothing = linearise(setting.library, (), setting.whiten)
    (none,) = setting.score([nothing])
    screened = _some_recordings(setting, nothing.residual)
    return State(setting, none, screened, {none.names: none})


def split(problem: Problem) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the recordings to fit, and every third, which is held out.

    Of three or more recordings that were cut, no part is fitted of one that is held
    out.

    Raises:
        DataError: There is a single one.
    """
    recordings = problem.log.recordings
    total = len(recordings)
    if total < 2:
        raise DataError(
            f"the log holds one recording, {recordings[0].name!r}, of which nothing "
            "can be held out, since a toss and an episode of a task are not cut; give "
            "two or more, best six."
        )
    # One that was too short to be cut is whole.
    names = [one.cut_from or one.name for one in recordings]
    whole = list(dict.fromkeys(names))
    if 3 <= len(whole) < total:
        out = set(whole[2::3])
        heldout = tuple(i for i in range(total) if names[i] in out)
    else:
        heldout = tuple(i for i in range(total) if i % 3 == 2) or (total - 1,)
    return tuple(i for i in range(total) if i not in heldout), heldout


def _setting(
    problem: Problem, spread: float, exclude: Collection[str], free: Free | None
) -> Setting:
    train, heldout = split(problem)
    nominal, moved = moved_by_tolerance(problem, ())
    check_stable(problem, nominal, moved)
    layout = problem.layout
    scale = problem.noise[layout.channel]
    prior = np.full(len(moved), spread)
    order = training_first(problem, train, heldout)
    seconds = seconds_of(layout)
    blocks = seconds[order]
    outliers = Outliers.of(nominal / scale, seconds) if problem.has_outliers else None
    guessed = problem.by_guesses(Hypothesis())
    weights = Weights.of(
        problem, train, heldout, moved, prior, outliers, costless(guessed, free)
    )
    return Setting(
        problem=problem,
        library=library_of(problem, exclude),
        train=train,
        heldout=heldout,
        prior=prior,
        outliers=outliers,
        weights=weights,
        at_first=weights.together,
        calm=in_noise(moved, prior, scale),
        blocks=blocks,
        series=blocks * len(layout.channels) + layout.channel[order],
        guessed=guessed,
        excluded=frozenset(exclude),
        free=free,
    )


def _some_recordings(setting: Setting, residual: Array) -> tuple[int, ...]:
    """Return a few training recordings: one with most of the gap, others spread out.

    Args:
        setting: The setting.
        residual: Whitened, of the training recordings, (N,).
    """
    some = list(setting.train[:: max(1, -(-len(setting.train) // SCREENED))])
    most = setting.train[int(setting.mean_squares(residual).argmax())]
    if most not in some:
        some[int(np.argmin([abs(one - most) for one in some]))] = most
    return tuple(sorted(some))
