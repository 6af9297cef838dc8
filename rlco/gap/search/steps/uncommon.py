"""Try the uncommon effects where the common ones leave more than noise.

Cogging is one of hundreds of waves, and no gradient leads from one to the next. So the
first values of these effects are fitted to the residual linearly, at each joint, beside
what the best common effects explain and beside nothing. The best guesses are simulated
and fitted, and a search goes on from them: the common effects may stand for what an
uncommon one does.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Candidate, Hypothesis
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.search.fit import Library, candidates_of
from rlco.gap.search.judge import LARGEST, NEAR_FLOOR, at_bounds
from rlco.gap.search.position_torques import Guess, guesses, path_of
from rlco.gap.search.setting import Scored
from rlco.gap.search.state import State
from rlco.gap.search.steps.drop import drop
from rlco.gap.search.steps.elsewhere import (
    Additions,
    begun_with,
    better_of,
    held_against,
)
from rlco.physics.effects import EFFECTS, AppliedEffect

GAIN = 0.1  # share of the held-out error that an uncommon effect must remove
GUESSES = 3  # that are simulated
STARTS = 2  # searches that begin with one
_HINT = 0.03  # share of a joint's sum of squares that a guess must explain


def uncommon(state: State, additions: Additions) -> Generator[State, None, State]:
    """Yield the state after each step of searches with uncommon effects; return it.

    The state is the given one where none of them does clearly better.

    Args:
        state: Of a search that has added and dropped its effects.
        additions: How a search goes on from first effects.
    """
    problem = state.setting.problem
    if state.best.error <= NEAR_FLOOR:
        return state
    if not isinstance(problem, ArmRollouts | TorqueLog):
        return state
    library = _library(problem, state)
    best = [
        guess
        for base in _bases(state)
        for guess in _guesses(state, problem, base, library)
    ]
    if not best:
        return state
    tried = _beside(state, library, best)
    yield state
    tried, fits = tried.fit(_starts(state, best))
    likely = [
        one
        for one in fits
        if not at_bounds(tried.setting.library, one.effects)
        and one.error < (1.0 - GAIN) * state.best.error
    ]
    first = state.best
    for start in likely[:STARTS]:
        # What it explains by itself stays, should the search from it lead astray.
        alone = drop(begun_with(tried, start))
        tried = better_of(replace(tried, scores=alone.scores), alone)
        yield tried
        tried = yield from held_against(tried, alone.best, additions)
    if tried.best is first or not _is_worth_it(state, tried.best):
        return state
    yield tried
    return tried


def _library(problem: ArmRollouts | TorqueLog, state: State) -> Library:
    """Return the uncommon effects that were not left out, with their parameters."""
    left_out = state.setting.excluded
    return {
        candidate: EFFECTS[candidate.name].parameters(problem.model, candidate.target)
        for candidate in problem.candidates(uncommon=True)
        if candidate.name not in left_out
    }


def _bases(state: State) -> list[Scored]:
    """Return what the first values are fitted beside."""
    return [state.best, state.none] if state.best.effects else [state.none]


def _guesses(
    state: State, problem: ArmRollouts | TorqueLog, base: Scored, library: Library
) -> list[Guess]:
    """Return the likeliest effects at each joint that something is left at."""
    setting, layout = state.setting, problem.layout
    hypothesis = Hypothesis(base.effects)
    train = np.isin(layout.recording, setting.train)
    channel, residual = layout.channel[train], base.fit.residual
    found = []
    for column, joint in enumerate(layout.channels):
        rows = np.flatnonzero(channel == column)
        squares = float(np.sum(residual[rows] ** 2))
        if squares < NEAR_FLOOR * len(rows):
            continue
        path = path_of(problem, hypothesis, joint, np.array(setting.train))
        if path is None:
            continue
        for guess in guesses(path, joint, rows, residual, setting.weights.training):
            (name,) = candidates_of([guess.effect])
            if name in library and guess.gain > _HINT * squares:
                found.append(guess)
    return sorted(found, key=lambda one: -one.gain)[:GUESSES]


def _beside(state: State, library: Library, best: list[Guess]) -> State:
    """Return the state with the guessed effects in its library.

    Only these: to others no screening or rival would lead.
    """
    names = candidates_of([guess.effect for guess in best])
    wider = {**state.setting.library, **{name: library[name] for name in names}}
    return replace(state, setting=replace(state.setting, library=wider))


def _starts(state: State, best: list[Guess]) -> list[tuple[AppliedEffect, ...]]:
    """Return guesses alone, beside the best effects, and beside other joints'."""
    starts: dict[frozenset[Candidate], tuple[AppliedEffect, ...]] = {}
    effects = state.best.effects
    for guess in best:
        elsewhere = tuple(e for e in effects if e.target != guess.effect.target)
        for beside in (effects, elsewhere, ()):
            start = (*beside, guess.effect)
            if len(start) <= LARGEST:
                starts.setdefault(frozenset(candidates_of(start)), start)
    return list(starts.values())


def _is_worth_it(state: State, one: Scored) -> bool:
    """Return whether a set with an uncommon effect is clearly better than without."""
    rare = any(EFFECTS[effect.name].uncommon for effect in one.effects)
    return rare and one.error < (1.0 - GAIN) * state.best.error
