"""Describe the unexplained residual: its largest channel and its correlations."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from rlco.gap.compare.problem import Hypothesis, Problem
from rlco.gap.logs.log import Array

REPORTED = 0.3  # a lower correlation is not reported


def describe_residual(
    problem: Problem, hypothesis: Hypothesis, residual: Array
) -> tuple[str, str]:
    """Return the channel with most of a residual, and a note on its correlation.

    Args:
        problem: Robot and log; each of its recordings is simulated once.
        hypothesis: The effects assumed.
        residual: Measured minus simulated under it, of all recordings, (N,).
    """
    layout, channels = problem.layout, problem.layout.channels
    rows = residual / problem.noise[layout.channel]
    sizes = [
        float(np.mean(rows[layout.channel == i] ** 2)) for i in range(len(channels))
    ]
    worst = int(np.argmax(sizes))
    part = sizes[worst] / max(sum(sizes), 1e-300)
    signal, strength = _best_correlated(problem, hypothesis, worst)
    note = f"{part:.0%} of the residual is in {channels[worst]}"
    if strength > REPORTED:
        note += f"; it correlates with {signal} (correlation {strength:.2f})"
    else:
        note += "; it correlates with none of the logged signals"
    return channels[worst], note


def _best_correlated(
    problem: Problem, hypothesis: Hypothesis, channel: int
) -> tuple[str, float]:
    """Return the signal that a channel's residual is most correlated with."""
    columns: dict[str, list[Array]] = {}
    residuals, position = [], []
    for index in range(len(problem.log.recordings)):
        traces = problem.traces(hypothesis, index)
        residuals.append((traces["measured"] - traces["simulated"])[:, channel])
        position.append(traces["measured"][:, channel])
        for name, signal in _signals(traces, channel).items():
            columns.setdefault(name, []).append(signal)
    residual = np.concatenate(residuals)
    best = ("", 0.0)
    for name, parts in columns.items():
        strength = _correlation(np.concatenate(parts), residual)
        if strength > best[1]:
            best = (name, strength)
    binned = _binned(np.concatenate(position), residual)
    return max(
        best,
        ("the joint's position, periodically or not", binned),
        key=lambda pair: pair[1],
    )


def _signals(traces: Mapping[str, Array], channel: int) -> dict[str, Array]:
    signals = {"time": traces["time"] - traces["time"][0]}
    for key, name in (
        ("velocity", "speed"),
        ("acceleration", "acceleration"),
        ("torque", "the torque against gravity"),
    ):
        if key in traces:
            signals[name] = traces[key][:, channel]
    if "velocity" in traces:
        signals["the direction of motion"] = np.sign(traces["velocity"][:, channel])
    if "command" in traces:
        far = traces["command"] - traces["measured"]
        signals["the distance to the command"] = far[:, channel]
    return signals


def _correlation(one: Array, other: Array) -> float:
    fine = np.isfinite(one) & np.isfinite(other)
    one, other = one[fine] - one[fine].mean(), other[fine] - other[fine].mean()
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return abs(float(one @ other)) / size if size > 0 else 0.0


def _binned(position: Array, residual: Array) -> float:
    """Return the root of the variance share explained by twenty bins of position."""
    edges = np.quantile(position, np.linspace(0, 1, 21)[1:-1])
    bin_of = np.searchsorted(edges, position)
    counts = np.maximum(np.bincount(bin_of, minlength=20), 1)
    means = np.bincount(bin_of, weights=residual, minlength=20) / counts
    between = float(np.var(means[bin_of]))
    return float(np.sqrt(between / max(float(np.var(residual)), 1e-300)))
