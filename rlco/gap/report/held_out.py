"""The section on recordings that were held out in turn."""

from __future__ import annotations

from html import escape

import numpy as np
from matplotlib.figure import Figure

from rlco.gap.compare.verdict import HeldOut, Verdict
from rlco.gap.compare.wording import amount, number, scale_of
from rlco.gap.report.figures import CORRECTED, NOMINAL, png
from rlco.reporting import html
from rlco.reporting.plot_style import QUIET, caption, legend, new_figure


def held_out_section(verdict: Verdict) -> str:
    """Return the errors of each held-out group as HTML; empty where there are none."""
    held_out = verdict.held_out
    if held_out is None:
        return ""
    head = ["held out", "recordings", "as published", "own parameters fitted"]
    head += ["with the effects"] if verdict.effects else []
    rows = [
        _row(
            group.label,
            len(group.recordings),
            (group.nominal, group.before, group.after),
            held_out.unit,
        )
        for group in held_out.groups
    ]
    means = (held_out.nominal, held_out.before, held_out.after)
    count = sum(len(group.recordings) for group in held_out.groups)
    rows.append(_row("mean", count, means, held_out.unit))
    figure = held_out_bars(held_out, named=bool(verdict.effects))
    alt = f"{figure.get_suptitle()}. {figure.get_label()}"
    return (
        "<h2>Held out in turn</h2>\n"
        + html.table(head, [row[: len(head)] for row in rows])
        + html.figure(png(figure), alt)
        + '<p class="quiet">Mean absolute errors. The published parameters may have '
        "been fitted to these very recordings; the other columns are of fits without "
        "the held-out ones.</p>"
    )


def held_out_bars(held_out: HeldOut, *, named: bool) -> Figure:
    """Draw the error of each held-out group, before and after.

    Args:
        held_out: The groups and their errors.
        named: Whether effects were named; else only the bars before are drawn.
    """
    figure, (axes,) = new_figure("Error on held-out recordings", 1, height=2.8)
    unit, factor = scale_of(held_out.unit, held_out.before)
    before = [group.before for group in held_out.groups]
    sizes = [("own parameters fitted", NOMINAL, before)]
    if named:
        after = [group.after for group in held_out.groups]
        sizes.append(("with the effects", CORRECTED, after))
    width = 0.8 / len(sizes)
    for offset, (label, colour, values) in enumerate(sizes):
        x = np.arange(len(values)) + (offset - (len(sizes) - 1) / 2) * width
        heights = factor * np.array(values)
        bars = axes.bar(x, heights, width, color=colour, label=label)
        texts = [number(value) for value in heights]
        axes.bar_label(bars, texts, fontsize=7.5, color=QUIET, padding=1)
    axes.margins(y=0.12)
    axes.set_xticks(range(len(before)), [group.label for group in held_out.groups])
    axes.tick_params(axis="x", length=0)
    axes.set_ylabel(f"mean absolute error [{unit}]")
    legend(figure, [axes])
    caption(figure, "Each bar is of recordings held out of its fit.")
    return figure


def _row(
    label: str, count: int, errors: tuple[float, float, float], unit: str
) -> list[str]:
    return [escape(label), str(count), *(escape(amount(one, unit)) for one in errors)]
