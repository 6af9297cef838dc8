"""Write rlco/reporting/alignment/map.json, which align shows, from committed cells.

    uv run scripts/write_alignment_map.py

What a column's methods came to is in the cells of the experiments planar and alignment,
how much sim teaches of it in benchmarks/cells/alignment_shares.json, which
benchmarks/alignment_shares.py measures.
"""

from __future__ import annotations

import json
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from rlco.reporting.alignment.map import METHODS, Column, as_json
from rlco.reporting.experiments.entries import rates
from rlco.reporting.experiments.results import table_entries
from rlco.runs.compare.cells import Store
from rlco.runs.compare.jobs import expand
from rlco.runs.compare.reading.read_experiment import read_experiment
from rlco.runs.whole_files import write_text

ROOT = Path(__file__).parents[1]
BENCHMARKS = ROOT / "benchmarks"
MAP = ROOT / "rlco" / "reporting" / "alignment" / "map.json"
#: Task of a map: experiment, its cells, and what its table calls the last of METHODS.
MAPS = {
    "planar": ("planar", "planar", ("beta 0", "beta 0.2")),
    "push_cube": ("alignment", "push_cube", ("rl_only", "beta 0.2")),
}
#: Gaps whose names do not say what they are.
GAPS = {
    "rotation": "reported numbers rotated",
    "delay_gain": "another delay and gain",
}


def main() -> None:
    """Write the columns, one a line."""
    found = [column for task in MAPS for column in columns(task)]
    lines = ",\n".join(json.dumps(entry) for entry in as_json(found)["columns"])
    write_text(MAP, f'{{"columns": [\n{lines}\n]}}\n')
    print(f"{MAP.relative_to(ROOT)}: {len(found)} columns")


def columns(task: str) -> Iterator[Column]:
    """Yield the columns of a task's map."""
    name, cells, last = MAPS[task]
    methods = dict(zip((*METHODS[:-2], *last), METHODS, strict=True))
    experiment = read_experiment(BENCHMARKS / "experiments" / f"{name}.yaml")
    with tempfile.TemporaryDirectory() as out:
        store = Store(Path(out), BENCHMARKS / "cells" / cells, "any")
    success: dict[str, dict[str, dict[int, float]]] = defaultdict(
        lambda: defaultdict(dict)
    )
    for entry in table_entries(experiment, expand(experiment), store):
        if entry.label not in methods:
            continue
        column = entry.group.split()[-1]
        for row in entry.rows:
            if row["domain"] != "sim":
                found = success[column][methods[entry.label]]
                found[int(entry.seed)] = rates(row).end
    for column, by_method in success.items():
        gap = column if task == "planar" else f"yaw{column}"
        crosses = shares(task, gap)
        yield Column(
            task,
            in_words(gap),
            [crosses[seed] for seed in sorted(crosses)],
            {
                method: [by_method[method][seed] for seed in sorted(crosses)]
                for method in METHODS
            },
        )


def shares(task: str, column: str) -> dict[int, float]:
    """Return how much sim teaches of a column, by seed."""
    path = BENCHMARKS / "cells" / "alignment_shares.json"
    return {
        int(row["seed"]): float(row["cross"])
        for row in json.loads(path.read_text("utf-8"))
        if (row["map"], row["column"]) == (task, column)
    }


def in_words(gap: str) -> str:
    """Return a gap as a sentence has it."""
    if gap in GAPS:
        return GAPS[gap]
    return f"camera turned by {gap.removeprefix('yaw')} degrees"


if __name__ == "__main__":
    main()
