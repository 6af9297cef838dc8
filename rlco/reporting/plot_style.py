"""The style of rlco's figures: colours, labels and axes."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import (
    FuncFormatter,
    LogLocator,
    MaxNLocator,
    NullLocator,
    PercentFormatter,
)

INK, QUIET, LINES = "#222222", "#666666", "#bbbbbb"
#: The names of domains in figures.
DOMAIN_LABELS = {
    "sim": "sim (the simulator as built)",
    "stand_in": "stand_in (a second simulator, not a robot)",
    "locked": "locked (a third simulator, for final tables)",
}
#: Colour and marker of a method: Okabe and Ito's palette, distinguishable with any
#: colour vision, and markers for black-and-white print.
METHOD_STYLES = {
    "real_only": ("#7a7a7a", "s"),
    "sft": ("#0072b2", "o"),
    "rl_only": ("#e69f00", "^"),
    "rl_only_best": ("#d55e00", "v"),
    "rl_co": ("#009e73", "D"),
}
SAME_SCENE = "The same scene, as policies see it"
#: How to read each figure, by its title; reports print it beside the figure, in
#: this order.
READING = {
    "Success rate": (
        "Compare the methods within one simulator: where the black lines overlap "
        "much, it takes more episodes or seeds to separate two methods."
    ),
    "Success while learning": (
        "Reinforcement learning runs in one simulator only: sim, unless train_domain "
        "names another. Its gains there count only if success in stand_in does not "
        "fall."
    ),
    "Does the anchor pull?": (
        "At 1 the anchor pulls as hard as reinforcement learning does on average over "
        "a rollout; a line that reaches the top means that learning cannot be "
        "distinguished from noise there. If success in the robot's domain falls, raise "
        "real_coeff; if success in the simulator stands still and the anchor is above "
        "1, lower it. A cosine surely below 0 means that the two pull against each "
        "other."
    ),
    "Forgetting the demonstrations": (
        "A large drift with falling success means that reinforcement learning forgets "
        "the robot: raise real_coeff, or stop earlier. A drift alone is no harm."
    ),
    SAME_SCENE: (
        "No camera took these images: what plays the robot's part, such as stand_in, "
        "is a second simulator, not a robot, with other cameras, lights and colours."
    ),
    "One episode": "Time runs from left to right.",
}
#: Of other names: as many pairs as the product of their numbers, which share no factor.
_SPARE_COLOURS = ("#cc79a7", "#56b4e9", "#8c6d31", "#332288", "#882255", INK)
_SPARE_MARKERS = ("X", "P", "<", "*", ">")
WIDTH = 7.2  # [inch]: 720 px wide at 100 px per inch, for which text is sized


def new_figure(
    title: str, panels: int, *, height: float, stacked: bool = False
) -> tuple[Figure, list[Axes]]:
    """Make a figure of equal panels, side by side or stacked over one x axis."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    shape: dict[str, Any] = (
        {"nrows": panels, "sharex": True} if stacked else {"ncols": panels}
    )
    axes: list[Axes] = list(figure.subplots(squeeze=False, **shape).flat)
    figure.suptitle(title, x=0.01, ha="left", fontsize=13, color=INK, weight="bold")
    for each in axes:
        each.spines[["top", "right"]].set_visible(False)
        each.spines[["left", "bottom"]].set_color(LINES)
        each.tick_params(labelsize=9, color=LINES, labelcolor=INK, which="both")
        each.grid(axis="y", color="#e6e6e6", linewidth=0.8)
        each.set_axisbelow(True)
    return figure, axes


def styles(methods: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Give each method a colour and a marker, in the order of the comparison.

    Example:
        >>> list(styles(["rl_co", "mine", "sft"]))
        ['sft', 'rl_co', 'mine']
    """
    given = dict.fromkeys(methods)
    known = {name: look for name, look in METHOD_STYLES.items() if name in given}
    others = [name for name in given if name not in known]
    spare = zip(
        itertools.cycle(_SPARE_COLOURS), itertools.cycle(_SPARE_MARKERS), strict=False
    )
    return known | dict(zip(others, spare, strict=False))


def domain_label(domain: str, *, lines: int = 1) -> str:
    """Return a domain's name and meaning, on one line or two."""
    label = DOMAIN_LABELS.get(domain, domain)
    return label.replace(" (", "\n(", 1) if lines == 2 else label


def domain_titles(panels: Sequence[Axes], domains: Sequence[str]) -> None:
    """Write over each panel whose success it has, no wider than the panel."""
    width = max(8, 74 // len(panels))  # [letters]
    for axes, domain in zip(panels, domains, strict=False):
        lines = domain_label(domain, lines=2).split("\n")
        text = "\n".join(textwrap.fill(line, width) for line in lines)
        axes.set_title(text, fontsize=10, color=INK)


def span(counts: Iterable[int]) -> str:
    """Return a count that all have, or the smallest and the largest of several.

    Example:
        >>> span([5, 3, 5]), span([5, 5])
        ('3 to 5', '5')
    """
    every = list(counts)
    fewest, most = min(every), max(every)
    return f"{most}" if fewest == most else f"{fewest} to {most}"


def rate_axis(axes: Axes) -> None:
    """Make y a success rate from 0 to 100 %."""
    axes.set_ylim(0, 1.08)
    axes.set_yticks([0, 0.25, 0.5, 0.75, 1])
    axes.yaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))
    axes.set_ylabel("success rate")


def count_axis(axes: Axes, label: str) -> None:
    """Make x a count, thousands shortened."""
    axes.xaxis.set_major_locator(MaxNLocator(5, integer=True))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: _short(x)))
    axes.set_xlabel(label)


def log_axis(axes: Axes, label: str) -> None:
    """Make y logarithmic, with plain numbers at 1, 2 and 5."""
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:g}"))
    axes.set_ylabel(label)


def legend(figure: Figure, axes: Iterable[Axes], *, aside: bool = False) -> None:
    """Put each label beside the title, or beside the panels, once."""
    named = {
        label: handle
        for each in axes
        for handle, label in zip(*each.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        named.values(),
        named.keys(),
        loc="outside right upper" if aside else "outside upper right",
        ncols=1 if aside else min(5, len(named)),
        frameon=False,
        fontsize=10,
        handlelength=1.4,
        columnspacing=1.4,
    )


def caption(figure: Figure, text: str) -> None:
    """Write a caption under a figure, and keep it as the figure's label."""
    figure.set_label(text)
    figure.supxlabel(
        textwrap.fill(text, 112), x=0.01, ha="left", fontsize=8.5, color=QUIET
    )


def without_formulas(figure: Figure) -> None:
    """Draw every text as it stands: names with dollar signs are no formulas.

    Call it last. What matplotlib cannot read as a formula ends in an error otherwise.
    """
    for text in figure.findobj(Text):
        text.set_parse_math(False)


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, 1440 px wide, with its title and caption inside."""
    path.parent.mkdir(parents=True, exist_ok=True)
    without_formulas(figure)
    title, *group = figure.get_suptitle().split("\n")
    about = {
        "Title": ", ".join([title, *group]),
        "Description": str(figure.get_label()),
        "Comment": READING.get(title, ""),
    }
    figure.savefig(path, dpi=200, facecolor="white", metadata=about)


def _short(count: float) -> str:
    for size, letter in ((1e6, "M"), (1e3, "k")):
        if count >= size:
            return f"{count / size:g}{letter}"
    return f"{count:g}"
