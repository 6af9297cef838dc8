"""What a calibrated model still lacks, as a function of the motion: a regression.

A Gaussian process of the residual of each channel over position, velocity and
acceleration, of its own joint and of all. Where another recording moves as this one
did, it is known what the model lacks there; elsewhere the process returns to zero, and
its variance says so. It is used only where it predicts seconds that it was not fitted
to; its kernel is chosen by that.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rlco.gap.calibrate.numbers import Calibratable
from rlco.gap.compare.torque.smooth_motion import smooth_motion
from rlco.gap.logs.log import Array
from rlco.gap.search.comparison import seconds_of

_ROWS = 700  # of a recording that are used
_FOLDS = 5
_WORTH = 0.9  # of the mean square of unseen seconds that may be left
_RATIOS = (0.1, 0.5, 3.0)  # variance of the process, of that of the noise
_SMOOTH = 0.4  # [s]
_STANDING = 0.02  # [rad/s]

Kernel = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class ResidualModel:
    """What is known of residuals at other motions.

    Attributes:
        correction: Expected residual of each row, (N,).
        deviation: Standard deviation of what is not expected, of each channel,
            (channels,).
        explained: Part of the mean square in unseen seconds that it explains,
            (channels,); 0 where it is not used.
    """

    correction: Array
    deviation: Array
    explained: Array


def residual_model(
    known: Calibratable, residual: Array, wanted: Calibratable
) -> ResidualModel:
    """Return what a residual in one log says of another.

    Args:
        known: The calibrated model and the log of the residual.
        residual: (N,), of `known`.
        wanted: The calibrated model and the other log.
    """
    channels = len(known.layout.channels)
    motion, other = motion_of(known), motion_of(wanted)
    center, size = motion.mean(axis=0), np.maximum(motion.std(axis=0), 1e-9)
    blocks = seconds_of(known.layout)[::channels]
    rows = np.unique(np.linspace(0, len(motion) - 1, _ROWS).astype(int))
    _, fold = np.unique(blocks[rows], return_inverse=True)
    fold = fold % _FOLDS
    correction = np.zeros((len(other), channels))
    deviation, explained = np.zeros(channels), np.zeros(channels)
    whole = residual.reshape(-1, channels)
    for channel in range(channels):
        values = whole[rows, channel]
        plain = float(np.mean(whole[:, channel] ** 2))
        best = _best(
            _kernels(channel, channels, center, size), motion[rows], values, fold
        )
        # Too small a residual is noise, which no motion predicts.
        if best is None or best.error > _WORTH * plain:
            deviation[channel] = np.sqrt(plain)
            continue
        mean, variance = best.predict(motion[rows], values, other)
        correction[:, channel] = mean
        deviation[channel] = np.sqrt(best.error * np.mean(variance) / best.variance)
        explained[channel] = 1.0 - best.error / plain
    return ResidualModel(correction.ravel(), deviation, explained)


def motion_of(problem: Calibratable) -> Array:
    """Return position, velocity and acceleration in each row, (rows, 3 joints)."""
    layout, joints = problem.layout, len(problem.layout.channels)
    recording, time = layout.recording[::joints], layout.time[::joints]
    found = np.empty((len(time), 3 * joints))
    for index, one in enumerate(problem.log.recordings):
        near = recording == index
        parts = smooth_motion(one.time, np.asarray(one.position), _SMOOTH)
        rows = np.searchsorted(one.time, time[near] - 1e-9)
        found[near] = np.concatenate(parts, axis=1)[rows]
    return found


@dataclass(frozen=True)
class _Process:
    kernel: Kernel
    ratio: float
    error: float  # mean square in seconds that were not fitted
    variance: float  # that the process expected there, over the noise's

    def predict(self, at: Array, values: Array, other: Array) -> tuple[Array, Array]:
        """Return means and variances, over the noise's, at other motions."""
        inverse = np.linalg.inv(self.ratio * self.kernel(at, at) + np.eye(len(at)))
        mean, variance = np.empty(len(other)), np.empty(len(other))
        for first in range(0, len(other), 4096):
            part = slice(first, first + 4096)
            cross = self.ratio * self.kernel(other[part], at)
            mean[part] = cross @ (inverse @ values)
            own = self.ratio * self.kernel(other[part][:1], other[part][:1])[0, 0]
            less = np.sum((cross @ inverse) * cross, axis=1)
            variance[part] = 1.0 + np.maximum(own - less, 0.0)
        return mean, variance


def _best(
    kernels: Sequence[Kernel], at: Array, values: Array, fold: Array
) -> _Process | None:
    """Return the process with the least error in seconds that were not fitted."""
    best: _Process | None = None
    for kernel in kernels:
        whole = kernel(at, at)
        for ratio in _RATIOS:
            errors, variances = np.empty(len(at)), np.empty(len(at))
            for number in range(_FOLDS):
                out = fold == number
                if not out.any() or out.all():
                    return best
                near = ratio * whole[np.ix_(~out, ~out)] + np.eye(int((~out).sum()))
                cross = ratio * whole[np.ix_(out, ~out)]
                gain = np.linalg.solve(near, cross.T).T
                errors[out] = values[out] - gain @ values[~out]
                own = ratio * np.diag(whole)[out]
                variances[out] = 1.0 + own - np.sum(gain * cross, axis=1)
            error = float(np.mean(errors**2))
            if best is None or error < best.error:
                best = _Process(kernel, ratio, error, float(np.mean(variances)))
    return best


def _kernels(
    channel: int, channels: int, center: Array, size: Array
) -> tuple[Kernel, ...]:
    """Return kernels: of a joint's own motion, and with that of all joints."""
    own = [channel, channels + channel]

    def scaled(motion: Array) -> Array:
        return np.asarray((motion - center) / size)

    def of_own(a: Array, b: Array) -> Array:
        turns = [np.tanh(x[:, own[1]] / _STANDING) for x in (a, b)]
        found = _near(turns[0][:, None], turns[1][:, None], 1.0)
        one, other = scaled(a), scaled(b)
        for column in own:
            found = found + _near(one[:, [column]], other[:, [column]], 0.4)
        return found / 3.0

    def of_all(a: Array, b: Array) -> Array:
        reach = 0.7 * np.sqrt(a.shape[1])
        return 0.3 * of_own(a, b) + _near(scaled(a), scaled(b), reach)

    return of_own, of_all


def _near(a: Array, b: Array, reach: float) -> Array:
    squares = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2.0 * a @ b.T
    return np.asarray(np.exp(-0.5 * np.maximum(squares, 0.0) / reach**2))
