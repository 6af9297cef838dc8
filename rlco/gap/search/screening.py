"""Screening: the change that a typical size of each effect would cause.

One simulation for each parameter and start gives columns. The share of the residual in
their span is a linear estimate of what fitting the effect would explain, for hundreds
of effects at the cost of a few fits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rlco.gap.compare.problem import Candidate
from rlco.gap.logs.log import Array
from rlco.gap.search.fit import Library, Whiten, with_values
from rlco.physics.effects import AppliedEffect

_LEAST = 0.05  # fraction of a typical size that a fit starts with


@dataclass(frozen=True)
class Screening:
    """The change caused by one start of an effect.

    Attributes:
        candidate: The effect and its target.
        values: The simulated parameter values, (parameters,).
        neutral: Values without effect, (parameters,).
        columns: Change of the whitened residual, orthonormal, (directions, N).
        first: The change caused by the start itself, not normalised, (N,).
        one_sided: Whether only a positive amount of `first` makes sense.
    """

    candidate: Candidate
    values: Array
    neutral: Array
    columns: Array
    first: Array
    one_sided: bool


def screen_effects(
    library: Library,
    candidates: Sequence[Candidate],
    present: tuple[AppliedEffect, ...],
    residual: Array,
    whiten: Whiten,
) -> list[Screening]:
    """Simulate each start of each candidate, added to the effects that are present.

    Args:
        library: Parameters of each candidate.
        candidates: Those to screen.
        present: Effects that act already.
        residual: Their whitened residual, (N,).
        whiten: Whitened residuals of many lists of effects, (lists, N).
    """
    plans: list[tuple[Candidate, Array, list[Array]]] = []
    for candidate in candidates:
        plans += [(candidate, *plan) for plan in _plans(library, candidate)]
    lists = [
        present + with_values(library, [candidate], values)
        for candidate, _, rows in plans
        for values in rows
    ]
    if not lists:
        return []
    changes = whiten(lists) - residual
    screenings, at = [], 0
    for candidate, values, rows in plans:
        change = changes[at : at + len(rows)]
        at += len(rows)
        # The first row is the start; the others change one parameter each.
        change = np.concatenate([change[:1], change[1:] - change[:1]])
        sizes = np.linalg.norm(change, axis=1)
        if not np.isfinite(sizes).all() or sizes[0] == 0.0:
            continue
        known = library[candidate]
        neutral = np.array([p.neutral for p in known])
        columns = orthonormal(change[sizes > 1e-9 * sizes.max()])
        one_sided = known[0].low >= known[0].neutral
        screenings.append(
            Screening(candidate, values, neutral, columns, change[0], one_sided)
        )
    return screenings


def _plans(library: Library, candidate: Candidate) -> list[tuple[Array, list[Array]]]:
    """Return the starts of an effect, each with the rows of values to simulate."""
    known = library[candidate]
    plans = []
    for start in known[0].starts:
        values = np.array([start] + [p.starts[0] for p in known[1:]])
        rows = [values]
        for i, parameter in enumerate(known[1:], 1):
            changed = values.copy()
            span = parameter.high - parameter.low
            changed[i] = parameter.starts[-1]
            if changed[i] == values[i]:
                changed[i] += 0.15 * span
            rows.append(changed)
        plans.append((values, rows))
    return plans


def orthonormal(columns: Array) -> Array:
    """Return orthonormal directions with the same span as rows, (directions, N)."""
    basis, triangle = np.linalg.qr(columns.T)
    size = np.abs(np.diag(triangle))
    return np.ascontiguousarray(basis[:, size > 1e-6 * size.max()].T)


def explained(one: Screening, residual: Array, beside: Array) -> float:
    """Return the linear decrease of a residual's mean square by a screening.

    Args:
        one: The screening.
        residual: The residual to explain, (N,), orthogonal to `beside`.
        beside: Orthonormal directions that are explained already, (directions, N).
    """
    columns = one.columns
    if len(beside):
        columns = columns - (columns @ beside.T) @ beside
        size = np.linalg.norm(columns, axis=1)
        columns = columns[size > 1e-3]
        if not len(columns):
            return 0.0
        columns = orthonormal(columns)
    along = columns @ residual
    if one.one_sided and one.first @ residual > 0.0 and len(columns) == 1:
        return 0.0
    return float(along @ along) / len(residual)


def start_of(
    library: Library, one: Screening, residual: Array
) -> tuple[AppliedEffect, ...]:
    """Return a screened effect, with its best-fitting amount as the start of a fit.

    Args:
        library: Parameters of each candidate.
        one: The screening.
        residual: The whitened residual without the effect, (N,).
    """
    amount = -float(one.first @ residual) / float(one.first @ one.first)
    amount = float(np.clip(amount, -3.0, 3.0))
    known = library[one.candidate]
    low, high = np.array([(p.low, p.high) for p in known]).T
    neutral, away = one.neutral[0], one.values[0] - one.neutral[0]
    # At its neutral value an effect's other parameters have no gradient. The same holds
    # if the sign that would help is not allowed.
    if not low[0] <= neutral + _LEAST * amount * away <= high[0]:
        amount = _LEAST
    elif abs(amount) < _LEAST:
        amount = float(np.copysign(_LEAST, amount))
    if not known[0].scales:
        amount = 1.0
    values = one.values.copy()
    values[0] = neutral + amount * away
    return with_values(library, [one.candidate], np.clip(values, low, high))
