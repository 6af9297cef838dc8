"""Numbers that jump: every value is tried, since none shows the way to the next.

A controller that is slower than the commands holds each for a while, and the path of
the arm changes all over with every millisecond of that while: the right one stands
alone, and a step away the fit is worse than without.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rlco.gap.comparison import block_sums
from rlco.gap.fit import candidates_of, with_values
from rlco.gap.log import Array
from rlco.gap.problem import Candidate
from rlco.gap.search_state import Search
from rlco.physics.effects import AppliedEffect


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
