"""Cut a task's recordings where simulations restart from the measurement.

A restart in a contact is a blow: the estimated state is a fraction of a millimetre too
far into it, or too far away. So a segment goes on until nothing touches.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rlco.gap.logs.log import Recording

Mask = NDArray[np.bool_]

RUN_IN = 4  # rows after which an arm has forgotten its initial velocity
_FEWEST = 2  # rows of a segment
_LONGEST = 3  # times the usual length, after which a segment ends in a contact


@dataclass(frozen=True)
class Segment:
    """Rows `first` to `last` of a recording, simulated from `first`.

    The arm's velocity there comes from simulating the rows from `begin` on.
    """

    recording: int
    begin: int
    first: int
    last: int


def segments_of(
    index: int,
    recording: Recording,
    period: float,
    length: int | None,
    touching: Mask,
) -> list[Segment]:
    """Cut a recording into segments of about `length` rows, without gaps in time.

    A segment ends where nothing touches, nor did during the run-in before. Where there
    is no such row within half a length of its usual end, it goes on.

    Args:
        index: Of the recording.
        recording: The recording.
        period: Of a control step [s].
        length: Usual number of rows; None for segments as long as there are no gaps.
        touching: Where something touches or an object moves, (T,).

    Example:
        >>> log = Recording("a", np.arange(25.0))
        >>> for pushed in (np.zeros(25, bool), np.arange(25) == 14):
        ...     found = segments_of(0, log, 1.0, 10, pushed)
        ...     print([(one.first, one.last) for one in found])
        [(4, 14), (14, 24)]
        [(4, 13), (13, 24)]
    """
    gaps = np.flatnonzero(np.diff(recording.time) > 1.5 * period) + 1
    found = []
    for begin, end in zip([0, *gaps], [*gaps, recording.rows], strict=True):
        first, last = int(begin) + RUN_IN, int(end) - 1
        if last - first < _FEWEST:
            continue
        edges = [first, last]
        if length is not None:
            edges[1:1] = _inner_edges(touching, first, last, length)
        found += [Segment(index, int(begin), *pair) for pair in pairwise(edges)]
    return found


def _inner_edges(touching: Mask, first: int, last: int, length: int) -> list[int]:
    """Return rows between two at which segments of about equal length end.

    Args:
        touching: Whether something touches or an object moves, (T,).
        first: The first row.
        last: The last row.
        length: Usual number of rows of a segment.
    """
    count = max(1, round((last - first) / length))
    usual = np.linspace(first, last, count + 1)[1:-1].round().astype(int).tolist()
    edges = [first]
    for edge in usual:
        around = range(edge - length // 2, edge + length // 2 + 1)
        free = [
            row
            for row in around
            if edges[-1] + _FEWEST <= row <= last - _FEWEST
            and not touching[row - RUN_IN : row + 1].any()
        ]
        if free:
            edges.append(min(free, key=lambda row: abs(row - edge)))
        elif edge - edges[-1] >= _LONGEST * length:
            edges.append(edge)
    return edges[1:]
