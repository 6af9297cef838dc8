"""Label each moment of a recording: rest, reversal, fast, loaded, in contact."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from rlco.gap.compare.noise import measurement_noise, position_noise
from rlco.gap.compare.problem import Hypothesis, Problem
from rlco.gap.logs.log import Array
from rlco.physics.effects.targets import actuator_of, command_at

Flags = NDArray[np.bool_]

#: The first four partition the time; the others may coincide with any of them.
REGIMES: Mapping[str, str] = {
    "hold": "at rest for 0.2 s or longer",
    "reversal": "from just before the motion turns round until 0.3 s after",
    "slow": "below half of the joint's usual top speed",
    "fast": "above it",
    "accelerating": "above half of the joint's usual top acceleration",
    "loaded": "above half of the joint's largest torque against gravity",
    "saturated": "the actuator at its limit, or the command unusually far away",
    "contact": "something touches",
    "after contact": "nothing touches any more, but something did in this recording",
    "free": "nothing has touched in this recording so far",
}
_FULL = 0.95  # duty of a drive at its limit
_SMOOTH = 0.14  # window of the polynomials that yield speeds and accelerations [s]
_BEFORE, _AFTER, _TURN, _REST = 0.05, 0.3, 0.5, 0.2  # [s]


@dataclass(frozen=True)
class Labels:
    """The regimes of one recording.

    Attributes:
        time: Of its rows [s], (T,).
        flags: For each regime, whether each channel is in it, (T, channels). Regimes
            that this data cannot show, or that never occur, are absent.
    """

    time: Array
    flags: Mapping[str, Flags]


def label_regimes(problem: Problem) -> list[Labels]:
    """Label every row of every recording by its measurements and commands.

    Speeds are relative to the 95th percentile of the same joint over all recordings, so
    the regimes mean the same for a shoulder and a wrist.

    Example:
        >>> ramp = np.abs(np.arange(-50, 51))[:, None] / 25.0
        >>> moving, speed = ramp[:, 0] > 0.5, np.sign(np.arange(-50, 51))[:, None]
        >>> flags = motion_flags(np.arange(101) / 50.0, speed, np.full(1, 0.1), 1.0)
        >>> [name for name, flag in flags.items() if flag[60, 0]]
        ['reversal']
    """
    count = len(problem.log.recordings)
    traces = [problem.traces(Hypothesis(), index) for index in range(count)]
    speeds = [_speed(trace) for trace in traces]
    changes = [
        _slope(trace["time"], speed)
        for trace, speed in zip(traces, speeds, strict=True)
    ]
    top_speed = _usual_top(speeds)
    still = np.maximum(0.03 * top_speed, _speed_noise(problem, traces, speeds))
    top_change = _usual_top(changes)
    found = []
    for trace, speed, change in zip(traces, speeds, changes, strict=True):
        flags = motion_flags(trace["time"], speed, still, top_speed)
        flags["accelerating"] = np.abs(change) > 0.5 * top_change
        found.append((trace["time"], flags))
    extra = [
        _loaded(traces),
        _saturated(problem.model, problem.layout.channels, traces),
        _contact(traces, len(problem.layout.channels)),
    ]
    for index, (_, flags) in enumerate(found):
        for group in extra:
            flags |= {name: parts[index] for name, parts in group.items()}
    occurring = {
        name for _, flags in found for name, flag in flags.items() if flag.any()
    }
    return [
        Labels(time, {name: flags[name] for name in REGIMES if name in occurring})
        for time, flags in found
    ]


def motion_flags(
    time: Array, speed: Array, still: Array, top_speed: Array | float
) -> dict[str, Flags]:
    """Partition the rows of one recording into hold, reversal, slow and fast.

    Args:
        time: Of the rows [s], (T,).
        speed: Of each channel, (T, channels).
        still: Speed below which a channel is at rest, (channels,).
        top_speed: The channel's usual top speed, (channels,).
    """
    direction = np.sign(speed) * (np.abs(speed) > still)
    reversal = np.stack([_reversals(time, column) for column in direction.T], axis=1)
    rest = np.stack([_rests(time, column == 0) for column in direction.T], axis=1)
    hold = rest & ~reversal
    fast = (np.abs(speed) > 0.5 * np.asarray(top_speed)) & ~reversal & ~hold
    slow = ~(hold | reversal | fast)
    return {"hold": hold, "reversal": reversal, "slow": slow, "fast": fast}


def _reversals(time: Array, direction: Array) -> Flags:
    """Flag the time around each change of direction, unless it is a long rest."""
    moving = np.flatnonzero(direction)
    before, after = moving[:-1], moving[1:]
    turns = direction[before] != direction[after]
    turns &= time[after] - time[before] <= _TURN
    return _covered(time, time[before][turns] - _BEFORE, time[after][turns] + _AFTER)


def _rests(time: Array, rest: Flags) -> Flags:
    edges = np.diff(np.concatenate([[0], rest.astype(int), [0]]))
    first, last = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    long = time[last] - time[first] >= _REST
    return _covered(time, time[first][long], time[last][long])


def _covered(time: Array, begin: Array, end: Array) -> Flags:
    """Flag the rows within any of the intervals."""
    steps = np.zeros(len(time) + 1, dtype=int)
    np.add.at(steps, np.searchsorted(time, begin - 1e-9), 1)
    np.add.at(steps, np.searchsorted(time, end + 1e-9), -1)
    return np.asarray(np.cumsum(steps)[:-1] > 0)


def _speed(trace: Mapping[str, Array]) -> Array:
    if "velocity" in trace:
        return np.asarray(trace["velocity"], dtype=float)
    return _slope(trace["time"], trace["measured"])


def _slope(time: Array, values: Array) -> Array:
    """Differentiate by fitting lines to a short window, (T, channels)."""
    period = float(np.median(np.diff(time)))
    half = min(max(2, round(0.5 * _SMOOTH / period)), (len(time) - 1) // 2)
    if half < 1:
        return np.asarray(np.gradient(values, time, axis=0))
    even = time[0] + period * np.arange(round((time[-1] - time[0]) / period) + 1)
    resampled = np.stack([np.interp(even, time, column) for column in values.T], axis=1)
    ends = ((half, half), (0, 0))
    padded = np.pad(resampled, ends, mode="reflect", reflect_type="odd")
    steps = np.arange(-half, half + 1)
    windows = sliding_window_view(padded, len(steps), axis=0)
    slope = windows @ (steps / (period * (steps @ steps)))
    return np.stack([np.interp(time, even, column) for column in slope.T], axis=1)


def _usual_top(parts: Sequence[Array]) -> Array:
    return np.asarray(np.quantile(np.abs(np.concatenate(parts)), 0.95, axis=0))


def _speed_noise(
    problem: Problem, traces: Sequence[Mapping[str, Array]], speeds: Sequence[Array]
) -> Array:
    """Return three standard deviations of a resting channel's speed, (channels,)."""
    times = [trace["time"] for trace in traces]
    noise = measurement_noise(list(zip(times, speeds, strict=True))).deviation
    positions = [recording.position for recording in problem.log.recordings]
    if all(p is not None and p.shape[1] == len(noise) for p in positions):
        # Speeds derived from positions carry their noise, smoothed.
        period = float(np.median(np.diff(times[0])))
        rows = max(5, round(_SMOOTH / period))
        # Slope of a line through n samples: s^2 = 12 sigma^2 / (dt^2 n (n^2 - 1)).
        gain = np.sqrt(12.0 / (rows * (rows**2 - 1.0))) / period
        noise = np.maximum(noise, gain * position_noise(problem.log).deviation)
    return np.asarray(3.0 * noise)


def _loaded(traces: Sequence[Mapping[str, Array]]) -> dict[str, list[Flags]]:
    if not all("torque" in trace for trace in traces):
        return {}
    loads = [np.abs(trace["torque"]) for trace in traces]
    largest = np.concatenate(loads).max(axis=0)
    # A joint with a vertical axis carries no load, except for rounding errors.
    enough = largest > 1e-3 * largest.max()
    return {"loaded": [(load > 0.5 * largest) & enough for load in loads]}


def _saturated(
    model: mujoco.MjModel,
    channels: Sequence[str],
    traces: Sequence[Mapping[str, Array]],
) -> dict[str, list[Flags]]:
    if not all("command" in trace for trace in traces):
        return {}
    away = [np.abs(trace["command"] - trace["measured"]) for trace in traces]
    typical = np.sqrt((np.concatenate(away) ** 2).mean(axis=0))
    flags = [part > np.maximum(3.0 * typical, 1e-12) for part in away]
    if all("duty" in trace for trace in traces):
        flags = [np.abs(trace["duty"]) > _FULL for trace in traces]
    joints = {model.joint(i).name for i in range(model.njnt)}
    for column, name in enumerate(channels):
        actuator = actuator_of(model, name) if name in joints else -1
        if actuator < 0 or not model.actuator_forcelimited[actuator]:
            continue
        low, high = model.actuator_forcerange[actuator]
        for flag, trace in zip(flags, traces, strict=True):
            force = _force(model, actuator, trace, column)
            flag[:, column] |= (force > 0.95 * high) | (force < 0.95 * low)
    return {"saturated": flags}


def _force(
    model: mujoco.MjModel, actuator: int, trace: Mapping[str, Array], column: int
) -> Array:
    """Return the force commanded of an actuator, before its limit, (T,)."""
    gain, bias = model.actuator_gainprm[actuator], model.actuator_biasprm[actuator]
    gear = float(model.actuator_gear[actuator, 0])
    position, speed = trace["measured"][:, column], _speed(trace)[:, column]
    asked = gain[0] * command_at(model, actuator) * trace["command"][:, column]
    pulled, braked = bias[1] * gear * position, bias[2] * gear * speed
    return np.asarray(asked + bias[0] + pulled + braked)


def _contact(
    traces: Sequence[Mapping[str, Array]], channels: int
) -> dict[str, list[Flags]]:
    if not any("contact" in trace and np.any(trace["contact"]) for trace in traces):
        return {}
    found: dict[str, list[Flags]] = {"contact": [], "after contact": [], "free": []}
    for trace in traces:
        now = np.asarray(trace.get("contact", np.zeros(len(trace["time"]))), bool)
        ever = np.logical_or.accumulate(now)
        parts = {"contact": now, "after contact": ever & ~now, "free": ~ever}
        for name, flag in parts.items():
            found[name].append(np.repeat(flag[:, None], channels, axis=1))
    return found
