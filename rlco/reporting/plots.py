"""Figures of a run's numbers: success, learning, gradients, forgetting.

Each function returns a matplotlib Figure without touching pyplot's global state;
:func:`save_figure` writes it as a PNG that carries its title and how to read it.
Every interval is a 95 % one. Nothing here draws a robot: ``stand_in`` is always
labelled as the second simulator that it is. Figures of images are in
:mod:`rlco.reporting.image_plots`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rlco.reporting.plot_style import (
    INK,
    QUIET,
    caption,
    count_axis,
    domain_label,
    domain_titles,
    legend,
    log_axis,
    new_figure,
    rate_axis,
    span,
    styles,
)
from rlco.reporting.plot_style import save_figure as save_figure
from rlco.reporting.statistics import (
    ResultRow,
    mean_interval,
    rate_interval,
    wilson_interval,
)


@dataclass(frozen=True)
class Curve:
    """Success of one method in one domain while it learns.

    Attributes:
        method: Its name.
        domain: Where it was evaluated.
        frames: Environment steps so far, summed over environments. Shape (K,).
        success: Success rate of every seed, in [0, 1]. Shape (seeds, K).
        episodes: Episodes behind each rate, for the interval of a single seed.
    """

    method: str
    domain: str
    frames: Sequence[float]
    success: Sequence[Sequence[float]]
    episodes: int


@dataclass(frozen=True)
class Drift:
    """A method's drift from held-out demonstrations while it learns.

    Attributes:
        method: Its name.
        frames: Environment steps so far, summed over environments. Shape (K,).
        drift: Of every seed, RMS of how far normalised actions have moved. Shape
            (seeds, K).
        seeds: Which those are.
    """

    method: str
    frames: Sequence[float]
    drift: Sequence[Sequence[float]]
    seeds: Sequence[object]


def success_bars(rows: Sequence[ResultRow]) -> Figure:
    """Draw the success rate of each method in each domain.

    One seed: Wilson's interval over episodes. Several: the mean over seeds with
    Student's t interval, and a dot for every seed.

    Example:
        >>> row = dict(task="push_cube", policy="gaussian", domain="stand_in")
        >>> row |= dict(method="sft", variation=None, seed=0, episodes=20, successes=17)
        >>> success_bars([row]).axes[0].get_ylabel()
        'success rate'
    """
    groups = list(dict.fromkeys((r["task"], r["domain"], r["variation"]) for r in rows))
    looks = styles(row["method"] for row in rows)
    figure, (axes,) = new_figure("Success rate", 1, height=3.9)
    width = 0.84 / len(looks)
    for i, (method, (colour, _)) in enumerate(looks.items()):
        for j, group in enumerate(groups):
            cell = [
                row
                for row in rows
                if (row["task"], row["domain"], row["variation"]) == group
                and row["method"] == method
            ]
            if cell:
                place = j + (i - (len(looks) - 1) / 2) * width
                _bar(axes, place, width, colour, cell)
    several_tasks = len({task for task, _, _ in groups}) > 1
    axes.set_xticks(
        range(len(groups)), [_group_label(*group, several_tasks) for group in groups]
    )
    axes.tick_params(axis="x", length=0)
    axes.set_xlim(-0.5, len(groups) - 0.5)
    rate_axis(axes)
    legend(figure, [axes])
    caption(figure, _bars_caption(rows))
    return figure


def learning_curves(
    curves: Sequence[Curve], drifts: Sequence[Drift] = (), *, group: str = ""
) -> Figure:
    """Draw success against environment steps, a panel a domain, a line a method.

    One more panel has the drift from held-out demonstrations, where there is any. The
    title names the group of runs that the curves are of, if it is given.

    Several seeds: the mean, Student's t interval of it as a band, and the worst
    seed (the one that ends lowest) dotted. One seed: Wilson's interval as the band.

    Raises:
        ValueError: A curve whose seeds and frames do not fit together.
    """
    domains = list(dict.fromkeys(curve.domain for curve in curves))
    looks = styles(curve.method for curve in curves)
    shown = len(domains) + bool(drifts)
    title = f"Success while learning\n{group}".rstrip()
    figure, panels = new_figure(title, shown, height=3.9)
    domain_titles(panels, domains)
    for axes, domain in zip(panels, domains, strict=False):
        for curve in curves:
            if curve.domain == domain:
                _curve(axes, curve, *looks[curve.method])
        rate_axis(axes)
        count_axis(axes, "environment steps")
    for axes in panels[1:]:
        axes.set_ylabel("")
    if drifts:
        _drifts(panels[-1], drifts, looks)
    legend(figure, panels)
    seeds = [len(curve.success) for curve in curves]
    interval = "t interval of that mean" + (", of one seed Wilson's" * (1 in seeds))
    band = (
        f"Line: mean of {span(seeds)} seeds; band: 95 % {interval}; dotted: the seed "
        "that ends lowest."
        if max(seeds) > 1
        else "Line: one seed; band: 95 % Wilson interval."
    )
    episodes = span(curve.episodes for curve in curves)
    text = f"{band} Each point: {episodes} episodes a seed."
    if drifts:
        text += (
            " Drift: RMS of how far the most likely actions have moved on held-out "
            "demonstrations; 1 is half of the actions' range."
        )
    caption(figure, text)
    return figure


def anchor_strength(
    rollouts: Sequence[float],
    strength: Sequence[Sequence[float]],
    cosine: Sequence[Sequence[float]],
) -> Figure:
    """Draw the anchor against PPO's mean gradient over the rollouts, with intervals.

    Args:
        rollouts: Rollouts so far. Shape (K,).
        strength: The anchor's gradient norm over that of PPO's mean: the estimate, and
            the low and high ends of its interval. Shape (3, K); NaN where PPO's mean
            cannot be distinguished from 0, then the high end is infinite.
        cosine: Of the two, in the same form.
    """
    figure, panels = new_figure("Does the anchor pull?", 2, height=4.6, stacked=True)
    size, angle = panels
    for axes, (middle, low, high), colour, line in (
        (size, np.array(strength), "#009e73", 1.0),
        (angle, np.array(cosine), "#cc79a7", 0.0),
    ):
        axes.axhline(line, color=QUIET, linewidth=0.8, linestyle="--")
        axes.plot(rollouts, middle, "o", color=colour, markersize=4)
        known = np.isfinite(low)
        top = np.where(np.isfinite(high), high, 1e3)
        where = np.array(rollouts)[known]
        axes.vlines(where, low[known], top[known], color=colour, linewidth=1.5)
        if not known.any():
            axes.text(
                0.5,
                0.55,
                "lost in the noise of RL's gradient",
                color=QUIET,
                ha="center",
                va="bottom",
                transform=axes.transAxes,
            )
    log_axis(size, "anchor / RL's mean")
    size.set_ylim(1e-2, 1e2)
    angle.set_ylim(-1.05, 1.05)
    angle.set_ylabel("cosine")
    count_axis(angle, "rollouts (each measured before its first update)")
    caption(
        figure,
        "Gradients on the shared actor, the anchor's weighted, with intervals of 90 %.",
    )
    return figure


def forgetting(
    drift: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    success: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    domain: str,
) -> Figure:
    """Draw how far actions on held-out demonstrations drift, beside success.

    Args:
        drift: By method, environment steps and drift [RMS of normalised actions].
            Shape (K,) each.
        success: By method, environment steps and success in `domain`, in [0, 1].
        domain: The one that stands for the robot.
    """
    figure, panels = new_figure("Forgetting the demonstrations", 2, height=5.0)
    for axes, lines in zip(panels, (drift, success), strict=True):
        for method, (colour, marker) in styles(lines).items():
            axes.plot(
                *lines[method], color=colour, marker=marker, markersize=4, label=method
            )
        count_axis(axes, "environment steps")
    panels[0].set_ylabel("drift of actions, held out")
    rate_axis(panels[1])
    panels[1].set_title(domain_label(domain), fontsize=9)
    legend(figure, [panels[0]])
    caption(
        figure,
        "Drift of the most likely actions on demonstrations held out of training, in "
        "units of the action's range, and success in the domain that stands for the "
        "robot.",
    )
    return figure


def _bar(
    axes: Axes,
    place: float,
    width: float,
    colour: str,
    cell: Sequence[ResultRow],
) -> None:
    rates = [row["successes"] / row["episodes"] for row in cell]
    interval = rate_interval(cell)
    axes.bar(
        place, interval.estimate, width * 0.9, color=colour, label=cell[0]["method"]
    )
    top = interval.estimate
    if np.isfinite(interval.low):
        low, top = max(interval.low, 0.0), min(interval.high, 1.0)
        axes.vlines(place, low, top, color=INK, linewidth=1.4)
    if len(rates) > 1:
        spread = np.linspace(-0.2, 0.2, len(rates)) * width
        axes.plot(place + spread, rates, "o", ms=4, mfc="white", mec=INK, mew=0.8)
    axes.annotate(
        f"{interval.estimate:.0%}".replace("%", " %"),
        (place, max(top, *rates)),
        (0, 5),
        textcoords="offset points",
        ha="center",
        fontsize=9,
        color=INK,
    )


def _curve(axes: Axes, curve: Curve, colour: str, marker: str) -> None:
    rates = np.asarray(curve.success, dtype=float)
    if rates.ndim != 2 or rates.shape[1] != len(curve.frames):
        raise ValueError(
            f"curve of {curve.method!r}: success has shape {rates.shape}, expected "
            f"(seeds, {len(curve.frames)})"
        )
    if len(rates) > 1:
        points = [mean_interval(column) for column in rates.T]
    else:
        counts = np.rint(rates[0] * curve.episodes).astype(int)
        points = [wilson_interval(int(count), curve.episodes) for count in counts]
    mean, low, high = np.clip(np.transpose(points), 0, 1)
    axes.plot(
        curve.frames,
        mean,
        color=colour,
        marker=marker,
        markersize=4,
        label=curve.method,
    )
    axes.fill_between(curve.frames, low, high, color=colour, alpha=0.15, linewidth=0)
    if len(rates) > 1:
        worst = rates[np.argmin(rates[:, -1])]
        axes.plot(curve.frames, worst, color=colour, linestyle=":", linewidth=1.4)


def _drifts(
    axes: Axes, drifts: Sequence[Drift], looks: Mapping[str, tuple[str, str]]
) -> None:
    """Draw means over seeds of drift, with Student's t interval of each as a band."""
    axes.set_title("drift, held out", fontsize=10, color=INK)
    for one in drifts:
        colour, marker = looks[one.method]
        intervals = [mean_interval(column) for column in np.transpose(one.drift)]
        mean, low, high = np.transpose(intervals)
        axes.plot(one.frames, mean, color=colour, marker=marker, markersize=4)
        low = np.maximum(low, 0)
        axes.fill_between(one.frames, low, high, color=colour, alpha=0.15, linewidth=0)
    axes.set_ylim(bottom=0)
    count_axis(axes, "environment steps")


def _bars_caption(rows: Sequence[ResultRow]) -> str:
    episodes = span(row["episodes"] for row in rows)
    seeds = Counter(
        (row["task"], row["domain"], row["variation"], row["method"]) for row in rows
    ).values()
    if max(seeds) == 1:
        return f"n = {episodes} episodes per bar; black line: 95 % Wilson interval."
    interval = "t interval of the mean" + (", of one seed Wilson's" * (1 in seeds))
    return (
        f"Mean of {span(seeds)} seeds (dots), n = {episodes} episodes each; black "
        f"line: 95 % {interval}."
    )


def _group_label(
    task: str, domain: str, variation: str | None, several_tasks: bool
) -> str:
    lines = [task] if several_tasks else []
    lines.append(domain_label(domain, lines=2))
    if variation:
        lines.append(f"variation: {variation}")
    return "\n".join(lines)
