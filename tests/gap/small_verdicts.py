"""Verdicts on the small arm, with numbers as a search would give them."""

from __future__ import annotations

import numpy as np
from small_problems import NOISE, Arm

from rlco.gap.compare.problem import Candidate, Hypothesis
from rlco.gap.compare.verdict import Gap, NamedEffect, Value, Verdict
from rlco.physics.effects import AppliedEffect

FRICTION = AppliedEffect("coulomb_friction", "elbow", {"frictionloss": 0.6})
DAMPING = AppliedEffect("viscous_damping", "shoulder", {"damping": 0.6})
TRAIN, HELDOUT = (0, 1), (2,)


def gap_of(problem: Arm, hypothesis: Hypothesis) -> Gap:
    def rms(which: Hypothesis, recordings: tuple[int, ...]) -> float:
        return float(np.sqrt(np.mean(problem.residuals([which], recordings) ** 2)))

    sizes = [rms(h, r) for h in (Hypothesis(), hypothesis) for r in (TRAIN, HELDOUT)]
    return Gap("rad", *sizes, noise_floor=NOISE)


def named(problem: Arm, verdict: str = "named") -> Verdict:
    """Both effects named, the friction with a rival where it is ambiguous."""
    rivals = (Candidate("load_friction", "elbow"),) if verdict == "ambiguous" else ()
    friction = NamedEffect(
        "coulomb_friction",
        "elbow",
        {"frictionloss": Value(0.6, 0.57, 0.63, "N m")},
        rivals,
        {"load_friction elbow": 0.01, "backlash elbow": 0.42},
    )
    damping = NamedEffect(
        "viscous_damping", "shoulder", {"damping": Value(0.6, 0.52, 0.68, "N m s/rad")}
    )
    hypothesis = Hypothesis((FRICTION, DAMPING))
    return Verdict(
        complete=True,
        verdict=verdict,
        effects=(friction, damping),
        gap=gap_of(problem, hypothesis),
        unexplained={"share": 0.08, "target": "elbow", "note": "It grows with speed."},
        closest=((Candidate("armature", "elbow"), 0.2),),
        seconds=12.3,
        hypothesis=hypothesis,
        train=TRAIN,
        heldout=HELDOUT,
        trail=({"effects": (FRICTION,), "error": 3.25, "gain": 0.81, "taken": True},),
    )


def nothing_named(problem: Arm, verdict: str = "unexplained") -> Verdict:
    """Nothing named, with a candidate that came nearest."""
    return Verdict(
        complete=True,
        verdict=verdict,
        effects=(),
        # As if a fit that was given up had left this.
        gap=gap_of(problem, Hypothesis((FRICTION,))),
        unexplained={"share": 1.0, "target": "elbow", "note": "It follows nothing."},
        closest=((Candidate("armature", "elbow"), 0.2),),
        seconds=3.0,
        hypothesis=Hypothesis(),
        train=TRAIN,
        heldout=HELDOUT,
    )
