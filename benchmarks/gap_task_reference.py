"""What changed between two sets of demonstrations of a robosuite task.

    python benchmarks/gap_task_reference.py out=outputs/gap_task_reference

Run it with OMP_NUM_THREADS=1. A joint of the plant is not as in the simulator. The
scripted expert is recorded, something in the plant changes, and it is recorded again,
with other starts, other motion and other noise. The workflow is that of
``find_gap.py model=robosuite:TASK reference=BEFORE data=AFTER``. The plant is that of
`gap_task_cases`, results and table are those of `gap_reference`: started again it goes
on where it was.

Seeds below 1000 are for development; the benchmark's begin at 23000.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import gap_task_cases as demos
import numpy as np
from gap_changes import Case, Config, Row, named, row_of, run, true
from gap_plant import Hidden

from rlco.gap.workflow import run_gap
from rlco.run import run_recipe
from rlco.runs.config import option

BENCHMARK_SEED = 23000
_SINGLE = (
    ("push_cube", "object_mass"),
    ("push_cube", "contact_friction"),
    ("push_cube", "viscous_damping"),
    ("push_cube", "coulomb_friction"),
    ("push_cube", "actuator_gain"),
    ("push_cube", "command_delay"),
    ("pick_and_place", "viscous_damping"),
    ("open_drawer", "slide_friction"),
)
_NONE = ("push_cube", "push_cube", "pick_and_place", "open_drawer")
_BEFORE = ("viscous_damping", "coulomb_friction", "actuator_gain")


@dataclass
class TaskConfig(Config):
    """Options of gap_task_reference.py."""

    out: str = option("outputs/gap_task_reference", "folder; finished cases are kept")
    seed: int = option(BENCHMARK_SEED, "seed of the first case", minimum=0)


def plan(first_seed: int) -> list[Case]:
    """Return all cases: 8 single changes, 4 of nothing.

    Example:
        >>> [sum(c.group == g for c in plan(0)) for g in ("single", "none")]
        [8, 4]
    """
    cases = []
    for task, name in (*_SINGLE, *((task, "none") for task in _NONE)):
        seed = first_seed + 2 * len(cases)  # the next is that of the later set
        group, effects = ("none", ()) if name == "none" else ("single", (name,))
        title = f"{group}_{task}_{name}_{seed}"
        cases.append(Case(title, group, task, effects, torques=False, seed=seed))
    return cases


def drawn(case: Case) -> tuple[tuple[Hidden, ...], tuple[Hidden, ...]]:
    """Return what the simulator lacks from the start, and what changes.

    Example:
        >>> before, change = drawn(plan(0)[2])
        >>> [one.name for one in (*before, *change)]
        ['actuator_gain', 'viscous_damping']
        >>> before[0].target != change[0].target
        True
    """
    random = np.random.default_rng(case.seed)
    first, other = (f"robot0_joint{n}" for n in random.permutation(range(1, 7))[:2])
    lacking = _BEFORE[case.seed // 2 % len(_BEFORE)]
    before = (_hidden(lacking, first, case.arm, random),)
    change = tuple(_hidden(one, other, case.arm, random) for one in case.effects)
    return before, change


def _hidden(name: str, joint: str, task: str, random: np.random.Generator) -> Hidden:
    """Draw the size of an effect, as `gap_task_cases.plan` does."""
    size = partial(demos.size, random)
    numbers: dict[str, tuple[str, str | None, str, float]] = {
        "viscous_damping": (name, joint, "damping", size(8, 24)),
        "coulomb_friction": (name, joint, "frictionloss", size(2, 6)),
        "actuator_gain": (name, joint, "factor", size(0.75, 0.9)),
        "object_mass": (name, demos.PUSHED, "factor", size(2.5, 5.0)),
        "contact_friction": (name, None, "friction", size(0.12, 0.25)),
        "command_delay": (name, None, "delay", 0.05 * float(random.integers(1, 3))),
        "slide_friction": ("coulomb_friction", demos.SLIDE, "frictionloss", size(2, 6)),
    }
    effect, target, parameter, value = numbers[name]
    return Hidden(effect, target, {parameter: value})


def run_case(case: Case) -> Row:
    """Record both sets, compare them, and return what was found beside the truth."""
    before, change = drawn(case)
    earlier = demos.play(demos.Case(case.name, case.arm, before, case.seed))
    with_change = demos.Case(case.name, case.arm, (*before, *change), case.seed + 1)
    later, shows = demos.play(with_change), 0.0
    if change:
        without = demos.Case(case.name, case.arm, before, case.seed + 1)
        shows = demos.apart(later, demos.play(without, later))
    began, cpu = time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        reference, data = Path(folder) / "before", Path(folder) / "after"
        demos.write_demonstrations(reference, case.arm, earlier)
        demos.write_demonstrations(data, case.arm, later)
        finding = run_gap(
            f"robosuite:{case.arm}", data, reference=reference, film=False
        )
    summary, known = finding.calibration, finding.before
    return row_of(case, finding.verdict, change, shows) | {
        "lacking": true(before),
        "found_before": named(summary.lacking) if summary is not None else [],
        "unknown": known.unknown.tolist() if known is not None else [],
        "seconds": round(time.perf_counter() - began, 1),
        "cpu": round(time.process_time() - cpu, 1),
    }


def main(config: TaskConfig) -> None:
    """Run the cases that are not there yet, and print the table."""
    run(config, plan(config.seed), run_case)


if __name__ == "__main__":
    run_recipe(main, TaskConfig)
