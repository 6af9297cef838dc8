"""Numbers that jump: every value is tried, since none shows the way to the next.

A controller that is slower than the commands holds each for a while, and the path of
the arm changes all over with every millisecond of that while: the right one stands
alone, and a step away the fit is worse than without. A joint that sticks and slips has
many fits that are best among their neighbours, too: there a few sizes are tried.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from rlco.gap.comparison import block_sums
from rlco.gap.fit import candidates_of, usual_size, with_values
from rlco.gap.log import Array
from rlco.gap.problem import Candidate
from rlco.gap.search_state import Search
from rlco.physics.effects import AppliedEffect

_PARTS = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8)  # of the usual size
_CLEARLY = 0.9  # part of the mean square that a better start may leave


def jumps(search: Search, candidate: Candidate) -> bool:
    """Return whether an effect is one number that jumps."""
    known = search.library[candidate]
    return len(known) == 1 and known[0].resolution > 0.0


def best_values(
    look: Search, rest: tuple[AppliedEffect, ...], candidate: Candidate
) -> list[tuple[AppliedEffect, ...]]:
    """Return effects with the most promising values of a number that jumps.

    That which leaves least, and that which leaves least in most channels: where
    another effect is missing too, it spoils some channels and leaves the others clean.

    Args:
        look: A search over a recording or a few.
        rest: Effects that act beside it.
        candidate: The effect whose number jumps.
    """
    (known,) = look.library[candidate]
    low, high = min(known.starts), max(known.starts)
    values = np.arange(low, high + known.resolution / 2, known.resolution)
    lists = [
        rest + with_values(look.library, [candidate], np.array([value], dtype=float))
        for value in values
    ]
    left = _left_in_channels(look, look.weigh(lists))
    best = {int(left.mean(axis=1).argmin()), int(np.log(left).mean(axis=1).argmin())}
    return [lists[i] for i in sorted(best)]


def better_start(
    look: Search, start: tuple[AppliedEffect, ...]
) -> list[tuple[AppliedEffect, ...]]:
    """Return a start that leaves clearly less than another, where there is one.

    Args:
        look: A search over a recording.
        start: Effects, of which the last has the numbers in question.
    """
    rest, (last,) = start[:-1], start[-1:]
    (candidate,) = candidates_of([last])
    known = look.library[candidate]
    if jumps(look, candidate) or len(known) > 2 or not known[0].scales:
        return []
    first, values = known[0], np.array(last.values)
    below = values[0] < first.neutral
    room = first.neutral - first.low if below else first.high - first.neutral
    size = min(usual_size(first), room) * (-1.0 if below else 1.0)
    others = [_between(min(p.starts), max(p.starts)) for p in known[1:]]
    low, high = np.array([(p.low, p.high) for p in known]).T
    grid = np.array(list(product(first.neutral + size * np.array(_PARTS), *others)))
    rows = [values, *np.unique(np.clip(grid, low, high), axis=0)]
    lists = [rest + with_values(look.library, [candidate], row) for row in rows]
    costs = np.mean(look.weigh(lists) ** 2, axis=1)
    best = int(costs.argmin())
    return [lists[best]] if costs[best] < _CLEARLY * costs[0] else []


def _between(low: float, high: float) -> Array:
    """Return three numbers from one to another, or the one."""
    if low == high:
        return np.array([low])
    return np.asarray((np.geomspace if low > 0.0 else np.linspace)(low, high, 3))


def elsewhere(
    look: Search, effects: tuple[AppliedEffect, ...]
) -> Iterator[tuple[AppliedEffect, ...]]:
    """Yield effects with other values of each number that jumps among them."""
    for effect in effects:
        (candidate,) = candidates_of([effect])
        if jumps(look, candidate):
            rest = tuple(one for one in effects if one is not effect)
            yield from best_values(look, rest, candidate)


def _left_in_channels(look: Search, rows: Array) -> Array:
    """Return the mean square of rows (values, N) in each channel, (values, C)."""
    layout = look.problem.layout
    channel = layout.channel[np.isin(layout.recording, look.train)]
    sums = np.stack([block_sums(row**2, channel) for row in rows])
    counts = np.unique(channel, return_counts=True)[1]
    return np.asarray(sums / counts)
