"""A figure of success over the values of one variable of an experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rlco.reporting.experiments.entries import (
    Entry,
    domains_of,
    ends_of,
    found_runs,
    group_name,
    labels_of,
)
from rlco.reporting.plot_style import (
    caption,
    domain_titles,
    legend,
    new_figure,
    rate_axis,
    span,
    styles,
)
from rlco.reporting.statistics import Interval, mean_interval
from rlco.runs.compare.experiment import value_name

#: Success by method and value of the variable.
Points = Mapping[str, Mapping[str, Interval]]


def success_over(entries: Sequence[Entry], variable: str) -> dict[str, Figure]:
    """Draw each method's success over the values of a variable, a panel a domain.

    Means over seeds with Student's t interval of 95 %; joined by lines where the values
    are numbers. A method that always has one of the values is a dashed line. There is a
    figure for all values of the groups' other variables, by its name.

    Example:
        >>> row = {"domain": "sim", "successes": 3, "episodes": 4}
        >>> given = [
        ...     Entry("sft", f"demos {n}", 0, "done", (row,), values={"demos": n})
        ...     for n in (5, 20)
        ... ]
        >>> list(success_over(given, "demos"))
        ['']
    """
    figures = {}
    others = [
        {name: value for name, value in entry.values.items() if name != variable}
        for entry in entries
    ]
    for name in dict.fromkeys(map(group_name, others)):
        mine = [
            e for e, o in zip(entries, others, strict=True) if group_name(o) == name
        ]
        values = list(dict.fromkeys(entry.values[variable] for entry in mine))
        joined = all(isinstance(value, int | float) for value in values)
        found = {
            value: found_runs(e for e in mine if e.values[variable] == value)
            for value in (sorted(values) if joined else values)
        }
        domains = list(
            dict.fromkeys(d for runs in found.values() for d in domains_of(runs))
        )
        if not domains:
            continue
        title = f"Success over {variable}" + (f", {name}" if name else "")
        figure, panels = new_figure(title, len(domains), height=3.9)
        labels = labels_of(mine)
        fixed = {entry.label for entry in mine if variable in entry.always}
        domain_titles(panels, domains)
        seeds: set[int] = set()  # a mean need not have all that others have
        for axes, domain in zip(panels, domains, strict=True):
            rates = {
                label: {
                    value_name(value): list(ends.values())
                    for value, runs in found.items()
                    if (ends := ends_of(runs.get(label, {}), domain))
                }
                for label in labels
            }
            seeds.update(len(each) for them in rates.values() for each in them.values())
            points = {
                label: {value: mean_interval(each) for value, each in them.items()}
                for label, them in rates.items()
                if them
            }
            names = [value_name(value) for value in found]
            _panel(axes, names, points, fixed, joined)
            axes.set_xlabel(variable)
        for axes in panels[1:]:
            axes.set_ylabel("")
        legend(figure, panels, aside=True)
        mean = f"Mean of {span(seeds)} seeds; line: its 95 % t interval."
        caption(figure, mean if max(seeds) > 1 else "One seed, so without intervals.")
        figures[name] = figure
    return figures


def _panel(
    axes: Axes, values: Sequence[str], points: Points, fixed: Set[str], joined: bool
) -> None:
    looks = styles(points)
    beside = [label for label in looks if label not in fixed]
    for label, (colour, marker) in looks.items():
        there = [value for value in values if value in points[label]]
        mean, low, high = np.transpose([points[label][value] for value in there])
        if label in fixed:
            axes.axhline(mean[0], color=colour, linestyle="--", label=label)
            continue
        aside = (beside.index(label) - (len(beside) - 1) / 2) * 0.5 / len(beside)
        x = np.array([values.index(value) + aside for value in there])
        axes.vlines(x, np.maximum(low, 0), np.minimum(high, 1), color=colour)
        axes.plot(
            x,
            mean,
            color=colour,
            marker=marker,
            markersize=5,
            linestyle="-" if joined else "",
            clip_on=False,  # a marker at 0 is whole
            label=label,
        )
    short = max(map(len, values)) * len(values) < 40
    slanted: dict[str, Any] = {"rotation": 30, "ha": "right", "rotation_mode": "anchor"}
    axes.set_xticks(range(len(values)), values, **({} if short else slanted))
    axes.set_xlim(-0.5, len(values) - 0.5)
    rate_axis(axes)
