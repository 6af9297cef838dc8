"""Discontinuous parameters: fitted by trying values, since gradients do not help.

A controller that reads commands at a lower rate holds each command for a period, and
the arm's path changes completely with every millisecond of that period. The correct
value is isolated: next to it the fit is worse than without the effect. A joint with
stick-slip has many local optima, too; there a few sizes are tried.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from rlco.gap.compare.problem import Candidate
from rlco.gap.logs.log import Array
from rlco.gap.search.comparison import block_sums
from rlco.gap.search.fit import candidates_of, usual_size, with_values
from rlco.gap.search.setting import Setting
from rlco.physics.effects import AppliedEffect

_PARTS = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8)  # multiples of the usual size
_CLEARLY = 0.9  # ratio of mean squares at which another start is better


def is_discontinuous(setting: Setting, candidate: Candidate) -> bool:
    """Return whether an effect has a single, discontinuous parameter."""
    known = setting.library[candidate]
    return len(known) == 1 and known[0].resolution > 0.0


def best_values(
    subset: Setting, rest: tuple[AppliedEffect, ...], candidate: Candidate
) -> list[tuple[AppliedEffect, ...]]:
    """Return effects with the most promising values of a discontinuous parameter.

    These are the value with the least residual, and the value with the least residual
    in most channels. If another effect is missing too, it increases the residual of
    some channels only.

    Args:
        subset: A setting with one or a few recordings.
        rest: Effects that act besides it.
        candidate: The effect with the discontinuous parameter.
    """
    (known,) = subset.library[candidate]
    low, high = min(known.starts), max(known.starts)
    values = np.arange(low, high + known.resolution / 2, known.resolution)
    lists = [
        rest + with_values(subset.library, [candidate], np.array([value], dtype=float))
        for value in values
    ]
    residuals = _residual_by_channel(subset, subset.whiten(lists))
    best = {
        int(residuals.mean(axis=1).argmin()),
        int(np.log(residuals).mean(axis=1).argmin()),
    }
    return [lists[i] for i in sorted(best)]


def better_start(
    subset: Setting, start: tuple[AppliedEffect, ...]
) -> list[tuple[AppliedEffect, ...]]:
    """Return a start with a clearly smaller residual than another, if there is one.

    Args:
        subset: A setting with one recording.
        start: Effects; the last one's parameters are varied.
    """
    rest, (last,) = start[:-1], start[-1:]
    (candidate,) = candidates_of([last])
    known = subset.library[candidate]
    if is_discontinuous(subset, candidate) or len(known) > 2 or not known[0].scales:
        return []
    first, values = known[0], np.array(last.values)
    below = values[0] < first.neutral
    room = first.neutral - first.low if below else first.high - first.neutral
    size = min(usual_size(first), room) * (-1.0 if below else 1.0)
    others = [_between(min(p.starts), max(p.starts)) for p in known[1:]]
    low, high = np.array([(p.low, p.high) for p in known]).T
    grid = np.array(list(product(first.neutral + size * np.array(_PARTS), *others)))
    rows = [values, *np.unique(np.clip(grid, low, high), axis=0)]
    lists = [rest + with_values(subset.library, [candidate], row) for row in rows]
    costs = np.mean(subset.whiten(lists) ** 2, axis=1)
    best = int(costs.argmin())
    return [lists[best]] if costs[best] < _CLEARLY * costs[0] else []


def _between(low: float, high: float) -> Array:
    """Return three values between two bounds, or the only one."""
    if low == high:
        return np.array([low])
    return np.asarray((np.geomspace if low > 0.0 else np.linspace)(low, high, 3))


def other_values(
    subset: Setting, effects: tuple[AppliedEffect, ...]
) -> Iterator[tuple[AppliedEffect, ...]]:
    """Yield the effects with other values of each discontinuous parameter."""
    for effect in effects:
        (candidate,) = candidates_of([effect])
        if is_discontinuous(subset, candidate):
            rest = tuple(one for one in effects if one is not effect)
            yield from best_values(subset, rest, candidate)


def _residual_by_channel(subset: Setting, rows: Array) -> Array:
    """Return the mean square of rows (values, N) in each channel, (values, C)."""
    layout = subset.problem.layout
    channel = layout.channel[np.isin(layout.recording, subset.train)]
    sums = np.stack([block_sums(row**2, channel) for row in rows])
    counts = np.unique(channel, return_counts=True)[1]
    return np.asarray(sums / counts)
