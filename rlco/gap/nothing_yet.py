"""What can be said of a search that was interrupted before it had tried anything."""

from __future__ import annotations

import numpy as np

from rlco.gap.problem import Gap, Hypothesis, Problem, Verdict

NOTE = "Nothing was searched: it was ended before any effect was fitted."


def nothing_yet(problem: Problem) -> Verdict:
    """Return a verdict that names nothing: the disagreement as it is."""
    left = problem.residuals([Hypothesis()])[0]
    noise = np.asarray(problem.noise)[problem.layout.channel]
    units = set(problem.layout.units)
    unit = units.pop() if len(units) == 1 else "mixed"
    size = float(np.sqrt(np.mean(left**2)))
    floor = float(np.sqrt(np.mean(noise**2)))
    return Verdict(
        complete=False,
        verdict="unexplained",
        effects=(),
        gap=Gap(unit, size, size, size, size, floor),
        unexplained={"share": 1.0, "target": None, "note": NOTE},
        closest=(),
        seconds=0.0,
        hypothesis=Hypothesis(),
        train=tuple(range(len(problem.log.recordings))),
        heldout=(),
    )
