"""How noisy a measurement is, told from the measurement alone, at rest or in motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from rlco.gap.log import Array, Log

# Sixth differences: motion that is smooth over seven rows leaves next to nothing of
# itself in them, also at 30 Hz, while white noise passes whole.
_ORDER = 6
_FEW = 100  # windows; from fewer, a median is not within 20 % of its truth
_GAUSS = 0.6745  # median of |x| for a standard normal x


@dataclass(frozen=True)
class Noise:
    """What a sensor adds to each channel.

    Attributes:
        deviation: Standard deviation of one reading's error, an encoder's steps
            included, in the unit of the readings, (channels,).
        quantum: Step between neighbouring readings, 0 where none is seen, (channels,).
    """

    deviation: Array
    quantum: Array


def measurement_noise(recordings: Sequence[tuple[Array, Array]]) -> Noise:
    """Estimate the noise of readings that may be of anything that moves smoothly.

    Sixth divided differences over the true times, scaled so that white noise of
    deviation s leaves s, and of those a median, which a few jerks do not move. An
    encoder's step q adds an error of q / sqrt(12), see Widrow and Kollar,
    *Quantization Noise* (2008), which readings at rest do not show.

    Args:
        recordings: Times (T,) and readings (T, channels) of each recording.

    Example:
        >>> time = np.arange(2000) / 50.0
        >>> error = np.random.default_rng(0).normal(0.0, 4e-4, time.size)
        >>> readings = np.sin(6.0 * time) + error
        >>> noise = measurement_noise([(time, readings[:, None])])
        >>> bool(abs(noise.deviation[0] - 4e-4) < 0.4e-4), float(noise.quantum[0])
        (True, 0.0)
    """
    parts = [_high_pass(time, values) for time, values in recordings]
    high = np.concatenate([part[0] for part in parts])
    travel = np.concatenate([part[1] for part in parts])
    values = np.concatenate([values for _, values in recordings])
    quantum = np.array([_quantum(column) for column in values.T])
    deviation = [
        _deviation(high[:, c], travel[:, c], quantum[c], values[:, c])
        for c in range(values.shape[1])
    ]
    return Noise(np.array(deviation), quantum)


def position_noise(log: Log) -> Noise:
    """Estimate the noise of a log's joint positions, (joints,)."""
    return measurement_noise(
        [(r.time, r.position) for r in log.recordings if r.position is not None]
    )


def _high_pass(time: Array, values: Array) -> tuple[Array, Array]:
    """Return scaled sixth differences and how far each window travels, (windows, C)."""
    if len(time) <= _ORDER:
        nothing = np.empty((0, values.shape[1]))
        return nothing, nothing
    times = sliding_window_view(time, _ORDER + 1)
    apart = (times[:, :, None] - times[:, None, :]) / np.median(np.diff(time))
    diagonal = np.arange(_ORDER + 1)
    apart[:, diagonal, diagonal] = 1.0
    # Divided difference: f[t0..tn] = sum_i f(ti) / prod_j (ti - tj).
    weights = 1.0 / apart.prod(axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    windows = sliding_window_view(values, _ORDER + 1, axis=0)
    high = np.einsum("ncw,nw->nc", windows, weights)
    return high, np.abs(windows[:, :, -1] - windows[:, :, 0])


def _deviation(high: Array, travel: Array, quantum: float, values: Array) -> float:
    # No reading is finer than single precision, in which logs are kept.
    finest = float(np.spacing(np.abs(values).max().astype(np.float32)))
    floor = max(finest, quantum) / math.sqrt(12.0)
    if quantum > 0:
        # While a joint rests its readings hide the noise between two steps.
        moving = high[travel > _ORDER * quantum]
        return max(floor, _robust(moving if len(moving) >= _FEW else high))
    resting = high[travel <= np.quantile(travel, 0.25)] if travel.size else high
    estimates = [_robust(part) for part in (high, resting) if len(part) >= _FEW]
    # Motion can only add to what is left of it.
    return max(floor, min(estimates, default=_robust(high)))


def _robust(values: Array) -> float:
    return float(np.median(np.abs(values)) / _GAUSS) if values.size else 0.0


def _quantum(values: Array) -> float:
    """Return the step of which all differences between readings are multiples."""
    levels = np.unique(values)
    finest = float(np.spacing(np.abs(values).max().astype(np.float32)))
    gaps = np.diff(levels)
    gaps = gaps[gaps > 4.0 * finest]
    few = len(gaps) < 8 and len(levels) > len(values) / 10
    step = float(gaps.min(initial=np.inf))
    if few or step < 50.0 * finest or not len(gaps):
        return 0.0
    multiples = np.round(gaps / step)
    off = np.abs(gaps / step - multiples)
    if np.mean(off < 0.02 + 2.0 * finest / step) < 0.98:
        return 0.0
    return float(gaps.sum() / multiples.sum())
