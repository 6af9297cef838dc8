"""Doubt by a free form: would a torque of any shape do better than what is named?

What is named, or the model where nothing is, is held against the same with a smooth
torque of position and of velocity at one joint, and with a smooth error of its encoder
over position. Its amounts are fitted to the training recordings, linearly; held out it
must do clearly better. An effect outside the library then is at work there, or a named
one stands for it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from rlco.gap.compare.arm.encoder_error import EncoderError, encoder_error
from rlco.gap.compare.arm.free_torque import (
    FreeTorque,
    free_torque,
    hats,
    knots_of,
    session_begins,
)
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.compare.verdict import FreeForm
from rlco.gap.logs.log import Array
from rlco.gap.search.comparison import clearly_better
from rlco.gap.search.judge import NAMED, found, kind
from rlco.gap.search.setting import Setting, training_first
from rlco.gap.search.state import State

Form = FreeTorque | EncoderError

GAIN = 0.1  # share of the held-out error that a free form must remove to raise doubt
_RIDGE = 1e-3  # of the largest amount's weight: what motion hardly shows stays small
_SECOND = 1.0  # between knots of the torque over time [s]


def free_form(state: State) -> State:
    """Return the state with the free form that does clearly better, if there is one."""
    setting = state.setting
    # What was lacking before is subtracted from a later recording: the change is not.
    problem, weight = setting.problem.weighted_base()
    if state.free_form is not None or kind(state) not in (*NAMED, "unexplained"):
        return state
    if not isinstance(problem, ArmRollouts | TorqueLog):
        return state
    best = found(state)
    hypothesis = Hypothesis(best.effects)
    order = (*setting.train, *setting.heldout)
    winner: tuple[float, Form, Array, Array] | None = None
    for free in _forms(problem, hypothesis, sorted(order)):
        columns = _whitened(setting, free.moved * weight)
        amounts = _fitted(columns, best.everything, len(best.fit.residual))
        better = best.everything + amounts @ columns
        error = _heldout(better, len(best.fit.residual))
        if error > (1.0 - GAIN) * best.error:
            continue
        series = setting.blocks, setting.series
        if not clearly_better(better, best.everything, *series):
            continue
        if winner is None or error < winner[0]:
            winner = error, free, amounts, columns
    if winner is None:
        return state
    error, free, amounts, columns = winner
    gain = 1.0 - error / best.error
    if isinstance(free, EncoderError):
        nothing = np.zeros((2, 0))
        over_position = np.stack([free.position, amounts])
        shape = FreeForm(free.joint, gain, over_position, nothing, nothing)
        return replace(state, free_form=replace(shape, of_encoder=True))
    return replace(state, free_form=_shape(state, free, amounts, columns, gain))


def _forms(
    problem: ArmRollouts | TorqueLog, hypothesis: Hypothesis, recordings: Sequence[int]
) -> Iterator[Form]:
    """Yield what may act at each joint."""
    for joint in problem.log.joints:
        found: list[Form | None] = []
        if isinstance(problem, TorqueLog):
            found = [_free_of_measured(problem, joint, recordings)]
        else:
            where = problem, hypothesis, joint, recordings
            found = [free_torque(*where), encoder_error(*where)]
        yield from (free for free in found if free is not None)


def _free_of_measured(
    problem: TorqueLog, joint: str, recordings: Sequence[int]
) -> FreeTorque | None:
    """Return torques of any form at a joint whose torque is measured.

    What acts there a drive need not supply, so the change is the torque itself.
    """
    column = problem.log.joints.index(joint)
    motions = [problem.motions[index] for index in recordings]
    position = np.concatenate([one.position[:, column] for one in motions])
    velocity = np.concatenate([one.velocity[:, column] for one in motions])
    found = knots_of(position, velocity)
    if found is None:
        return None
    places, speeds = found
    shape = np.concatenate([hats(position, places), hats(velocity, speeds)])
    moved = np.zeros((len(shape), len(position), len(problem.log.joints)))
    moved[:, :, column] = shape
    return FreeTorque(joint, places, speeds, moved.reshape(len(shape), -1))


def _heldout(everything: Array, training: int) -> float:
    return float(np.sqrt(np.mean(everything[training:] ** 2)))


def _whitened(setting: Setting, moved: Array) -> Array:
    """Return whitened changes of all residuals, training first, (knots, N)."""
    order = training_first(setting.problem, setting.train, setting.heldout)
    return setting.weights.together.whiten(moved[:, order])


def _fitted(columns: Array, residual: Array, training: int) -> Array:
    """Return the amounts that leave least of the training residual, (knots,)."""
    rows, goal = columns[:, :training], residual[:training]
    squares = rows @ rows.T
    size = _RIDGE * float(np.trace(squares)) / len(squares)
    return np.asarray(
        -np.linalg.solve(squares + size * np.eye(len(squares)), rows @ goal)
    )


def _shape(
    state: State, free: FreeTorque, amounts: Array, columns: Array, gain: float
) -> FreeForm:
    """Return a free form as it is drawn: torque over position, velocity and time."""
    count = len(free.position)
    over_position, over_velocity = amounts[:count].copy(), amounts[count:].copy()
    # A constant is in both: it is reported with the position.
    constant = float(over_velocity.mean())
    over_position, over_velocity = over_position + constant, over_velocity - constant
    time, torque = _over_time(
        state.setting, found(state).everything, columns[:count].sum(axis=0)
    )
    return FreeForm(
        free.joint,
        gain,
        np.stack([free.position, over_position]),
        np.stack([free.velocity, over_velocity]),
        np.stack([time, torque]),
    )


def _over_time(
    setting: Setting, residual: Array, constant: Array
) -> tuple[Array, Array]:
    """Return a torque over the time of the recordings, one after the other [s].

    A servo forgets within a second, so a torque that changes slowly changes positions
    as a constant one does, by as much as it is at that time.
    """
    layout, log = setting.problem.layout, setting.problem.log
    begins = session_begins(log.recordings)
    order = training_first(setting.problem, setting.train, setting.heldout)
    when = (layout.time + begins[layout.recording])[order]
    knots = np.arange(when.min(), when.max() + _SECOND, _SECOND)
    weights = hats(when, knots)
    power = weights @ constant**2
    along = weights @ (constant * residual)
    shown = power > 1e-3 * power.max()
    return knots[shown], -along[shown] / power[shown]
