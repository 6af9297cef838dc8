"""The seconds of a recording that show an effect best, of all joints at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rlco.gap.compare.problem import Problem
from rlco.gap.compare.verdict import Verdict
from rlco.gap.diagnose.traces import Stretch, judged_with
from rlco.gap.logs.log import Array
from rlco.physics.effects.targets import joints


@dataclass(frozen=True)
class Filmed:
    """Joint positions of a few seconds, measured and simulated.

    Attributes:
        recording: The recording's name.
        heldout: Whether it was held out of the fit.
        joints: Names of the joints.
        shown: Index of the joint in which the effect shows best.
        unit: Its unit, ``rad`` or ``m``.
        time: Times of the rows [s], (T,).
        measured: Measured, (T, joints), [rad or m].
        nominal: Simulated by the model before, (T, joints).
        corrected: Simulated with all named effects; None where nothing was named.
    """

    recording: str
    heldout: bool
    joints: tuple[str, ...]
    shown: int
    unit: str
    time: Array
    measured: Array
    nominal: Array
    corrected: Array | None


def filmed(
    problem: Problem, verdict: Verdict, stretches: Sequence[Stretch]
) -> Filmed | str | None:
    """Return what a film of a report shows, or why there is nothing to film.

    Args:
        problem: The robot's model and log.
        verdict: The result of the search.
        stretches: The windows that its figures show, of which a film shows the first;
            none where nothing was simulated.
    """
    if not stretches:
        return None
    stretch = stretches[0]
    layout = problem.layout
    known = joints(problem.model)
    if not set(layout.channels) <= set(known) or not set(layout.units) <= {"rad", "m"}:
        return (
            "There is no film: joint positions were not compared here, and a film "
            "shows nothing else."
        )
    names = [recording.name for recording in problem.log.recordings]
    index = names.index(stretch.recording)
    before, after = (found[index] for found in judged_with(problem, verdict))
    traces = problem.traces(before, index)
    rows = (traces["time"] >= stretch.time[0]) & (traces["time"] <= stretch.time[-1])
    corrected = None
    if verdict.effects:
        corrected = problem.traces(after, index)["simulated"][rows]
    found = Filmed(
        stretch.recording,
        index in verdict.heldout,
        layout.channels,
        layout.channels.index(stretch.channel),
        stretch.unit,
        traces["time"][rows],
        traces["measured"][rows],
        traces["simulated"][rows],
        corrected,
    )
    tracks = (found.measured, found.nominal, found.corrected)
    if not all(one is None or np.isfinite(one).all() for one in tracks):
        return "There is no film: the simulation diverges in the seconds to show."
    return found
