"""What the gap workflow finds in data measured on four real mechanisms.

Run ``python benchmarks/gap_real.py [only=servo|cube|panda|g1]`` with OMP_NUM_THREADS=1.
It prints one markdown table, each number beside its target and beside what was known
before. The data lies in ``../shared/data/real`` and is not part of the project; a set
that is absent is skipped. Of each set a third, a gain or a half is held out.
"""

from __future__ import annotations

import sys
import time

import numpy as np
import real_arm
import real_data
import real_servo
import real_torques

from rlco.gap.compare.free_body import FreeBody, rms_by_phase
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.search.find_gap import find_gap

TOSS = 78 * real_data.CUBE_PERIOD  # seconds of a toss that are compared


def cube() -> list[real_data.Row]:
    """Toss an acrylic cube: which effect, and how far off on tosses never used."""
    tosses = range(285)
    # Every third toss judges; of the others every third, enough for the search.
    build = [i for i in tosses if i % 3 != 2][::3]
    model = real_data.cube_model()
    verdict = find_gap(FreeBody(model, real_data.cube(build), horizon=TOSS))
    judged = real_data.cube([i for i in tosses if i % 3 == 2])
    problem = FreeBody(model, judged, horizon=TOSS)
    pair = [Hypothesis(), verdict.hypothesis]
    away = problem.residuals(pair).reshape(2, -1, 3)
    before, after = 100.0 * np.linalg.norm(away, axis=2).mean(axis=1)
    phases = [rms_by_phase(problem, one) for one in pair]
    free, touching = (
        " -> ".join(f"{100.0 * phase[i]:.2f} cm" for phase in phases) for i in (0, 1)
    )
    return [
        ("named", real_data.said(verdict), "contact_friction, 0.16-0.20", "0.18"),
        ("held-out mean", f"{before:.2f} -> {after:.2f} cm", "7.7 -> 1.2", "1.10"),
        ("free flight, rms", free, "clean", "-"),
        ("from the first touch on, rms", touching, "the error is here", "-"),
    ]


SETS = {
    "servo": ("bam_xl330", real_servo.rows),
    "cube": ("cube_tosses", cube),
    "panda": ("panda_ur10_unisa", real_torques.rows),
    "g1": ("lerobot_g1", real_arm.rows),
}


def main(only: str = "") -> None:
    """Measure, and print the table."""
    print("| data | what | measured | target | known before |")
    print("|---|---|---|---|---|")
    for name, (folder, measure) in SETS.items():
        if only not in ("", name) or not real_data.present(folder):
            continue
        began = time.perf_counter()
        for row in measure():
            print(f"| {name} |", " | ".join(row), "|", flush=True)
        print(f"| {name} | seconds | {time.perf_counter() - began:.0f} | - | - |")


if __name__ == "__main__":
    main(**dict(argument.split("=", 1) for argument in sys.argv[1:]))
