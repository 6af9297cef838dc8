"""What stays unexplained: how much, where, and what it goes with."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from rlco.gap.log import Array
from rlco.gap.problem import Hypothesis, Problem
from rlco.physics.effects import AppliedEffect

TELLING = 0.3  # correlation below which nothing is said


def describe_left(
    problem: Problem, effects: tuple[AppliedEffect, ...], share: float
) -> Mapping[str, object]:
    """Return share, channel and a note on what is left, for a `Verdict`."""
    hypothesis = Hypothesis(effects)
    rows = problem.residuals([hypothesis])[0] / problem.noise[problem.layout.channel]
    channels = problem.layout.channels
    sizes = [
        float(np.mean(rows[problem.layout.channel == i] ** 2))
        for i in range(len(channels))
    ]
    worst = int(np.argmax(sizes))
    part = sizes[worst] / max(sum(sizes), 1e-300)
    signal, strength = _goes_with(problem, hypothesis, worst)
    note = f"{part:.0%} of what is left is in {channels[worst]}"
    if strength > TELLING:
        note += f"; it goes with {signal} (correlation {strength:.2f})"
    else:
        note += "; it goes with none of the logged signals"
    return {"share": share, "target": channels[worst], "note": note}


def _goes_with(
    problem: Problem, hypothesis: Hypothesis, channel: int
) -> tuple[str, float]:
    """The signal that what is left in a channel is most correlated with."""
    columns: dict[str, list[Array]] = {}
    left = []
    for index in range(len(problem.log.recordings)):
        traces = problem.traces(hypothesis, index)
        left.append((traces["measured"] - traces["simulated"])[:, channel])
        for name, signal in _signals(traces, channel).items():
            columns.setdefault(name, []).append(signal)
    residual = np.concatenate(left)
    best = ("", 0.0)
    for name, parts in columns.items():
        strength = _correlation(np.concatenate(parts), residual)
        if strength > best[1]:
            best = (name, strength)
    position = [
        problem.traces(hypothesis, i)["measured"][:, channel]
        for i in range(len(problem.log.recordings))
    ]
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
    """Square root of the share of variance between twenty bins of position."""
    edges = np.quantile(position, np.linspace(0, 1, 21)[1:-1])
    place = np.searchsorted(edges, position)
    counts = np.maximum(np.bincount(place, minlength=20), 1)
    means = np.bincount(place, weights=residual, minlength=20) / counts
    between = float(np.var(means[place]))
    return float(np.sqrt(between / max(float(np.var(residual)), 1e-300)))
