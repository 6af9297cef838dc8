"""Disagreement of simulation and measurement by joint, by regime and over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rlco.gap.compare.problem import Hypothesis, Integers, Problem
from rlco.gap.diagnose.regimes import Flags, Labels, label_regimes
from rlco.gap.logs.log import Array

EVERYWHERE = "everywhere"
_BINS = 160  # columns of the heat map
_ODDS = 1.5
_CLEAN = 0.02
_VISIBLE = 0.2  # excess over the noise's square below which an error is not visible


@dataclass(frozen=True)
class Cell:
    """The disagreement of one channel in one regime.

    Attributes:
        target: The channel's name.
        regime: One of `rlco.gap.diagnose.regimes.REGIMES`, or ``everywhere``.
        rows: Number of residuals.
        time: Their share of all residuals.
        rms: Their root mean square, in the channel's unit.
        share: Their share of all squared error above the noise floor.
        size: Their root mean square in units of the noise.
        information: How informative the cell is: ``share * log2(share / time)`` [bit],
            large where much of the error is in little of the time. It is the cell's
            contribution to the Kullback-Leibler divergence of the error's distribution
            from that of the time.
    """

    target: str
    regime: str
    rows: int
    time: float
    rms: float
    share: float
    size: float
    information: float


@dataclass(frozen=True)
class HeatMap:
    """Disagreement over time and channel, with all recordings in sequence.

    Attributes:
        rms: Root mean square of each channel in each time bin, in the channel's unit,
            NaN where nothing was compared, (channels, bins).
        edges: Edges of the time bins [s], (bins + 1,).
        starts: Start of each recording [s], (recordings,).
    """

    rms: Array
    edges: Array
    starts: Array


@dataclass(frozen=True)
class Where:
    """Disagreement between a simulation and the measurement.

    Attributes:
        channels: Names of the channels.
        units: Their units.
        rms: Root mean square of each channel, (channels,).
        share: Share of each channel in all squared error above the noise, (channels,).
        noise: Standard deviation of the measurement, (channels,).
        cells: Every channel in every regime, the most informative first.
        heat: The same over time.
        diverged: Share of the residuals that are infinite, and excluded from the rest.
    """

    channels: tuple[str, ...]
    units: tuple[str, ...]
    rms: Array
    share: Array
    noise: Array
    cells: tuple[Cell, ...]
    heat: HeatMap
    diverged: float

    @property
    def informative(self) -> tuple[Cell, ...]:
        """The informative cells: channels with error, and regimes with much of it.

        A regime is listed if the odds of an error to occur in it are half as large
        again as those of a residual. Cells below two per cent of all error are omitted.
        """
        whole = {c.target: c for c in self.cells if c.regime == EVERYWHERE}

        def more_than_usual(cell: Cell) -> bool:
            every = whole[cell.target]
            share, time = cell.share / every.share, cell.time / every.time
            return share * (1.0 - time) > _ODDS * (1.0 - share) * time

        informative = (
            cell
            for cell in self.cells
            if cell.share >= 0.02
            and (cell.regime == EVERYWHERE or more_than_usual(cell))
        )
        # If errors begin with the first contact, it is their cause, not the speed.
        contact = self.before_contact is not None and self.before_contact[0] < _CLEAN
        causes = ("contact", "after contact") if contact else ()
        return tuple(sorted(informative, key=lambda cell: cell.regime not in causes))

    @property
    def before_contact(self) -> tuple[float, float] | None:
        """Shares of error and of data before the first contact, if there is one."""
        free = [cell for cell in self.cells if cell.regime == "free"]
        if not free:
            return None
        return sum(cell.share for cell in free), sum(cell.time for cell in free)


@dataclass(frozen=True)
class _Residuals:
    """Residuals with recording, channel and time; infinite ones count as zero, (N,)."""

    recording: Integers
    channel: Integers
    time: Array
    squares: Array
    excess: Array
    finite: Flags


def where(
    problem: Problem,
    hypothesis: Hypothesis | Sequence[Hypothesis] | None = None,
    *,
    labels: Sequence[Labels] | None = None,
    recordings: Sequence[int] | None = None,
) -> Where:
    """Localise the disagreement of a simulation with the measurement.

    Args:
        problem: The robot's model and log.
        hypothesis: What is simulated, in all recordings or one for each; by default the
            model without effects.
        labels: Result of `label_regimes`, to compare before and after in the same cells
            without labelling twice.
        recordings: Restrict to these.
    """
    if recordings is None:
        recordings = range(len(problem.log.recordings))
    hypothesis = hypothesis or Hypothesis()
    residuals = _residuals(problem, hypothesis, recordings)
    channels = range(len(problem.layout.channels))
    of_channel = [residuals.finite & (residuals.channel == c) for c in channels]
    error = np.array([_visible_error(problem, residuals, c) for c in channels])
    total = float(error.sum())
    flags = _flags(labels or label_regimes(problem), residuals)
    cells = [
        _cell(problem, residuals, c, regime, of_channel[c] & flag, error)
        for c in channels
        for regime, flag in flags.items()
    ]
    cells = sorted((c for c in cells if c.rows), key=lambda cell: -cell.information)
    return Where(
        problem.layout.channels,
        problem.layout.units,
        np.array([_rms(residuals.squares[mask]) for mask in of_channel]),
        error / total if total > 0 else error,
        np.asarray(problem.noise, dtype=float),
        tuple(cells),
        _heat_map(problem, residuals, recordings),
        float(1.0 - residuals.finite.mean()) if residuals.finite.size else 0.0,
    )


def _residuals(
    problem: Problem,
    hypothesis: Hypothesis | Sequence[Hypothesis],
    recordings: Sequence[int],
) -> _Residuals:
    if isinstance(hypothesis, Hypothesis):
        values = problem.residuals([hypothesis], recordings)[0]
    else:
        each = [problem.residuals([hypothesis[i]], [i])[0] for i in sorted(recordings)]
        values = np.concatenate(each)
    layout = problem.layout
    chosen = np.isin(layout.recording, list(recordings))
    channel = layout.channel[chosen]
    finite = np.isfinite(values)
    squares = np.where(finite, values, 0.0) ** 2
    noise = np.asarray(problem.noise, dtype=float)
    # Radians and metres cannot be added: each channel is in units of its own noise.
    same_unit = len(set(layout.units)) == 1
    weights = np.ones_like(noise) if same_unit else noise**-2
    excess = finite * weights[channel] * (squares - noise[channel] ** 2)
    return _Residuals(
        layout.recording[chosen], channel, layout.time[chosen], squares, excess, finite
    )


def _visible_error(problem: Problem, residuals: _Residuals, channel: int) -> float:
    """Sum a channel's squared error above the noise, or 0 where it is not visible."""
    mask = residuals.finite & (residuals.channel == channel)
    noise = float(problem.noise[channel])
    if not mask.any() or residuals.squares[mask].mean() < (1 + _VISIBLE) * noise**2:
        return 0.0
    return max(0.0, float(residuals.excess[mask].sum()))


def _flags(labels: Sequence[Labels], residuals: _Residuals) -> dict[str, Flags]:
    """Return the mask of each regime's residuals, (N,)."""
    flags: dict[str, Flags] = {EVERYWHERE: np.ones(len(residuals.time), dtype=bool)}
    for name in labels[0].flags:
        flags[name] = np.zeros(len(residuals.time), dtype=bool)
    for index, label in enumerate(labels):
        here = np.flatnonzero(residuals.recording == index)
        row = np.searchsorted(label.time, residuals.time[here] - 1e-9)
        row = np.clip(row, 0, len(label.time) - 1)
        for name, flag in label.flags.items():
            flags[name][here] = flag[row, residuals.channel[here]]
    return flags


def _cell(
    problem: Problem,
    residuals: _Residuals,
    channel: int,
    regime: str,
    mask: Flags,
    error: Array,
) -> Cell:
    rows, rms = int(mask.sum()), _rms(residuals.squares[mask])
    time = rows / max(int(residuals.finite.sum()), 1)
    share = 0.0
    if error[channel] > 0:
        share = float(residuals.excess[mask].sum()) / float(error.sum())
        share = min(max(share, 0.0), 1.0)
    information = share * math.log2(share / time) if share > 0 else 0.0
    size = rms / float(problem.noise[channel])
    name = problem.layout.channels[channel]
    return Cell(name, regime, rows, time, rms, share, size, information)


def _heat_map(
    problem: Problem, residuals: _Residuals, recordings: Sequence[int]
) -> HeatMap:
    logs = [problem.log.recordings[index] for index in recordings]
    ends = np.cumsum([0.0, *(log.seconds for log in logs)])
    edges = np.linspace(0.0, ends[-1], _BINS + 1)
    offset = np.zeros(len(problem.log.recordings))
    for index, log, start in zip(recordings, logs, ends[:-1], strict=True):
        offset[index] = start - log.time[0]
    bin_of = (
        np.searchsorted(edges, residuals.time + offset[residuals.recording], "right")
        - 1
    )
    bin_of = np.clip(bin_of, 0, _BINS - 1)
    shape = (len(problem.layout.channels), _BINS)
    flat = residuals.channel * _BINS + bin_of
    size = shape[0] * shape[1]
    counts = np.bincount(flat, residuals.finite, size).reshape(shape)
    sums = np.bincount(flat, residuals.squares, size).reshape(shape)
    with np.errstate(invalid="ignore"):
        return HeatMap(np.sqrt(sums / counts), edges, ends[:-1])


def _rms(squares: Array) -> float:
    return math.sqrt(float(squares.mean())) if squares.size else 0.0
