"""Figures of Stage II's progress, from the metrics of its runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from rlco.reporting import plots
from rlco.runs.metrics import read_metrics

Rows = list[dict[str, float]]
#: What metrics.csv has of the anchor: estimates and the ends of their intervals.
SIGNAL = tuple(
    f"{name}{end}"
    for name in ("anchor_strength", "anchor_cosine")
    for end in ("", "_low", "_high")
)


def draw_stages(
    runs: dict[str, Path], domains: Sequence[str], plots_folder: Path, *, episodes: int
) -> None:
    """Draw success, forgetting and gradients over the course of Stage II.

    Args:
        runs: The run directory of each method.
        domains: The domains of the evaluations; the last stands for the robot.
        plots_folder: Where ``curves.png``, ``forgetting.png`` and ``gradients.png``
            are written; the last is of the last method with an anchor.
        episodes: Number per evaluation.
    """
    tables = {name: read_metrics(path / "metrics.csv") for name, path in runs.items()}
    curves = [
        _curve(method, domain, table, episodes)
        for method, table in tables.items()
        for domain in domains
    ]
    if curves:
        plots.save_figure(plots.learning_curves(curves), plots_folder / "curves.png")
    drift = {m: _columns(t, ("frames", "drift_heldout")) for m, t in tables.items()}
    if any(frames for frames, _ in drift.values()):
        robot = domains[-1]
        success = {
            m: _columns(t, ("frames", f"success_{robot}")) for m, t in tables.items()
        }
        figure = plots.forgetting(_pairs(drift), _pairs(success), robot)
        plots.save_figure(figure, plots_folder / "forgetting.png")
    for table in tables.values():
        steps, *columns = _columns(table, ("step", *SIGNAL))
        if steps:
            figure = plots.anchor_strength(steps, columns[:3], columns[3:])
            plots.save_figure(figure, plots_folder / "gradients.png")


def _pairs(
    columns: dict[str, list[list[float]]],
) -> dict[str, tuple[list[float], list[float]]]:
    return {method: (x, y) for method, (x, y) in columns.items() if x}


def _curve(method: str, domain: str, table: Rows, episodes: int) -> plots.Curve:
    frames, success = _columns(table, ("frames", f"success_{domain}"))
    return plots.Curve(method, domain, frames, [success], episodes)


def _columns(table: Rows, names: Iterable[str]) -> list[list[float]]:
    """Return columns over the rows that have all of them."""
    names = tuple(names)
    rows = [row for row in table if set(names) <= row.keys()]
    return [[row[name] for row in rows] for name in names]
