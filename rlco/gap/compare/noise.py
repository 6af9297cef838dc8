"""Estimate measurement noise from the measurement alone, at rest or in motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from rlco.gap.logs.log import Array, Log

# Sixth differences: motion that is smooth over seven rows nearly vanishes in them, even
# at 30 Hz, while white noise passes unattenuated.
_ORDER = 6
_FEW = 100  # windows; with fewer, the median's error exceeds 20 %
_GAUSS = 0.6745  # median of |x| for a standard normal x


@dataclass(frozen=True)
class Noise:
    """Measurement noise of each channel.

    Attributes:
        deviation: Standard deviation of one sample's error, including an encoder's
            quantization, in the unit of the samples, (channels,).
        quantum: Quantization step, 0 where none is found, (channels,).
    """

    deviation: Array
    quantum: Array


def measurement_noise(recordings: Sequence[tuple[Array, Array]]) -> Noise:
    """Estimate the noise of samples of any smooth motion.

    The estimate is the median of sixth divided differences over the true times, which a
    few jerks do not affect. They are scaled so that white noise of deviation s gives s.
    An encoder's step q adds an error of q / sqrt(12), see Widrow and Kollar,
    *Quantization Noise* (2008), which samples at rest do not reveal.

    Args:
        recordings: Times (T,) and samples (T, channels) of each recording.

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
    """Return scaled sixth differences and each window's travel, (windows, C)."""
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
    # No sample is finer than single precision, in which logs are stored.
    finest = float(np.spacing(np.abs(values).max().astype(np.float32)))
    floor = max(finest, quantum) / math.sqrt(12.0)
    if quantum > 0:
        # At rest, samples hide noise that is smaller than one encoder step.
        moving = high[travel > _ORDER * quantum]
        return max(floor, _robust(moving if len(moving) >= _FEW else high))
    resting = high[travel <= np.quantile(travel, 0.25)] if travel.size else high
    estimates = [_robust(part) for part in (high, resting) if len(part) >= _FEW]
    # Residual motion can only increase the estimate.
    return max(floor, min(estimates, default=_robust(high)))


def _robust(values: Array) -> float:
    return float(np.median(np.abs(values)) / _GAUSS) if values.size else 0.0


def _quantum(values: Array) -> float:
    """Return the step of which all differences between samples are multiples."""
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
