"""The figure of a prediction: what a method gains where another succeeds."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure

from rlco.reporting.experiments.rank_correlation import Runs
from rlco.reporting.plot_style import (
    INK,
    QUIET,
    caption,
    domain_label,
    new_figure,
)
from rlco.reporting.statistics import mean_interval


def prediction_figure(
    groups: Mapping[str, Runs], gain: tuple[str, str], success: str, domain: str
) -> Figure:
    """Draw a method's gain over another beside the success of a third.

    The groups are in the order of that success. One seed alone has no interval.

    Args:
        groups: By what a table is of, the runs' success and gain, both in [0, 1].
        gain: The two methods, first minus second.
        success: The third.
        domain: Where all three are counted.
    """
    figure, (left, right) = new_figure("Gain and success", 2, height=4.2)
    rising = sorted(groups, key=lambda name: mean_interval(groups[name].x).estimate)
    for axes, which in ((left, 0), (right, 1)):
        for row, name in enumerate(rising):
            mean, low, high = (
                100 * value for value in mean_interval(groups[name][which])
            )
            reach = [[mean - low], [high - mean]]
            axes.errorbar(mean, row, xerr=reach, fmt="o", color=INK, capsize=3)
        axes.set_yticks(range(len(rising)), rising if axes is left else [])
        axes.set_ylim(-0.6, len(rising) - 0.4)
        axes.grid(axis="x", color="#e6e6e6", linewidth=0.8)
    left.set_xlim(-2, 102)
    left.set_xlabel(f"success of {success} [%]")
    right.axvline(0, color=QUIET, linewidth=1)
    right.set_xlabel(f"{gain[0]} - {gain[1]} [points]")
    caption(
        figure,
        f"Counted in {domain_label(domain)}. Means over seeds with Student's t "
        "intervals of 95 %, those of the difference paired by seed.",
    )
    return figure
