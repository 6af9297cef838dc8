"""Drop effects that the others can replace, or that do not show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rlco.gap.search.judge import at_bounds, is_worth_it
from rlco.gap.search.state import State

VISIBLE = 0.05  # mean square beyond the tolerance that an effect must cause by itself


def drop(state: State) -> State:
    """Drop effects without which the others, fitted again, do as well."""
    while len(state.best.effects) > 1:
        best = state.best
        state = _without_one(state)
        if state.best is best:
            break
    return state


def _without_one(state: State) -> State:
    """Return the state with one effect less in its best set, if that does as well."""
    best, effects = state.best, state.best.effects
    fewer = [tuple(e for e in effects if e is not dropped) for dropped in effects]
    state, options = state.fit(fewer)
    for one in options:
        if not is_worth_it(state, best, one):
            state = state.noted(effects=one.effects, dropped=True)
            return replace(state, best=one)
    return state


def drop_unobservable(state: State) -> State:
    """Drop effects that the tolerance could replace but for the other effects.

    A robot at the edge of stability amplifies parameter errors of a per cent. If a
    parameter reached its bounds, all effects are in doubt and are kept.
    """
    setting = state.setting
    while len(state.best.effects) > 1:
        best = state.best
        if at_bounds(setting.library, best.effects):
            break
        lists = [(), *((effect,) for effect in best.effects)]
        parts = (setting.train, setting.heldout)
        rows = np.hstack([setting.residuals(lists, part) for part in parts])
        if not np.isfinite(rows).all():
            break
        whitened = setting.at_first.whiten(rows)
        changes = np.mean((whitened[1:] - whitened[0]) ** 2, axis=1)
        least = int(changes.argmin())
        if changes[least] > VISIBLE / setting.parts:
            break
        dropped = best.effects[least]
        state, fits = state.fit([tuple(e for e in best.effects if e is not dropped)])
        if not fits:
            break
        state = replace(state, best=fits[0])
        state = state.noted(effects=fits[0].effects, dropped=True)
    return state
