"""Seed the global generators of NumPy and Python, so that draws depend on a seed only.

robosuite's placement samplers, its noise on a robot's initial posture and the sizes of
its objects use these generators; the one held by its environments is not used.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


def seed_all(seed: int) -> None:
    """Seed the global generators, with a seed in [0, 2**32)."""
    np.random.seed(seed)  # noqa: NPY002
    random.seed(seed)


def peeked_seed() -> int:
    """Return a number that follows from the global generator's state, without a draw.

    It seeds what an episode draws later, and changes nothing that its reset draws.

    Example:
        >>> with seeded(3):
        ...     first, again = peeked_seed(), peeked_seed()
        >>> with seeded(4):
        ...     first == again, first == peeked_seed()
        (True, False)
    """
    # robosuite's reset draws from this generator alone.
    _, words, place, *_ = np.random.get_state()  # noqa: NPY002
    return int(np.random.default_rng([*words, place]).integers(2**63))


@contextmanager
def seeded(seed: int = 0) -> Iterator[None]:
    """Seed the global generators temporarily, and restore them afterwards.

    Args:
        seed: In [0, 2**32).

    Example:
        >>> with seeded(3):
        ...     first = random.random()
        >>> with seeded(3):
        ...     first == random.random()
        True
    """
    ours, theirs = np.random.get_state(), random.getstate()  # noqa: NPY002
    seed_all(seed)
    try:
        yield
    finally:
        np.random.set_state(ours)  # noqa: NPY002
        random.setstate(theirs)
