"""The section on a torque of free form that does better than what was named."""

from __future__ import annotations

from html import escape

import mujoco
from matplotlib.figure import Figure

from rlco.gap.compare.verdict import FreeForm
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


_OF_ENCODERS = (
    "One wave a turn is a disc that is not centred; a step or a bend, a worn track. A "
    "constant and a slope hardly show, since the servo follows them."
)


def free_form_section(free: FreeForm | None, model: mujoco.MjModel | None) -> str:
    """Return what acts outside the library as HTML; empty where nothing does.

    Args:
        free: The torque.
        model: For the units of its joint; None for those of a hinge.
    """
    if free is None:
        return ""
    # A log of torques has residuals in N m, and positions in rad.
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    slides = model is not None and model.joint(free.target).type[0] == slide
    figure = free_form_figure(free, "m" if slides else "rad")
    alt = f"{figure.get_suptitle()}. {figure.get_label()}"
    return (
        "<h2>What acts besides, or instead</h2>\n"
        f"<p>{escape(outside_line(free))} What it looks like may tell you more than "
        "it tells the library.</p>\n" + html.figure(png(figure), alt)
    )


def free_form_figure(free: FreeForm, unit: str) -> Figure:
    """Draw a torque over position, velocity and time, an encoder's over position.

    Args:
        free: The torque or the error.
        unit: Of the joint's position, ``rad`` or ``m``.
    """
    torque = "force [N]" if unit == "m" else "torque [N m]"
    what = f"error of the encoder [{unit}]" if free.of_encoder else torque
    lines = {
        f"position [{unit}]": free.over_position,
        f"velocity [{unit}/s]": free.over_velocity,
        "time [s]": free.over_time,
    }
    lines = {word: line for word, line in lines.items() if line.size}
    title = f"Outside the library, at {free.target}"
    figure, panels = new_figure(title, len(lines), height=3.0)
    for axes, (word, (x, y)) in zip(panels, lines.items(), strict=True):
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
        axes.plot(x, y, color=CORRECTED, marker="o" if len(x) < 20 else None, ms=4)
        axes.set_xlabel(word)
    panels[0].set_ylabel(what)
    if free.of_encoder:
        caption(figure, f"By how much the encoder reads too much. {_OF_ENCODERS}")
        return figure
    caption(
        figure,
        "What the joint would have to be given besides. Over time, "
        f"recordings follow one another. {_HINTS}",
    )
    return figure
