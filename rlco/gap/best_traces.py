"""The few seconds that show an effect best: where it improves the simulation most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rlco.gap.log import Array
from rlco.gap.problem import Hypothesis, Problem, Verdict

_SECONDS = 4.0
_RECORDINGS = 6  # looked through at most


@dataclass(frozen=True)
class Stretch:
    """A stretch of one channel, measured and simulated.

    Attributes:
        recording: Its recording's name.
        channel: Its channel's name.
        unit: The unit of all signals.
        time: Times of the rows [s], (T,).
        measured: What was measured, (T,).
        nominal: The model as it is, (T,).
        mended: The model with all named effects; None where nothing was named, (T,).
    """

    recording: str
    channel: str
    unit: str
    time: Array
    measured: Array
    nominal: Array
    mended: Array | None


def best_stretches(problem: Problem, verdict: Verdict) -> list[Stretch]:
    """Return for each named effect the held-out stretch where it helps most.

    It helps by what all named effects leave less than all but this one. Where nothing
    was named, the one stretch with the largest disagreement.
    """
    every = range(len(problem.log.recordings))
    recordings = (verdict.heldout or tuple(every))[:_RECORDINGS]
    if not verdict.effects:
        squares = _squares(problem, Hypothesis(), recordings)
        return [_stretch(problem, *_largest(problem, recordings, squares), None)]
    mended = verdict.hypothesis
    left = _squares(problem, mended, recordings)
    found = []
    for finding in verdict.effects:
        others = tuple(
            effect
            for effect in mended.effects
            if (effect.name, effect.target) != (finding.name, finding.target)
        )
        without = _squares(problem, replace(mended, effects=others), recordings)
        gains = [before - after for before, after in zip(without, left, strict=True)]
        found.append(_stretch(problem, *_largest(problem, recordings, gains), mended))
    return found


def _largest(
    problem: Problem, recordings: Sequence[int], gains: Sequence[Array]
) -> tuple[int, int, slice]:
    """Return the recording, channel and rows of the window with the largest gain."""
    weights = _weights(problem)
    best, place = -np.inf, (0, 0, slice(0))
    for recording, gain in zip(recordings, gains, strict=True):
        time = problem.log.recordings[recording].time
        rows = max(2, round(_SECONDS / float(np.median(np.diff(time)))))
        rows = min(rows, len(gain))
        sums = np.cumsum(np.concatenate([np.zeros((1, gain.shape[1])), gain]), axis=0)
        windows = (sums[rows:] - sums[:-rows]) * weights
        if windows.max() > best:
            best = windows.max()
            start, channel = np.unravel_index(int(windows.argmax()), windows.shape)
            place = recording, int(channel), slice(int(start), int(start) + rows)
    return place


def _stretch(
    problem: Problem,
    recording: int,
    channel: int,
    rows: slice,
    mended: Hypothesis | None,
) -> Stretch:
    nominal = problem.traces(Hypothesis(), recording)
    better = problem.traces(mended, recording) if mended else None
    return Stretch(
        problem.log.recordings[recording].name,
        problem.layout.channels[channel],
        problem.layout.units[channel],
        nominal["time"][rows],
        nominal["measured"][rows, channel],
        nominal["simulated"][rows, channel],
        None if better is None else better["simulated"][rows, channel],
    )


def _squares(
    problem: Problem, hypothesis: Hypothesis, recordings: Sequence[int]
) -> list[Array]:
    found = []
    for recording in recordings:
        trace = problem.traces(hypothesis, recording)
        squares = (trace["measured"] - trace["simulated"]) ** 2
        # A simulation that diverged shows nothing.
        found.append(np.where(np.isfinite(squares), squares, 0.0))
    return found


def _weights(problem: Problem) -> Array:
    """Radians and metres cannot be compared: each then counts in its own noise."""
    noise = np.asarray(problem.noise, dtype=float)
    return np.ones_like(noise) if len(set(problem.layout.units)) == 1 else noise**-2
