"""Estimate measurement noise from the measurement alone, at rest or in motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rlco.gap.logs.log import Array, Log
from rlco.gap.logs.times.encoder_step import encoder_step
from rlco.gap.logs.times.sixth_differences import ORDER, sixth_differences

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

    Of a channel that never changes nothing is known. It gets the median of the others:
    without noise it would outweigh all of them.

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
    parts = [sixth_differences(time, values) for time, values in recordings]
    high = np.concatenate([part[0] for part in parts])
    travel = np.concatenate([part[1] for part in parts])
    values = np.concatenate([values for _, values in recordings])
    quantum = np.array([encoder_step(column) for column in values.T])
    deviation = np.array(
        [
            _deviation(high[:, c], travel[:, c], quantum[c], values[:, c])
            for c in range(values.shape[1])
        ]
    )
    still = np.all([np.ptp(part, axis=0) == 0.0 for _, part in recordings], axis=0)
    if still.any() and not still.all():
        # Where it stands in each recording is no step of its encoder, either.
        quantum = np.where(still, 0.0, quantum)
        deviation = np.where(still, np.median(deviation[~still]), deviation)
    return Noise(deviation, quantum)


def position_noise(log: Log) -> Noise:
    """Estimate the noise of a log's joint positions, (joints,).

    What is not known of the rows' times adds speed times as much.
    """
    parts = [(r, r.position) for r in log.recordings if r.position is not None]
    noise = measurement_noise([(one.time, position) for one, position in parts])
    if not any(one.jitter for one, _ in parts):
        return noise
    moved = [
        one.jitter * np.gradient(position, one.time, axis=0) for one, position in parts
    ]
    late = np.mean(np.concatenate(moved) ** 2, axis=0)
    return replace(noise, deviation=np.sqrt(noise.deviation**2 + late))


def _deviation(high: Array, travel: Array, quantum: float, values: Array) -> float:
    # No sample is finer than single precision, in which logs are stored.
    finest = float(np.spacing(np.abs(values).max().astype(np.float32)))
    floor = max(finest, quantum) / math.sqrt(12.0)
    if quantum > 0:
        # At rest, samples hide noise that is smaller than one encoder step.
        moving = high[travel > ORDER * quantum]
        return max(floor, _robust(moving if len(moving) >= _FEW else high))
    resting = high[travel <= np.quantile(travel, 0.25)] if travel.size else high
    estimates = [_robust(part) for part in (high, resting) if len(part) >= _FEW]
    # Residual motion can only increase the estimate.
    return max(floor, min(estimates, default=_robust(high)))


def _robust(values: Array) -> float:
    return float(np.median(np.abs(values)) / _GAUSS) if values.size else 0.0
