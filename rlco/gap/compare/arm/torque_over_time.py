"""The change of a rollout by a torque that takes any course over time at one joint.

The course is a sum of hats over time, each with an amount of its own. A servo forgets a
push within a fraction of a second, so one rollout measures the responses to hats that
are far apart, and a few rollouts measure all. Hats are closer to each other where a
torque changes faster than they do, as at the ends of a knock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from rlco.gap.compare.arm.combs import combs_of, until
from rlco.gap.compare.arm.encoder_error import misread
from rlco.gap.compare.arm.free_torque import servo_gain
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis, Integers
from rlco.gap.compare.segments import command_steps
from rlco.gap.logs.log import Array
from rlco.physics.effects.targets import actuator_of

_USUAL = 0.1  # size of a column, as a servo's error [rad or m]
_SPACING = 0.1  # of the hats [s]
_MOST = 800  # hats in all: in longer logs they are further apart
_FINER = 4  # parts that the time between two hats is divided into, at most
_ADDED = 300  # hats that this adds in all, at most
_ROUGH = 3.0  # error of a torque as hats, over that in the median time, for which, and
_LARGE = 0.15  # the same over the largest torque
_SMALL = 0.05  # part of the usual size that is tried


@dataclass(frozen=True)
class TorqueOverTime:
    """Torques at one joint as hats over time, and errors of its encoder.

    Attributes:
        joint: The joint.
        recording: Recording of each hat, (K,).
        time: Time of each hat, on the recording's clock [s], (K,).
        torque: Torque of a column [N m or N].
        moved: Change of the residuals by the usual torque at each hat, (K, N).
        misread: Change by an error of the usual size that depends on the position, at
            each of several positions, (P, N).
    """

    joint: str
    recording: Integers
    time: Array
    torque: float
    moved: Array
    misread: Array

    def columns(self) -> Array:
        """Return all changes, those by torques first, (K + P, N)."""
        return np.concatenate([self.moved, self.misread])


def torque_over_time(
    problem: ArmRollouts,
    hypothesis: Hypothesis,
    joint: str,
    knots: Sequence[Array] | None = None,
) -> TorqueOverTime | None:
    """Return what a torque over time at a joint would change; None without a motor.

    Args:
        problem: The robot and its log.
        hypothesis: What acts already.
        joint: Its servo adds the torque.
        knots: Times of each recording's hats, on its clock [s]; None: equally spaced.
    """
    actuator = actuator_of(problem.model, joint)
    if actuator < 0:
        return None
    torque = _USUAL * abs(servo_gain(problem, hypothesis, actuator))
    if torque == 0.0:
        return None
    knots = _knots(problem) if knots is None else knots
    turns = [combs_of(_begins(times), times) for times in knots]
    pushed = [problem]
    for turn in range(max(int(one.max()) for one in turns) + 1):
        push = {
            index: _each_step(problem, index, times, _SMALL * torque * (own == turn))
            for index, (times, own) in enumerate(zip(knots, turns, strict=True))
        }
        pushed.append(problem.with_torques(joint, push))
    rows = np.concatenate([one.residuals([hypothesis]) for one in pushed])
    if not np.isfinite(rows).all():
        return None
    moved = (rows[1:] - rows[0]) / _SMALL
    layout = problem.layout
    columns = np.zeros((sum(map(len, knots)), moved.shape[1]))
    at = 0
    for index, (times, own) in enumerate(zip(knots, turns, strict=True)):
        here = np.flatnonzero(layout.recording == index)
        begins = _begins(times)
        ends = until(begins, times, own)
        for number, (begin, end) in enumerate(zip(begins, ends, strict=True)):
            near = here[(layout.time[here] >= begin) & (layout.time[here] < end)]
            columns[at + number, near] = moved[own[number], near]
        at += len(times)
    return TorqueOverTime(
        joint,
        np.repeat(np.arange(len(knots)), [len(times) for times in knots]),
        np.concatenate(knots),
        torque,
        columns,
        _USUAL * misread(problem, joint),
    )


def _begins(times: Array) -> Array:
    """Return when each hat begins to act, (K,)."""
    return np.asarray(times - np.diff(times, prepend=2.0 * times[0] - times[1]))


def with_hats(
    problem: ArmRollouts, joint: str, knots: Sequence[Array], torques: Sequence[Array]
) -> ArmRollouts:
    """Return the problem with a torque over time, see `ArmRollouts.with_torques`.

    Args:
        problem: The robot and its log.
        joint: The joint.
        knots: Times of each recording's hats, on its clock [s].
        torques: Of each recording, one at each hat, (K,) [N m or N].
    """
    both = enumerate(zip(knots, torques, strict=True))
    found = {index: _each_step(problem, index, *one) for index, one in both}
    return problem.with_torques(joint, found)


def with_amounts(
    problem: ArmRollouts, free: TorqueOverTime, amounts: Array
) -> ArmRollouts:
    """Return the problem with a torque over time.

    Args:
        problem: The robot and its log.
        free: The hats.
        amounts: Of the usual torque at each, (K,).
    """
    each = [free.recording == i for i in range(len(problem.log.recordings))]
    torque = amounts * free.torque
    times = [free.time[own] for own in each]
    return with_hats(problem, free.joint, times, [torque[own] for own in each])


def _each_step(problem: ArmRollouts, index: int, times: Array, amounts: Array) -> Array:
    """Return amounts at times as one at each physics step of a recording, (steps,)."""
    steps = _steps(problem, index)
    return np.asarray(np.interp(steps, times, amounts) * (steps >= times[0]))


def as_hats(
    problem: ArmRollouts,
    torque: Mapping[int, Array],
    knots: Sequence[Array],
    weights: Sequence[Array] | None = None,
) -> list[Array]:
    """Return a torque as hats: of each recording, one at each hat, (K,) [N m or N].

    Args:
        problem: The robot and its log.
        torque: By recording, one at each physics step, (steps,).
        knots: Times of each recording's hats, on its clock [s].
        weights: By recording, how much each step counts, (steps,); None: all alike.
    """
    found = []
    for index, times in enumerate(knots):
        shape, own = hat_shapes(problem, index, times), torque[index]
        counted = shape if weights is None else shape * weights[index][:, None]
        squares = (counted.T @ shape + 1e-9 * sparse.eye_array(len(times))).tocsc()
        found.append(np.asarray(spsolve(squares, counted.T @ own)))
    return found


def finer_knots(problem: ArmRollouts, torque: Mapping[int, Array]) -> list[Array]:
    """Return times of each recording's hats, more where a torque changes fast [s].

    Args:
        problem: The robot and its log.
        torque: By recording, one at each physics step, (steps,).
    """
    knots = _knots(problem)
    rough = []
    hats_of = as_hats(problem, torque, knots)
    for index, (times, own) in enumerate(zip(knots, hats_of, strict=True)):
        shape = hat_shapes(problem, index, times)
        error = np.asarray((torque[index] - shape @ own) ** 2)
        between = np.clip(
            np.searchsorted(times, _steps(problem, index), "right"), 1, len(times) - 1
        )
        total = np.bincount(between, error, len(times))
        rough.append(total / np.maximum(np.bincount(between, minlength=len(times)), 1))
    every = np.concatenate([one[1:] for one in rough])
    largest = max(float(np.abs(one).max()) for one in torque.values())
    least = max(_ROUGH**2 * float(np.median(every)), (_LARGE * largest) ** 2)
    worst = np.sort(every)[::-1]
    if len(worst) > (most := _ADDED // (_FINER - 1)):
        least = max(least, float(worst[most]))
    parts = np.arange(1, _FINER) / _FINER
    found = []
    for times, errors in zip(knots, rough, strict=True):
        last = np.flatnonzero(errors > least)
        last = last[last > 0]
        length = times[last] - times[last - 1]
        more = times[last - 1][:, None] + length[:, None] * parts
        found.append(np.sort(np.concatenate([times, more.ravel()])))
    return found


def _steps(problem: ArmRollouts, index: int) -> Array:
    """Return the times of a recording's physics steps, (steps,) [s]."""
    return command_steps(
        problem.log.recordings[index], float(problem.model.opt.timestep)
    )


def hat_shapes(problem: ArmRollouts, index: int, times: Array) -> sparse.csr_array:
    """Return how much of each hat each physics step has, (steps, K)."""
    steps = np.clip(_steps(problem, index), times[0], times[-1])
    after = np.clip(np.searchsorted(times, steps, "right"), 1, len(times) - 1)
    share = (steps - times[after - 1]) / (times[after] - times[after - 1])
    row = np.arange(len(steps))
    values = np.concatenate([1.0 - share, share])
    places = np.concatenate([row, row]), np.concatenate([after - 1, after])
    return sparse.csr_array((values, places), shape=(len(steps), len(times)))


def _knots(problem: ArmRollouts) -> list[Array]:
    """Return the times of each recording's hats [s]."""
    logs = problem.log.recordings
    total = sum(one.seconds for one in logs)
    spacing = max(_SPACING, total / max(_MOST - 2 * len(logs), len(logs)))
    return [
        one.time[0] + spacing * np.arange(int(np.ceil(one.seconds / spacing)) + 1)
        for one in logs
    ]
