"""Signals for a report, simulated once: before, after, and the best few seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rlco.gap.compare.problem import Hypothesis, Problem
from rlco.gap.compare.verdict import NamedEffect, Verdict
from rlco.gap.diagnose.regimes import Labels
from rlco.gap.diagnose.where import Where, where
from rlco.gap.logs.log import Array

#: What figures call the model before and after its own numbers were fitted.
AS_IS, REFITTED = "the model as it is", "its own numbers fitted"
#: The same of one that was calibrated, and with what earlier recordings tell of it.
CALIBRATED, KNOWN = "the calibrated model", "as known before"
#: What was simulated over all recordings, where that is not the nominal model.
MODELS = {CALIBRATED: "calibrated model", KNOWN: "model as known before"}
_SECONDS = 4.0
_RECORDINGS = 6  # maximum number searched


@dataclass(frozen=True)
class Stretch:
    """A time window of one channel, measured and simulated.

    Attributes:
        recording: Its recording's name.
        channel: Its channel's name.
        unit: The unit of all signals.
        time: Times of the rows [s], (T,).
        measured: Measured signal, (T,).
        nominal: Simulated by the model before, (T,).
        corrected: Simulated with all named effects; None where nothing was named, (T,).
    """

    recording: str
    channel: str
    unit: str
    time: Array
    measured: Array
    nominal: Array
    corrected: Array | None


@dataclass(frozen=True)
class FigureData:
    """Disagreement of simulation and measurement, before and after.

    Attributes:
        before: With the model without effects, over all recordings.
        after: With all named effects; None where nothing was named.
        heldout_before: As `before`, over the held-out recordings (all, if none is).
        heldout_after: As `after`, over those.
        stretches: For each named effect the window where it helps most, otherwise the
            one with the largest disagreement.
        nominal: What held-out recordings and stretches show before: the model as it
            is, with its own parameters fitted, or with what was known.
    """

    before: Where
    after: Where | None
    heldout_before: Where
    heldout_after: Where | None
    stretches: tuple[Stretch, ...]
    nominal: str = AS_IS


def figure_data(
    problem: Problem, verdict: Verdict, before: Where, labels: Sequence[Labels]
) -> FigureData:
    """Simulate the signals that a report shows.

    Args:
        problem: The robot's model and log.
        verdict: The result of the search.
        before: Disagreement of the model without effects, over all recordings.
        labels: The regimes of every recording.
    """
    if verdict.instability is not None:
        return FigureData(before, None, before, None, ())
    heldout = verdict.heldout or None
    nominal, corrected = judged_with(problem, verdict)

    def compared(
        hypotheses: Sequence[Hypothesis], recordings: Sequence[int] | None
    ) -> Where:
        one_for_all = verdict.held_out is None
        simulated = hypotheses[0] if one_for_all else hypotheses
        return where(problem, simulated, labels=labels, recordings=recordings)

    named = bool(verdict.effects)
    return FigureData(
        before=before,
        after=compared(corrected, None) if named else None,
        heldout_before=compared(nominal, heldout),
        heldout_after=compared(corrected, heldout) if named else None,
        stretches=tuple(best_stretches(problem, verdict)),
        nominal=_nominal(verdict),
    )


def _nominal(verdict: Verdict) -> str:
    if verdict.held_out is not None:
        return REFITTED
    if verdict.calibrated:
        return CALIBRATED
    return KNOWN if verdict.since_reference else AS_IS


def best_stretches(problem: Problem, verdict: Verdict) -> list[Stretch]:
    """Return for each named effect the held-out window where it helps most.

    An effect's help is the decrease of the squared error when it is added to the other
    named effects. Where nothing was named, the window with the largest disagreement.
    """
    every = range(len(problem.log.recordings))
    recordings = (verdict.heldout or tuple(every))[:_RECORDINGS]
    nominal, corrected = judged_with(problem, verdict)
    if not verdict.effects:
        squares = _squares(problem, nominal, recordings)
        place = _largest(problem, recordings, squares)
        return [_stretch(problem, *place, nominal[place[0]], None)]
    remaining = _squares(problem, corrected, recordings)
    found = []
    for finding in verdict.effects:
        without = [_without(one, finding) for one in corrected]
        squares = _squares(problem, without, recordings)
        gains = [
            before - after for before, after in zip(squares, remaining, strict=True)
        ]
        place = _largest(problem, recordings, gains)
        pair = nominal[place[0]], corrected[place[0]]
        found.append(_stretch(problem, *place, *pair))
    return found


def judged_with(
    problem: Problem, verdict: Verdict
) -> tuple[list[Hypothesis], list[Hypothesis]]:
    """Return what each recording is simulated with, before and after."""
    if verdict.held_out is not None:
        return verdict.held_out.hypotheses()
    count = len(problem.log.recordings)
    return [Hypothesis()] * count, [verdict.hypothesis] * count


def _without(hypothesis: Hypothesis, finding: NamedEffect) -> Hypothesis:
    """Return a hypothesis without one of its effects."""
    others = tuple(
        effect
        for effect in hypothesis.effects
        if (effect.name, effect.target) != (finding.name, finding.target)
    )
    return replace(hypothesis, effects=others)


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
    before: Hypothesis,
    corrected: Hypothesis | None,
) -> Stretch:
    nominal = problem.traces(before, recording)
    better = problem.traces(corrected, recording) if corrected else None
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
    problem: Problem, hypotheses: Sequence[Hypothesis], recordings: Sequence[int]
) -> list[Array]:
    found = []
    for recording in recordings:
        trace = problem.traces(hypotheses[recording], recording)
        squares = (trace["measured"] - trace["simulated"]) ** 2
        # A simulation that diverged has no meaning.
        found.append(np.where(np.isfinite(squares), squares, 0.0))
    return found


def _weights(problem: Problem) -> Array:
    """Return each channel's weight, which puts radians and metres in units of noise."""
    noise = np.asarray(problem.noise, dtype=float)
    return np.ones_like(noise) if len(set(problem.layout.units)) == 1 else noise**-2
