"""Figures of a gap report: before and after, over time and joint, the best traces."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from rlco.gap.best_traces import Stretch
from rlco.gap.log import Array
from rlco.gap.where import HeatMap
from rlco.gap.words import number, scale_of
from rlco.plot_style import INK, LINES, QUIET, WIDTH, caption, legend, new_figure

_FEW = 9  # channels, beside which numbers and names have room
# Okabe and Ito's palette: told apart with any colour vision.
MEASURED, NOMINAL, MENDED = "#222222", "#d55e00", "#009e73"


def gap_bars(
    channels: Sequence[str],
    units: Sequence[str],
    noise: Array,
    before: Array,
    after: Array | None,
    heldout: bool = True,
) -> Figure:
    """Draw the disagreement of each channel before and after, a panel for each unit.

    Args:
        channels: Their names.
        units: Their units.
        noise: The noise floor of each, (channels,).
        before: Root mean square disagreement of each with the model, (channels,).
        after: The same with the mended model; None where nothing was named.
        heldout: Whether these are recordings that no fit has seen.
    """
    kinds = list(dict.fromkeys(units))
    figure, panels = new_figure(
        "Held-out recordings" if heldout else "All recordings", len(kinds), height=3.2
    )
    for axes, kind in zip(panels, kinds, strict=True):
        here = [i for i, unit in enumerate(units) if unit == kind]
        shown, factor = scale_of(kind)
        sizes = [("the model as it is", NOMINAL, before)]
        if after is not None:
            sizes.append(("mended", MENDED, after))
        width = 0.8 / len(sizes)
        for offset, (label, colour, values) in enumerate(sizes):
            x = np.arange(len(here)) + (offset - (len(sizes) - 1) / 2) * width
            bars = axes.bar(x, factor * values[here], width, color=colour, label=label)
            if len(here) <= _FEW:
                texts = [number(factor * values[i]) for i in here]
                axes.bar_label(bars, texts, fontsize=7.5, color=QUIET, padding=1)
        for at, i in enumerate(here):
            floor = [factor * noise[i]] * 2
            axes.plot([at - 0.45, at + 0.45], floor, color=INK, lw=1.2, label="noise")
        axes.margins(y=0.12)
        axes.set_xticks(range(len(here)), [_short(channels[i]) for i in here])
        if len(here) > _FEW:
            axes.tick_params(axis="x", rotation=45)
        axes.tick_params(axis="x", length=0)
        axes.set_ylabel(f"root mean square [{shown}]")
    legend(figure, panels)
    seen = "Recordings that no fit has seen. " if heldout else ""
    caption(figure, f"{seen}Lines: the noise floor.")
    return figure


def heat_map(
    channels: Sequence[str],
    units: Sequence[str],
    noise: Array,
    maps: Sequence[tuple[str, HeatMap]],
    heldout: Sequence[int],
) -> Figure:
    """Draw the disagreement over time and channel, one map below the other.

    Args:
        channels: Their names.
        units: Their units; where they differ, colours count multiples of the noise.
        noise: The noise floor of each, (channels,).
        maps: A heading and a map each, with one colour scale for all.
        heldout: The recordings that were not fitted; marked.
    """
    height = 1.1 + len(maps) * (0.5 + 0.2 * len(channels))
    figure, panels = new_figure(
        "Disagreement over time", len(maps), height=height, stacked=True
    )
    if len(set(units)) == 1:
        shown, factor = scale_of(units[0])
        scales, label = [factor] * len(channels), shown
    else:
        scales, label = list(1.0 / noise), "times the noise"
    pictures = [each.rms * np.array(scales)[:, None] for _, each in maps]
    # One jerk must not make all else look the same.
    top = float(np.nanquantile(pictures[0], 0.99))
    for axes, (heading, each), picture in zip(panels, maps, pictures, strict=True):
        axes.grid(visible=False)
        axes.set_title(heading, fontsize=10, color=INK, loc="left")
        axes.set_facecolor("#dddddd")
        image = axes.pcolormesh(
            each.edges, np.arange(len(channels) + 1), picture, cmap="magma_r"
        )
        image.set_clim(0.0, top or 1.0)
        axes.invert_yaxis()
        axes.set_yticks(np.arange(len(channels)) + 0.5, [_short(c) for c in channels])
        axes.tick_params(axis="y", length=0)
        for start in each.starts[1:]:
            axes.axvline(start, color="white", linewidth=1.2)
        _mark_heldout(axes, each, heldout)
    panels[-1].set_xlabel("time, all recordings one after the other [s]")
    bar = figure.colorbar(image, ax=panels, fraction=0.03, pad=0.02, extend="max")
    bar.set_label(f"root mean square [{label}]", fontsize=9)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=8, color=LINES)
    caption(figure, "White lines: a new recording. Green: not seen by any fit.")
    return figure


def trace_figure(stretch: Stretch, heading: str) -> Figure:
    """Draw a stretch as measured, as the model has it and mended; and what is left."""
    figure, (above, below) = new_figure(heading, 2, height=3.9, stacked=True)
    unit, factor = scale_of(stretch.unit, float(np.abs(stretch.measured).max()))
    fine, finer = scale_of(stretch.unit)
    lines = [("the model as it is", NOMINAL, stretch.nominal)]
    if stretch.mended is not None:
        lines.append(("mended", MENDED, stretch.mended))
    measured = factor * stretch.measured
    above.plot(stretch.time, measured, color=MEASURED, lw=2.4, label="measured")
    below.axhline(0.0, color=MEASURED, linewidth=1.0)
    for label, colour, simulated in lines:
        above.plot(stretch.time, factor * simulated, color=colour, lw=1.2, label=label)
        left = finer * (stretch.measured - simulated)
        below.plot(stretch.time, left, color=colour, lw=1.2)
    above.set_ylabel(f"{_short(stretch.channel)} [{unit}]")
    below.set_ylabel(f"what is left [{fine}]")
    below.set_xlabel("time [s]")
    for axes in (above, below):
        axes.yaxis.set_major_locator(MaxNLocator(5))
        axes.margins(x=0)
    legend(figure, [above])
    caption(figure, f"{stretch.channel} in {stretch.recording}.")
    return figure


def png(figure: Figure) -> bytes:
    """Return a figure as PNG, 1150 px wide."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=1150 / WIDTH, facecolor="white")
    return buffer.getvalue()


def _mark_heldout(axes: Axes, each: HeatMap, heldout: Sequence[int]) -> None:
    ends = np.append(each.starts[1:], each.edges[-1])
    for recording in heldout:
        axes.plot(
            [each.starts[recording], ends[recording]],
            [1.02, 1.02],
            transform=axes.get_xaxis_transform(),
            color=MENDED,
            linewidth=3,
            clip_on=False,
            solid_capstyle="butt",
        )


def _short(name: str) -> str:
    return textwrap.shorten(name, 16, placeholder="…") if " " in name else name[-16:]
