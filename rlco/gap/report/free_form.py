"""The section on a torque of free form that does better than what was named."""

from __future__ import annotations

from html import escape

from matplotlib.figure import Figure

from rlco.gap.compare.problem import FreeForm
from rlco.gap.report.figures import CORRECTED, png
from rlco.gap.report.verdict_text import outside_line
from rlco.reporting import html
from rlco.reporting.plot_style import QUIET, caption, new_figure

_HINTS = (
    "A step where the velocity changes its sign is a friction; a slope over velocity, "
    "damping; a slope or a bend over position, a spring, a cable or weight; waves over "
    "position, cogging or gears; what changes over time alone, warmth, a drift or a "
    "knock."
)


def free_form_section(free: FreeForm | None, unit: str) -> str:
    """Return what acts outside the library as HTML; empty where nothing does.

    Args:
        free: The torque.
        unit: Of the joint's position.
    """
    if free is None:
        return ""
    figure = free_form_figure(free, unit)
    alt = f"{figure.get_suptitle()}. {figure.get_label()}"
    return (
        "<h2>What acts besides, or instead</h2>\n"
        f"<p>{escape(outside_line(free))} What it looks like may tell you more than "
        "it tells the library.</p>\n" + html.figure(png(figure), alt)
    )


def free_form_figure(free: FreeForm, unit: str) -> Figure:
    """Draw a torque over position, over velocity and over time.

    Args:
        free: The torque.
        unit: Of the joint's position, ``rad`` or ``m``.
    """
    torque = "force [N]" if unit == "m" else "torque [N m]"
    figure, panels = new_figure(f"Outside the library, at {free.target}", 3, height=3.0)
    lines = (free.over_position, free.over_velocity, free.over_time)
    words = (f"position [{unit}]", f"velocity [{unit}/s]", "time [s]")
    for axes, (x, y), word in zip(panels, lines, words, strict=True):
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
        axes.plot(x, y, color=CORRECTED, marker="o" if len(x) < 20 else None, ms=4)
        axes.set_xlabel(word)
    panels[0].set_ylabel(torque)
    caption(
        figure,
        "What the joint would have to be given besides. Over time, "
        f"recordings follow one another. {_HINTS}",
    )
    return figure
