"""Draws from NumPy's and Python's global generators, made to depend on a seed alone.

robosuite's placement samplers, its noise on a robot's first posture and the sizes of
its objects come from these; the generator that its environments hold is not used.
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


@contextmanager
def seeded(seed: int = 0) -> Iterator[None]:
    """Seed the global generators for a while, and put them back as they were.

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
