"""Whether recordings distinguish what was named from what was hidden.

Where a search has to do without an effect, others may do the same to the robot, and no
search of these recordings could know. So held-out recordings are simulated by the
plant's own code, under the hidden effects and under the named ones. Encoder noise is
independent and Gaussian, of a known standard deviation s, so that twice the logarithm
of the two likelihoods' ratio is (S - S0) / s^2, with S and S0 the sums of squared
residuals of N numbers.

The named effects' values are first fitted to all recordings, from those answered. The
search's simulation and the plant differ by up to a step, and with thousands of rows
that alone would count as evidence; so would a value that the training recordings leave
open, where a held-out one depends on it more. What is left is what no value explains.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gap_arms import Array
from gap_baselines import Logged, hidden_of, residual, split
from gap_plant import Hidden
from scipy.optimize import least_squares

Row = Mapping[str, Any]
# Twice the logarithm of a Bayes factor above 10 is called very strong evidence (Kass
# and Raftery, 1995), and ln N is what the Bayesian information criterion charges for
# one parameter more, so that a difference that a further parameter could make is none.
_VERY_STRONG = 10.0
# Times act in whole steps here: no slope to follow.
_AS_ANSWERED = ("command_delay", "control_rate")
_EVALUATIONS = 8
_DIVERGED = np.pi  # root mean square [rad]


def evidence(logged: Logged, named: Sequence[Row], truth: Row) -> dict[str, float]:
    """Return twice the log-likelihood ratio of what was hidden to what was named.

    Args:
        logged: The case.
        named: Effects of an answer, each number with ``value``, ``low`` and ``high``.
        truth: With ``effects``, ``noise`` and ``quantum``.

    Returns:
        ``evidence``, which is large where the hidden effects do better held out, and
        ``numbers``, how many were compared. Empty where the plant diverges with what
        was named, as with a spring too stiff for its steps: that is no evidence.
    """
    _, held = split(len(logged.positions))
    hidden = hidden_of(truth["effects"])
    sums = [
        residual(logged, effects, held, parts=True) ** 2
        for effects in (refitted(logged, named), hidden)
    ]
    if not sums[0].mean() < _DIVERGED**2:
        return {}
    variance = truth["noise"] ** 2 + truth["quantum"] ** 2 / 12
    ratio = (sums[0].sum() - sums[1].sum()) / variance
    return {"evidence": float(ratio), "numbers": len(sums[1])}


def distinguishable(result: Row) -> bool | None:
    """Return whether the evidence of a result suffices; None where it has none.

    Example:
        >>> [distinguishable({"evidence": x, "numbers": 5400}) for x in (18.5, 18.7)]
        [False, True]
    """
    if "evidence" not in result:
        return None
    return bool(result["evidence"] > _VERY_STRONG + math.log(result["numbers"]))


def refitted(logged: Logged, named: Sequence[Row]) -> tuple[Hidden, ...]:
    """Return named effects with values that leave least, near those answered."""
    every = range(len(logged.positions))
    free = [
        (number, name, *_range(value))
        for number, effect in enumerate(named)
        if effect["name"] not in _AS_ANSWERED
        for name, value in effect["parameters"].items()
    ]
    start = np.array([value for _, _, value, *_ in free])
    scale, low, high = np.array([row[3:] for row in free]).reshape(-1, 3).T

    def at(values: Array) -> tuple[Hidden, ...]:
        rows = [
            {**e, "parameters": {k: v["value"] for k, v in e["parameters"].items()}}
            for e in named
        ]
        for (number, name, *_), value in zip(free, values, strict=True):
            rows[number]["parameters"][name] = float(value)
        return hidden_of(rows)

    if not free:
        return at(start)
    # One, not zero, is where a value is as answered: steps are relative to it.
    best = least_squares(
        lambda x: residual(logged, at(start + scale * (x - 1.0)), every, True),
        np.ones(len(free)),
        bounds=(1.0 + (low - start) / scale, 1.0 + (high - start) / scale),
        diff_step=0.05,
        max_nfev=_EVALUATIONS,
    )
    return at(start + scale * (best.x - 1.0))


def _range(answered: Mapping[str, float]) -> tuple[float, float, float, float]:
    """Return a value, the scale of its changes, and the least and largest tried."""
    value, width = answered["value"], answered["high"] - answered["low"]
    reach = 0.3 * abs(value) + 2.0 * width + 1e-9
    low, high = value - reach, value + reach
    # What cannot be negative, or positive, stays so.
    if answered["low"] >= 0.0:
        low = min(max(low, 0.1 * value), value)
    if answered["high"] <= 0.0:
        high = max(min(high, 0.1 * value), value)
    return value, 0.02 * abs(value) + 0.25 * width + 1e-9, low, high
