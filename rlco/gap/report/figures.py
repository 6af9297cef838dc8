"""Figures of a gap report: bars before and after, heat maps, and traces."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from rlco.gap.compare.wording import number, scale_of
from rlco.gap.diagnose.traces import AS_IS, Stretch
from rlco.gap.diagnose.where import HeatMap
from rlco.gap.logs.log import Array
from rlco.reporting.plot_style import (
    INK,
    LINES,
    QUIET,
    WIDTH,
    caption,
    legend,
    new_figure,
    without_formulas,
)

_FEW = 9  # channels: so many leave room for numbers and names
_ROOM = 95  # letters that fit below the bars of a figure
_BESIDE_LEGEND = 34  # letters of a title that fit beside the legend
_BESIDE_AXIS = 22  # letters along half the height of a figure
# Okabe and Ito's palette: distinguishable with any colour vision.
MEASURED, NOMINAL, CORRECTED = "#222222", "#d55e00", "#009e73"


def gap_bars(
    channels: Sequence[str],
    units: Sequence[str],
    noise: Array,
    before: Array,
    after: Array | None,
    heldout: bool = True,
    nominal: str = AS_IS,
) -> Figure:
    """Draw the disagreement of each channel before and after, one panel per unit.

    Args:
        channels: Their names.
        units: Their units.
        noise: The noise floor of each, (channels,).
        before: Root mean square disagreement of each with the model, (channels,).
        after: The same with the corrected model; None where nothing was named.
        heldout: Whether these recordings were held out of all fits.
        nominal: The legend's name for the model of `before`.
    """
    kinds = list(dict.fromkeys(units))
    # Names are never shortened: horizontal where there is room, else rotated.
    lengths = [
        sum(
            len(name) + 2
            for name, unit in zip(channels, units, strict=True)
            if unit == k
        )
        for k in kinds
    ]
    rotated = len(kinds) * max(lengths) > _ROOM
    figure, panels = new_figure(
        "Held-out recordings" if heldout else "All recordings",
        len(kinds),
        height=3.8 if rotated else 3.2,
    )
    for axes, kind in zip(panels, kinds, strict=True):
        here = [i for i, unit in enumerate(units) if unit == kind]
        shown, factor = scale_of(kind)
        sizes = [(nominal, NOMINAL, before)]
        if after is not None:
            sizes.append(("corrected", CORRECTED, after))
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
        axes.set_xticks(range(len(here)), [channels[i] for i in here])
        if rotated:
            for tick in axes.get_xticklabels():
                tick.set(rotation=40, ha="right", rotation_mode="anchor")
        axes.tick_params(axis="x", length=0)
        axes.set_ylabel(f"root mean square [{shown}]")
    legend(figure, panels)
    which = "Recordings held out of all fits. " if heldout else ""
    caption(figure, f"{which}Lines: the noise floor.")
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
        units: Their units; where they differ, colours are multiples of the noise.
        noise: The noise floor of each, (channels,).
        maps: Pairs of a heading and a map; all share one colour scale.
        heldout: The held-out recordings; marked.
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
    images = [each.rms * np.array(scales)[:, None] for _, each in maps]
    # One jerk must not wash out everything else.
    top = float(np.nanquantile(images[0], 0.99))
    for axes, (heading, each), image in zip(panels, maps, images, strict=True):
        axes.grid(visible=False)
        axes.set_title(heading, fontsize=10, color=INK, loc="left")
        axes.set_facecolor("#dddddd")
        image = axes.pcolormesh(
            each.edges, np.arange(len(channels) + 1), image, cmap="magma_r"
        )
        image.set_clim(0.0, top or 1.0)
        axes.invert_yaxis()
        axes.set_yticks(np.arange(len(channels)) + 0.5, channels)
        axes.tick_params(axis="y", length=0)
        for start in each.starts[1:]:
            axes.axvline(start, color="white", linewidth=1.2)
        _mark_heldout(axes, each, heldout)
    panels[-1].set_xlabel("time, all recordings one after the other [s]")
    bar = figure.colorbar(image, ax=panels, fraction=0.03, pad=0.02, extend="max")
    bar.set_label(f"root mean square [{label}]", fontsize=9)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=8, color=LINES)
    caption(figure, "White lines: a new recording. Green: held out of all fits.")
    return figure


def trace_figure(stretch: Stretch, heading: str, nominal: str = AS_IS) -> Figure:
    """Draw a stretch as measured, simulated and corrected, with its residual.

    Args:
        stretch: The stretch to draw.
        heading: The figure's title.
        nominal: The legend's name for the model of its `nominal`.
    """
    words = textwrap.wrap(heading, _BESIDE_LEGEND)
    height = 3.7 + 0.2 * len(words)
    title = "\n".join(words)
    figure, (above, below) = new_figure(title, 2, height=height, stacked=True)
    unit, factor = scale_of(stretch.unit, float(np.abs(stretch.measured).max()))
    fine, finer = scale_of(stretch.unit)
    lines = [(nominal, NOMINAL, stretch.nominal)]
    if stretch.corrected is not None:
        lines.append(("corrected", CORRECTED, stretch.corrected))
    measured = factor * stretch.measured
    above.plot(stretch.time, measured, color=MEASURED, lw=2.4, label="measured")
    below.axhline(0.0, color=MEASURED, linewidth=1.0)
    for label, colour, simulated in lines:
        above.plot(stretch.time, factor * simulated, color=colour, lw=1.2, label=label)
        residual = finer * (stretch.measured - simulated)
        below.plot(stretch.time, residual, color=colour, lw=1.2)
    name = "\n".join(textwrap.wrap(stretch.channel, _BESIDE_AXIS))
    above.set_ylabel(f"{name}\n[{unit}]")
    below.set_ylabel(f"residual\n[{fine}]")
    below.set_xlabel("time [s]")
    for axes in (above, below):
        axes.yaxis.set_major_locator(MaxNLocator(5))
        axes.margins(x=0)
    legend(figure, [above])
    caption(figure, f"{stretch.channel}, recording {stretch.recording}.")
    return figure


def png(figure: Figure) -> bytes:
    """Return a figure as PNG, 1150 px wide."""
    buffer = io.BytesIO()
    without_formulas(figure)
    figure.savefig(buffer, format="png", dpi=1150 / WIDTH, facecolor="white")
    return buffer.getvalue()


def _mark_heldout(axes: Axes, each: HeatMap, heldout: Sequence[int]) -> None:
    ends = np.append(each.starts[1:], each.edges[-1])
    for recording in heldout:
        axes.plot(
            [each.starts[recording], ends[recording]],
            [1.02, 1.02],
            transform=axes.get_xaxis_transform(),
            color=CORRECTED,
            linewidth=3,
            clip_on=False,
            solid_capstyle="butt",
        )
