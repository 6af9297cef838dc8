"""The most that options can be: beyond it no memory is enough, or no run ends.

They are far above what anybody trains with, so that a slip of the pen is said to be one
before anything starts.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from rlco.files import shown

#: Adam's first step is ten times the learning rate, which float32 must hold.
LARGEST_LR = 1e37
MOST_ROWS = 10**6  # of a batch
MOST_ENVS = 2**16  # in one process
LONGEST_EPISODE = 10**5  # [control steps]
LONGEST_CHUNK = 1000  # [control steps]
WIDEST_LAYER = 2**14
MOST_RECORDINGS, LONGEST_RECORDING = 100, 600  # of an arm: all at once; [s]
_MOST_WEIGHTS = 2**28  # a GB, and four with gradients and Adam's moments


def layers(widths: Sequence[int]) -> str | None:
    """Say why layers of these widths are too many weights; None where they are not.

    Example:
        >>> layers([256, 256])
        >>> layers(5 * [16384])
        '[16384, 16384, 16384, 16384, 16384] would have 1,073,741,824 weights, and at \
most 268,435,456 are taken'
    """
    weights = sum(wide * next_one for wide, next_one in pairwise(widths))
    if weights <= _MOST_WEIGHTS:
        return None
    return (
        f"{shown(list(widths))} would have {weights:,} weights, and at most "
        f"{_MOST_WEIGHTS:,} are taken"
    )
