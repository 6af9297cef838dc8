"""Where simulation and measurement disagree: by joint, by regime, over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rlco.gap.log import Array
from rlco.gap.problem import Hypothesis, Integers, Problem
from rlco.gap.regimes import Flags, Labels, label_regimes

EVERYWHERE = "everywhere"
_BINS = 160  # columns of the heat map
_ODDS = 1.5
_CLEAN = 0.02
_VISIBLE = 0.2  # of the noise's square: less than that is not seen above it


@dataclass(frozen=True)
class Cell:
    """The disagreement of one channel in one regime.

    Attributes:
        target: The channel's name.
        regime: One of `rlco.gap.regimes.REGIMES`, or ``everywhere``.
        rows: How many residuals these are.
        time: Their part of all residuals.
        rms: Their root mean square, in the channel's unit.
        share: Their part of all squared error above the noise floor.
        size: Their root mean square in units of the noise.
        telling: ``share * log2(share / time)`` [bit]: large where much of the error
            is in little of the time; the cells' contributions to the Kullback-Leibler
            divergence of the error's distribution from that of the time.
    """

    target: str
    regime: str
    rows: int
    time: float
    rms: float
    share: float
    size: float
    telling: float


@dataclass(frozen=True)
class HeatMap:
    """Disagreement over time and channel, all recordings one after the other.

    Attributes:
        rms: Root mean square of each channel in each stretch of time, in the channel's
            unit, NaN where nothing was compared, (channels, stretches).
        edges: Where the stretches begin and end [s], (stretches + 1,).
        starts: Where each recording begins [s], (recordings,).
    """

    rms: Array
    edges: Array
    starts: Array


@dataclass(frozen=True)
class Where:
    """Where a simulation and the measurement disagree.

    Attributes:
        channels: Names of the channels.
        units: Their units.
        rms: Root mean square of each channel, (channels,).
        share: Part of each channel in all squared error above the noise, (channels,).
        noise: Standard deviation of the measurement, (channels,).
        cells: Every channel in every regime, the most telling first.
        heat: The same over time.
        diverged: Part of the residuals that are infinite, and left out of the rest.
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
    def telling(self) -> tuple[Cell, ...]:
        """Each channel with error, and the regimes that hold more of it than usual.

        More than usual: the odds of an error to lie there are half as large again as
        those of a residual. Below two per cent of all error nothing is told.
        """
        whole = {c.target: c for c in self.cells if c.regime == EVERYWHERE}

        def more_than_usual(cell: Cell) -> bool:
            every = whole[cell.target]
            share, time = cell.share / every.share, cell.time / every.time
            return share * (1.0 - time) > _ODDS * (1.0 - share) * time

        told = (
            cell
            for cell in self.cells
            if cell.share >= 0.02
            and (cell.regime == EVERYWHERE or more_than_usual(cell))
        )
        # Where all is well until something touches, speeds are no cause but a result.
        contact = self.before_contact is not None and self.before_contact[0] < _CLEAN
        causes = ("contact", "after contact") if contact else ()
        return tuple(sorted(told, key=lambda cell: cell.regime not in causes))

    @property
    def before_contact(self) -> tuple[float, float] | None:
        """Share of the error before anything touched, and of the data; None if none."""
        free = [cell for cell in self.cells if cell.regime == "free"]
        if not free:
            return None
        return sum(cell.share for cell in free), sum(cell.time for cell in free)


@dataclass(frozen=True)
class _Residuals:
    """Residuals with what each is of; infinite ones count as nothing, (N,) each."""

    recording: Integers
    channel: Integers
    time: Array
    squares: Array
    excess: Array
    finite: Flags


def where(
    problem: Problem,
    hypothesis: Hypothesis | None = None,
    *,
    labels: Sequence[Labels] | None = None,
    recordings: Sequence[int] | None = None,
) -> Where:
    """Say where a simulation disagrees with the measurement.

    Args:
        problem: The robot's model and log.
        hypothesis: What is simulated; the model as it is where absent.
        labels: What `label_regimes` gave, to compare before and after in the same
            cells without labelling twice.
        recordings: Only these.
    """
    if recordings is None:
        recordings = range(len(problem.log.recordings))
    hypothesis = hypothesis or Hypothesis()
    left = _residuals(problem, hypothesis, recordings)
    channels = range(len(problem.layout.channels))
    of_channel = [left.finite & (left.channel == c) for c in channels]
    error = np.array([_visible_error(problem, left, c) for c in channels])
    total = float(error.sum())
    flags = _flags(labels or label_regimes(problem), left)
    cells = [
        _cell(problem, left, c, regime, of_channel[c] & flag, error)
        for c in channels
        for regime, flag in flags.items()
    ]
    cells = sorted((c for c in cells if c.rows), key=lambda cell: -cell.telling)
    return Where(
        problem.layout.channels,
        problem.layout.units,
        np.array([_rms(left.squares[mask]) for mask in of_channel]),
        error / total if total > 0 else error,
        np.asarray(problem.noise, dtype=float),
        tuple(cells),
        _heat_map(problem, left, recordings),
        float(1.0 - left.finite.mean()) if left.finite.size else 0.0,
    )


def _residuals(
    problem: Problem, hypothesis: Hypothesis, recordings: Sequence[int]
) -> _Residuals:
    values = problem.residuals([hypothesis], recordings)[0]
    layout = problem.layout
    chosen = np.isin(layout.recording, list(recordings))
    channel = layout.channel[chosen]
    finite = np.isfinite(values)
    squares = np.where(finite, values, 0.0) ** 2
    noise = np.asarray(problem.noise, dtype=float)
    # Radians and metres cannot be added: each channel then counts in its own noise.
    same_unit = len(set(layout.units)) == 1
    weights = np.ones_like(noise) if same_unit else noise**-2
    excess = finite * weights[channel] * (squares - noise[channel] ** 2)
    return _Residuals(
        layout.recording[chosen], channel, layout.time[chosen], squares, excess, finite
    )


def _visible_error(problem: Problem, left: _Residuals, channel: int) -> float:
    """Sum a channel's squared error above the noise, 0 where it does not show."""
    mask = left.finite & (left.channel == channel)
    noise = float(problem.noise[channel])
    if not mask.any() or left.squares[mask].mean() < (1 + _VISIBLE) * noise**2:
        return 0.0
    return max(0.0, float(left.excess[mask].sum()))


def _flags(labels: Sequence[Labels], left: _Residuals) -> dict[str, Flags]:
    """Return for each regime which residuals lie in it, (N,)."""
    flags: dict[str, Flags] = {EVERYWHERE: np.ones(len(left.time), dtype=bool)}
    for name in labels[0].flags:
        flags[name] = np.zeros(len(left.time), dtype=bool)
    for index, label in enumerate(labels):
        here = np.flatnonzero(left.recording == index)
        row = np.searchsorted(label.time, left.time[here] - 1e-9)
        row = np.clip(row, 0, len(label.time) - 1)
        for name, flag in label.flags.items():
            flags[name][here] = flag[row, left.channel[here]]
    return flags


def _cell(
    problem: Problem,
    left: _Residuals,
    channel: int,
    regime: str,
    mask: Flags,
    error: Array,
) -> Cell:
    rows, rms = int(mask.sum()), _rms(left.squares[mask])
    time = rows / max(int(left.finite.sum()), 1)
    share = 0.0
    if error[channel] > 0:
        share = float(left.excess[mask].sum()) / float(error.sum())
        share = min(max(share, 0.0), 1.0)
    telling = share * math.log2(share / time) if share > 0 else 0.0
    size = rms / float(problem.noise[channel])
    name = problem.layout.channels[channel]
    return Cell(name, regime, rows, time, rms, share, size, telling)


def _heat_map(problem: Problem, left: _Residuals, recordings: Sequence[int]) -> HeatMap:
    logs = [problem.log.recordings[index] for index in recordings]
    ends = np.cumsum([0.0, *(log.seconds for log in logs)])
    edges = np.linspace(0.0, ends[-1], _BINS + 1)
    offset = np.zeros(len(problem.log.recordings))
    for index, log, start in zip(recordings, logs, ends[:-1], strict=True):
        offset[index] = start - log.time[0]
    place = np.searchsorted(edges, left.time + offset[left.recording], "right") - 1
    place = np.clip(place, 0, _BINS - 1)
    shape = (len(problem.layout.channels), _BINS)
    flat = left.channel * _BINS + place
    size = shape[0] * shape[1]
    counts = np.bincount(flat, left.finite, size).reshape(shape)
    sums = np.bincount(flat, left.squares, size).reshape(shape)
    with np.errstate(invalid="ignore"):
        return HeatMap(np.sqrt(sums / counts), edges, ends[:-1])


def _rms(squares: Array) -> float:
    return math.sqrt(float(squares.mean())) if squares.size else 0.0
