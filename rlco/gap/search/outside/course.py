"""The courses that a torque from outside takes most often, and one that takes any.

A torque of any course replaces every effect at its joint, so beside it none can be
named there. But what acts from outside is mostly one of three things: it drifts, over
seconds; it knocks, for fractions of a second; or the encoder errs with the position.
Beside only this, effects at the very joint are told apart, since these go with its
motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.ndimage import uniform_filter1d
from scipy.sparse.linalg import spsolve

from rlco.gap.compare.arm.encoder_error import at_times
from rlco.gap.compare.arm.free_torque import hats
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.arm.torque_over_time import as_hats, finer_knots, hat_shapes
from rlco.gap.compare.segments import command_steps
from rlco.gap.logs.log import Array

_SLOW = 2.5  # between knots where nothing happens [s]
_FINE = 0.04  # the same within an event [s]
_SUDDEN = 5.0  # deviation from slow over the usual one, within an event
_SMOOTH = 0.08  # in which a torque is averaged to see it [s]
_MARGIN = 0.1  # before and after an event [s]
_WEIGHTED = 8  # fits of what is not sudden
_SLOWEST = 0.05  # speed at which friction takes its sign [rad/s or m/s]
_PLACES = np.linspace(0.0, 1.0, 7)  # quantiles of the position
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
#: Parts of the usual, beside which a constant torque or an offset is an effect again;
#: those with fewer amounts first.
PARTS = (Course(misreads=True), Course(drifts=True), Course(knocks=True))


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


def begun(
    problem: ArmRollouts, joint: str, torque: Mapping[int, Array], course: Course
) -> Begun:
    """Return the hats of a course, and with them the part of a torque that is in it.

    Args:
        problem: The robot and its log.
        joint: The joint.
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
    sudden = _beside_motion(problem, joint, torque, slow)
    drift = as_hats(problem, sudden.torque, slow, sudden.weights)
    fine: list[Array] = [np.zeros(0) for _ in logs]
    if course.knocks:
        fine = _within_events(problem, sudden.away)
    both = [_merged(*one) for one in zip(slow, fine, strict=True)]
    torques: list[Array] = []
    free: list[Array] = []
    projected = as_hats(problem, sudden.torque, both)
    for times, own, base, more in zip(both, projected, drift, fine, strict=True):
        # What acts for short times is nothing before and after them.
        padded = np.concatenate([[False], np.isin(times, more), [False]])
        inner = padded[:-2] & padded[1:-1] & padded[2:]
        slowly = np.interp(times, slow[len(torques)], base)
        knock = np.where(inner, own - slowly, 0.0)
        torques.append(course.drifts * slowly + course.knocks * knock)
        free.append((inner & course.knocks) | np.full(len(times), course.drifts))
    return Begun(both, torques, np.concatenate(free))


def _evenly(begin: float, end: float) -> Array:
    """Return times at most a slow change apart, (K,) [s]."""
    count = 1 + max(1, int(np.ceil((end - begin) / _SLOW)))
    return np.asarray(np.linspace(begin, end, count))


@dataclass(frozen=True)
class _Sudden:
    """A torque without what goes with the motion, each by recording.

    Attributes:
        torque: The rest, with its drift, (steps,).
        away: How far it is from its drift, over the usual, (steps,).
        weights: How much each step counts, (steps,).
    """

    torque: dict[int, Array]
    away: list[Array]
    weights: list[Array]


def _beside_motion(
    problem: ArmRollouts, joint: str, torque: Mapping[int, Array], slow: list[Array]
) -> _Sudden:
    """Return a torque without what friction, a spring or an inertia may account for.

    What is sudden counts little: the sum of absolute deviations is made small, by least
    squares with weights.
    """
    clocks = [
        command_steps(one, float(problem.model.opt.timestep))
        for one in problem.log.recordings
    ]
    shapes = [
        hat_shapes(problem, index, times).tocsr() for index, times in enumerate(slow)
    ]
    motion = _motions(problem, joint, clocks)
    columns = sparse.hstack([sparse.block_diag(shapes), motion], format="csr")
    count = motion.shape[1]
    goal = np.concatenate([torque[index] for index in range(len(slow))])
    weights = np.ones(len(goal))
    for _ in range(_WEIGHTED):
        counted = columns * weights[:, None]
        squares = (counted.T @ columns).tocsc()
        ridge = 1e-6 * squares.diagonal().mean() * sparse.eye_array(squares.shape[0])
        amounts = spsolve((squares + ridge).tocsc(), counted.T @ goal)
        away = np.abs(goal - columns @ amounts)
        away /= float(np.median(away)) / 0.6745
        weights = 1.0 / np.maximum(away, 0.1)
    rest = goal - motion @ amounts[-count:]
    ends = np.cumsum([len(one) for one in clocks])[:-1]
    # A torque from measured positions is noisy from step to step; a knock lasts.
    step = float(problem.model.opt.timestep)
    lasting = [
        uniform_filter1d(one, max(1, round(_SMOOTH / step)), mode="nearest")
        for one in np.split(goal - columns @ amounts, ends)
    ]
    usual = float(np.median(np.abs(np.concatenate(lasting)))) / 0.6745
    each = [np.split(one, ends) for one in (rest, weights)]
    return _Sudden(
        dict(enumerate(each[0])), [np.abs(one) / usual for one in lasting], each[1]
    )


def _motions(problem: ArmRollouts, joint: str, clocks: list[Array]) -> Array:
    """Return functions of a joint's motion, scaled to one, (steps, functions)."""
    found = []
    for index, times in enumerate(clocks):
        recording = np.full(len(times), index)
        position, velocity = at_times(problem, joint, recording, times)
        acceleration = np.gradient(velocity, times)
        friction = np.tanh(velocity / _SLOWEST)
        found.append(np.stack([position, velocity, acceleration, friction]))
    every = np.concatenate(found, axis=1)
    places = np.unique(np.quantile(every[0], _PLACES))
    # All hats together are a constant, which is a drift.
    shapes = np.concatenate([every[1:], hats(every[0], places)[1:]])
    return np.asarray(
        (shapes / np.maximum(np.abs(shapes).max(axis=1), 1e-12)[:, None]).T
    )


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
