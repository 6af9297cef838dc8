"""The courses that a torque from outside takes most often, and one that takes any.

A torque of any course replaces every effect at its joint, so beside it none can be
named there. But what acts from outside is mostly one of three things: it drifts, over
seconds; it knocks, for fractions of a second; or the encoder errs with the position.
What is only this leaves effects at the very joint to be told, since these go with its
motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.arm.torque_over_time import as_hats, finer_knots, hat_torque
from rlco.gap.compare.segments import command_steps
from rlco.gap.logs.log import Array

_SLOW = 2.5  # between knots where nothing happens [s]
_FINE = 0.04  # the same within an event [s]
_SUDDEN = 6.0  # deviation from slow over the usual one, within an event
_MARGIN = 0.1  # before and after an event [s]
_WEIGHTED = 8  # fits of a drift
_EVENTS = 0.5  # share of the time that events may take


@dataclass(frozen=True)
class Course:
    """What may act at a joint.

    Attributes:
        drifts: A torque that changes over seconds.
        knocks: A torque of any course for short times.
        misreads: An error of the encoder over its position, which its servo follows.
        any: A torque of any course all the time; the encoder may be misread.
    """

    drifts: bool = False
    knocks: bool = False
    misreads: bool = False
    any: bool = False


ANY = Course(any=True)
USUAL = Course(drifts=True, knocks=True, misreads=True)
#: Parts of the usual, tried where nothing is named beside all of it: a constant torque
#: and an offset of the encoder then are effects again.
PARTS = (Course(knocks=True), Course(misreads=True), Course(drifts=True))


@dataclass(frozen=True)
class Begun:
    """A torque as hats over time, from which an estimate begins.

    Attributes:
        knots: Times of each recording's hats, on its clock [s].
        torques: Of each recording, one at each hat [N m or N].
        free: Which of all hats may change, (K,).
    """

    knots: list[Array]
    torques: list[Array]
    free: Array


def begun(problem: ArmRollouts, torque: Mapping[int, Array], course: Course) -> Begun:
    """Return the hats of a course, and with them the part of a torque that is in it.

    Args:
        problem: The robot and its log.
        torque: What keeps the joint on its measured path, by recording, one at each
            physics step, (steps,).
        course: What may act.
    """
    if course.any:
        knots = finer_knots(problem, torque)
        amounts = as_hats(problem, torque, knots)
        return Begun(knots, amounts, np.ones(sum(map(len, knots)), dtype=bool))
    logs = problem.log.recordings
    slow: list[Array] = [
        _evenly(one.time[0], one.time[0] + one.seconds) for one in logs
    ]
    drift, away = _drift(problem, torque, slow)
    fine: list[Array] = [np.zeros(0) for _ in logs]
    if course.knocks:
        fine = _within_events(problem, away)
    both = [_merged(*one) for one in zip(slow, fine, strict=True)]
    torques: list[Array] = []
    free: list[Array] = []
    projected = as_hats(problem, torque, both)
    for times, own, base, more in zip(both, projected, drift, fine, strict=True):
        # What acts for short times is nothing before and after them.
        padded = np.concatenate([[False], np.isin(times, more), [False]])
        sudden = padded[:-2] & padded[1:-1] & padded[2:]
        slowly = np.interp(times, slow[len(torques)], base)
        knock = np.where(sudden, own - slowly, 0.0)
        torques.append(course.drifts * slowly + course.knocks * knock)
        free.append((sudden & course.knocks) | np.full(len(times), course.drifts))
    return Begun(both, torques, np.concatenate(free))


def _evenly(begin: float, end: float) -> Array:
    """Return times at most a slow change apart, (K,) [s]."""
    count = 1 + max(1, int(np.ceil((end - begin) / _SLOW)))
    return np.asarray(np.linspace(begin, end, count))


def _drift(
    problem: ArmRollouts, torque: Mapping[int, Array], slow: list[Array]
) -> tuple[list[Array], list[Array]]:
    """Return the drift of a torque, and how far from it each step is, over the usual.

    What is sudden counts little in it: absolute deviations are made small, by least
    squares with weights.

    Returns:
        Of each recording, torques at the knots (K,) and deviations (steps,).
    """
    weights: list[Array] | None = None
    for _ in range(_WEIGHTED):
        drift = as_hats(problem, torque, slow, weights)
        away = [
            np.abs(torque[index] - hat_torque(problem, index, *one))
            for index, one in enumerate(zip(slow, drift, strict=True))
        ]
        usual = float(np.median(np.concatenate(away))) / 0.6745
        away = [one / usual for one in away]
        weights = [1.0 / np.maximum(one, 0.1) for one in away]
    return drift, away


def _within_events(problem: ArmRollouts, away: list[Array]) -> list[Array]:
    """Return times within events, where a torque is far from its drift [s].

    Args:
        problem: The robot and its log.
        away: How far, over the usual, (steps,) of each recording.
    """
    step = float(problem.model.opt.timestep)
    wide = np.ones(2 * round(_MARGIN / step) + 1)
    events = [np.convolve(one > _SUDDEN, wide, "same") > 0.5 for one in away]
    if np.concatenate(events).mean() > _EVENTS:
        return [np.zeros(0) for _ in away]  # whatever this is, it is not sudden
    every = max(1, round(_FINE / step))
    clocks = [command_steps(one, step) for one in problem.log.recordings]
    both = zip(clocks, events, strict=True)
    return [clock[::every][here[::every]] for clock, here in both]


def _merged(slow: Array, fine: Array) -> Array:
    """Return times of a drift and of events, none too near to another, (K,) [s]."""
    fine = fine[(fine > slow[0]) & (fine < slow[-1])]
    near = np.abs(slow[:, None] - fine).min(axis=1, initial=np.inf) < _FINE
    near[[0, -1]] = False
    return np.union1d(slow[~near], fine)
