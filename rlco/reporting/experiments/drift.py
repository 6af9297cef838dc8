"""How far policies drift from demonstrations that they were never trained on."""

from __future__ import annotations

from collections.abc import Sequence

from rlco.reporting.experiments.comparison import row_of
from rlco.reporting.experiments.entries import Entry
from rlco.reporting.plots import Drift
from rlco.reporting.statistics import Interval, mean_interval

#: The column of metrics.csv, see `rlco.training.held_out`.
DRIFT = "drift_heldout"


def drifts_of(entries: Sequence[Entry]) -> list[Drift]:
    """Return the drift of each method of one group that has one.

    Seeds that were evaluated at other steps than the first are left out.
    """
    found = []
    for label in dict.fromkeys(entry.label for entry in entries):
        runs = {
            entry.seed: [row for row in entry.curve if DRIFT in row]
            for entry in entries
            if entry.label == label
        }
        runs = {seed: rows for seed, rows in runs.items() if rows}
        if not runs:
            continue
        frames = [row["frames"] for row in next(iter(runs.values()))]
        alike = {
            seed: [row[DRIFT] for row in rows]
            for seed, rows in runs.items()
            if [row["frames"] for row in rows] == frames
        }
        found.append(Drift(label, frames, list(alike.values()), list(alike)))
    return found


def drift_table(
    entries: Sequence[Entry], differences: Sequence[tuple[str, str]]
) -> str:
    """Return the drift at the end, and the differences of methods paired by seed.

    Means over seeds with Student's t interval of 95 %, a line a group, in Markdown; ""
    where no run had demonstrations held out.
    """
    groups = {
        group: {
            one.method: {
                seed: drift[-1]
                for seed, drift in zip(one.seeds, one.drift, strict=True)
            }
            for one in drifts_of([e for e in entries if e.group == group])
        }
        for group in dict.fromkeys(entry.group for entry in entries)
    }
    labels = list(dict.fromkeys(label for found in groups.values() for label in found))
    if not labels:
        return ""
    pairs = [pair for pair in differences if set(pair) <= {*labels}]
    head = ["drift at the end", *labels, *(f"{a} - {b}" for a, b in pairs)]
    lines = ["\n## Drift\n", row_of(head), "|---" * len(head) + "|"]
    for group, found in groups.items():
        cells = [_number(list(found.get(label, {}).values())) for label in labels]
        for first, second in pairs:
            one, other = found.get(first, {}), found.get(second, {})
            cells.append(
                _number([one[seed] - other[seed] for seed in one if seed in other], "+")
            )
        lines.append(row_of([group or "held-out demonstrations", *cells]))
    note = (
        "Of the most likely actions on demonstrations that were held out, since before "
        "RL: RMS; 1 is half of the range that normalisation maps to [-1, 1]."
    )
    return "\n".join(lines) + f"\n\n{note}\n"


def _number(values: Sequence[float], sign: str = "") -> str:
    if not values:
        return "-"
    mean: Interval = mean_interval(values)
    if len(values) == 1:
        return f"{mean.estimate:{sign}.3f}"
    return f"{mean.estimate:{sign}.3f} [{mean.low:{sign}.3f}, {mean.high:{sign}.3f}]"
