"""Combs: which small changes one rollout can measure the responses to.

An arm forgets a push, or a wrong command, within a fraction of a second. So one rollout
measures the responses to changes that are as far apart, and a few rollouts measure all.
"""

from __future__ import annotations

import numpy as np

from rlco.gap.compare.problem import Integers
from rlco.gap.logs.log import Array

REMEMBERED = 0.8  # time in which an arm forgets a change [s]


def combs_of(begins: Array, ends: Array) -> Integers:
    """Return in which rollout the response to each change is measured, (K,).

    Args:
        begins: When each begins to act, rising [s], (K,).
        ends: When each acts last [s], (K,).

    Example:
        >>> times = np.array([0.0, 0.5, 1.0, 1.5])
        >>> combs_of(times, times).tolist()
        [0, 1, 0, 1]
    """
    combs, free = np.zeros(len(begins), dtype=int), [-np.inf]
    for number, begin in enumerate(begins):
        comb = next((i for i, at in enumerate(free) if at <= begin + 1e-9), len(free))
        free[comb : comb + 1] = [ends[number] + REMEMBERED]
        combs[number] = comb
    return combs


def until(begins: Array, ends: Array, combs: Integers) -> Array:
    """Return until when the response to each change is its own, (K,) [s].

    Args:
        begins: When each begins to act, rising [s], (K,).
        ends: When each acts last [s], (K,).
        combs: In which rollout each is measured, (K,).

    Example:
        >>> times = np.array([0.0, 0.5, 1.0, 1.5])
        >>> until(times, times, np.array([0, 1, 0, 1])).tolist()
        [1.0, 1.5, 1.8, 2.3]
    """
    found = ends + REMEMBERED
    for comb in np.unique(combs):
        mine = np.flatnonzero(combs == comb)
        found[mine[:-1]] = begins[mine[1:]]
    return np.asarray(found)
