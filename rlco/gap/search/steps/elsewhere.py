"""Search again from elsewhere where the best effects leave much more than noise.

Each round of a search adds what explains most beside what it has. After a wrong first
effect, several others may each explain some of what the right ones would, and no single
exchange leads out. So before such effects are named, they are held against searches
that begin with other single effects and with pairs of these.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from dataclasses import replace
from itertools import combinations

from rlco.gap.search.fit import linearise
from rlco.gap.search.judge import LOUD, NEAR_FLOOR, at_bounds
from rlco.gap.search.setting import Scored
from rlco.gap.search.state import State

#: Adds effects to a state until nothing helps; yields the state after each step.
Additions = Callable[[State], Iterator[State]]

SINGLES = 4  # single effects that pairs are made of
STARTS = 2  # searches that begin elsewhere


def leaves_much(state: State) -> bool:
    """Return whether the best effects leave what neither noise nor tolerance does."""
    best, setting = state.best, state.setting
    if not best.effects or best.error <= NEAR_FLOOR:
        return False
    return setting.heldout_error(best) > LOUD


def elsewhere(state: State, additions: Additions) -> Generator[State, None, State]:
    """Yield the state after each step of searches begun elsewhere; return the last.

    The best effects are others only where these do clearly better.

    Args:
        state: Of a search that has added and dropped its effects.
        additions: How a search goes on from a first effect or pair.
    """
    if not leaves_much(state):
        return state
    state, starts = _starts(state)
    yield state
    for start in starts:
        state = yield from held_against(state, start, additions)
        if not leaves_much(state):
            break
    return state


def held_against(
    state: State, start: Scored, additions: Additions
) -> Generator[State, None, State]:
    """Yield the state after each step of one search begun elsewhere; return the last.

    The best effects are others only where these do clearly better.

    Args:
        state: Of a search that has added and dropped its effects.
        start: Where the other begins.
        additions: How it goes on.
    """
    begun = begun_with(state, start)
    found = begun
    for found in additions(begun):
        # What was found elsewhere is kept aside until it is whole.
        if found.setting is state.setting:
            state = replace(state, scores=found.scores)
        yield state
    state = better_of(state, found)
    yield state
    return state


def _starts(state: State) -> tuple[State, list[Scored]]:
    """Return the best pair of the best single effects, and the best other single."""
    setting, best = state.setting, state.best
    singles = sorted(
        (one for one in state.scores.values() if len(one.effects) == 1),
        key=lambda one: one.fit.cost,
    )[:SINGLES]
    fresh = [
        first.effects + second.effects
        for first, second in combinations(singles, 2)
        if first.names | second.names not in state.scores
    ]
    state, _ = state.fit(fresh, steps=4)
    known = {one.names for one in singles}
    pairs = [
        one
        for one in state.scores.values()
        if len(one.effects) == 2 and sum(names <= one.names for names in known) == 2
    ]
    others = [one for one in singles if not one.names <= best.names]
    starts = []
    for options in (pairs, others):
        within = [
            one
            for one in options
            if not one.names <= best.names
            and not at_bounds(setting.library, one.effects)
        ]
        starts += sorted(within, key=lambda one: one.fit.cost)[:1]
    return state, starts[:STARTS]


def begun_with(state: State, start: Scored) -> State:
    """Return a state whose search begins with some effects."""
    begun = replace(
        state, best=start, screenings=(), round=None, ended=False, sensitivity=1.0
    )
    return begun.noted(effects=start.effects, elsewhere=True)


def better_of(state: State, found: State) -> State:
    """Return the state with the better best effects of the two."""
    setting, best, other = state.setting, state.best, found.best
    if found.setting is not setting:  # whitened otherwise
        fit = linearise(setting.library, other.effects, setting.whiten)
        scored = setting.score([fit])
        if not scored:
            return state
        other = scored[0]
    better = other.fit.cost < best.fit.cost and setting.better(other, best)
    return found if better and not at_bounds(setting.library, other.effects) else state
