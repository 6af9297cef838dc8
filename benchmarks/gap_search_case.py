"""One case searched, in a process of its own that never sees its truth.

    python benchmarks/gap_search_case.py FOLDER [exclude=coulomb_friction,...]

FOLDER holds ``data/`` and ``model.xml``, or ``model.txt`` with the name of a task
(``robosuite:push_cube``). Prints one line of JSON.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rlco.gap.compare.verdict import Verdict
from rlco.gap.logs import read_log
from rlco.gap.make_problem import make_problem
from rlco.gap.model import load_model
from rlco.gap.search.find_gap import find_gap
from rlco.gap.search.verdict import DOUBT


def search(folder: Path, exclude: Sequence[str] = ()) -> dict[str, Any]:
    """Return what is found in a case, in the form of ``report.json``."""
    named = folder / "model.txt"
    model = named.read_text().strip() if named.exists() else folder / "model.xml"
    loaded = load_model(model)
    log = read_log(folder / "data", loaded)
    # Reading and compiling count; importing and numba's compiler do not.
    began = time.perf_counter()
    verdict = find_gap(make_problem(loaded, log), exclude=exclude)
    return answer(verdict) | {"seconds": round(time.perf_counter() - began, 1)}


def answer(verdict: Verdict) -> dict[str, Any]:
    """Return what is judged of a verdict."""
    gap = verdict.gap
    effects = [
        {
            "name": finding.name,
            "target": finding.target,
            "parameters": {
                name: {"value": value.value, "low": value.low, "high": value.high}
                for name, value in finding.parameters.items()
            },
            "rivals": [{"name": r.name, "target": r.target} for r in finding.rivals],
        }
        for finding in verdict.effects
    ]
    return {
        "verdict": verdict.verdict,
        "effects": effects,
        "gap": {
            "before": gap.before_heldout,
            "after": gap.after_heldout,
            "noise_floor": gap.noise_floor,
        },
        "unexplained": dict(verdict.unexplained),
        "doubts": verdict.free_form is not None
        or DOUBT in str(verdict.unexplained.get("note")),
        "outside": verdict.free_form and verdict.free_form.target,
        "closest": [[c.name, c.target, share] for c, share in verdict.closest],
    }


if __name__ == "__main__":
    given = dict(argument.split("=", 1) for argument in sys.argv[2:])
    names = [name for name in given.get("exclude", "").split(",") if name]
    print(json.dumps(search(Path(sys.argv[1]), names), default=str))
