"""Figures of Stage II's progress, from the metrics of its runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from rlco.reporting import plots
from rlco.runs.metrics import read_metrics

Rows = list[dict[str, float]]


def draw_stages(
    runs: dict[str, Path], domains: Sequence[str], plots_folder: Path, *, episodes: int
) -> None:
    """Draw success, forgetting and gradients over the course of Stage II.

    Args:
        runs: The run directory of each method.
        domains: The domains of the evaluations.
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
    errors = {
        method: _columns(table, ("frames", "imitation_error_heldout"))
        for method, table in tables.items()
    }
    if curves:
        plots.save_figure(plots.learning_curves(curves), plots_folder / "curves.png")
        figure = plots.imitation_error({k: (v[0], v[1]) for k, v in errors.items()})
        plots.save_figure(figure, plots_folder / "forgetting.png")
    names = ("step", "grad_norm_sim", "grad_norm_real", "grad_cosine")
    for table in tables.values():
        steps, *terms = _columns(table, names)
        if steps:
            figure = plots.gradient_terms(steps, *terms)
            plots.save_figure(figure, plots_folder / "gradients.png")


def _curve(method: str, domain: str, table: Rows, episodes: int) -> plots.Curve:
    frames, success = _columns(table, ("frames", f"success_{domain}"))
    return plots.Curve(method, domain, frames, [success], episodes)


def _columns(table: Rows, names: Iterable[str]) -> list[list[float]]:
    """Return columns over the rows that have all of them."""
    names = tuple(names)
    rows = [row for row in table if set(names) <= row.keys()]
    return [[row[name] for row in rows] for name in names]
