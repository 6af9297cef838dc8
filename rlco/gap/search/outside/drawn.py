"""What acts at a joint that was set free, as a report draws it."""

from __future__ import annotations

import numpy as np

from rlco.gap.compare.arm.encoder_error import at_times
from rlco.gap.compare.arm.free_torque import hats, session_begins
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.verdict import FreeForm
from rlco.gap.logs.log import Array
from rlco.gap.search.outside.freed import USUAL_ERROR, Amounts, Freed
from rlco.gap.search.state import State

_KNOTS = 8  # of the torque that is drawn over position and over velocity


def drawn(state: State, problem: ArmRollouts, found: State, freed: Freed) -> FreeForm:
    """Return the torque of the free joint, or its encoder's error, as it is drawn.

    Args:
        state: Of a search without it.
        problem: Its robot and log.
        found: What was found beside it.
        freed: What the joint may do.
    """
    torques = freed.torques
    # Without it, the robot may even diverge under these effects.
    alone = state.setting.score([found.best.fit])
    gain = 1.0 - found.best.error / (alone[0].error if alone else float("inf"))
    amounts, errors = _amounts(state, found, freed)
    if freed.encoder is not None:
        scale = problem.noise[problem.layout.channel]
        by_torque = np.linalg.norm((amounts @ torques.moved) / scale)
        by_error = np.linalg.norm((errors @ freed.misread()) / scale)
        if by_error > by_torque:
            over_position = np.stack([freed.encoder.position, USUAL_ERROR * errors])
            nothing = np.zeros((2, 0))
            return FreeForm(
                torques.joint,
                gain,
                over_position,
                nothing,
                nothing,
                predicts=False,
                of_encoder=True,
            )
    torque = amounts * torques.torque
    where = problem, torques.joint, torques.recording, torques.time
    position, velocity = at_times(*where)
    time = torques.time + session_begins(problem.log.recordings)[torques.recording]
    return FreeForm(
        torques.joint,
        gain,
        _over(position, torque),
        _over(velocity, torque),
        np.stack([time, torque]),
        predicts=False,
    )


def _amounts(state: State, found: State, freed: Freed) -> tuple[Array, Array]:
    """Return the torques in all, (K,), and errors of the encoder, (P,).

    Beside what was found, where there are few of them.
    """
    if freed.any:
        return freed.amounts, np.zeros(0)
    (rows,) = freed.problem.residuals([Hypothesis(found.best.effects)])
    fitted = Amounts.of(state, freed.columns()).fitted(rows)
    fitted = fitted[len(state.setting.prior) :]
    amounts, count = freed.amounts.copy(), int(freed.free.sum())
    amounts[freed.free] += fitted[:count]
    return amounts, freed.errors + fitted[count:]


def _over(values: Array, torque: Array) -> Array:
    """Return the torque as a smooth function of a value, (2, knots)."""
    knots = np.unique(np.quantile(values, np.linspace(0.005, 0.995, _KNOTS)))
    weights = hats(values, knots)
    squares = weights @ weights.T
    ridge = 1e-3 * float(np.trace(squares)) / len(squares)
    fitted = np.linalg.solve(squares + ridge * np.eye(len(squares)), weights @ torque)
    return np.stack([knots, fitted])
