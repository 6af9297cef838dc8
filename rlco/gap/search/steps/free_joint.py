"""Set the torque of one joint free where the residual is large; search beside it.

Knocks, a cable, a drift or a worn encoder act at one joint in a way that no effect of a
library describes, and no other recording repeats. What they do hides what effects do at
other joints, and effects are then named for them. So where a search leaves more than
noise, the torque of a joint may take any course over time, and its encoder may err by
any function of position: these changes cost nothing. If one joint set free lets the
library explain the rest, effects are named beside it, and its torque is drawn.

The torque is first what keeps the joint on its measured path, however large, then
improved by least squares, and its changes are measured again where it then is: large
knocks are not linear.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve

from rlco.gap.compare.arm.encoder_error import at_times
from rlco.gap.compare.arm.following_torque import following_torque
from rlco.gap.compare.arm.free_torque import hats, session_begins
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.arm.torque_over_time import (
    TorqueOverTime,
    as_hats,
    finer_knots,
    torque_over_time,
    with_amounts,
    with_hats,
)
from rlco.gap.compare.problem import Candidate, FreeForm, Hypothesis
from rlco.gap.compare.stability.instability import UnstableModelError
from rlco.gap.logs.log import Array
from rlco.gap.search.fit import candidates_of
from rlco.gap.search.judge import NAMED, kind
from rlco.gap.search.setting import Free, Scored
from rlco.gap.search.state import State
from rlco.gap.search.steps.closing import SENSITIVE
from rlco.gap.search.steps.drop import drop
from rlco.gap.search.steps.elsewhere import Additions, begun_with
from rlco.gap.search.steps.start import start
from rlco.gap.search.whitening import often
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.sensing import ENCODER_SCALE, JOINT_OFFSET
from rlco.physics.effects.targets import actuator_of

LARGE = 1.15  # residual over the noise, in all recordings, for which a joint is freed
GAIN = 0.3  # share of this residual that setting a joint free must remove
FEWER = 0.05  # the same where it leaves fewer effects to be named
JOINTS = 2  # that are tried
LITTLE = 0.1  # the same of an effect beside a free joint
_ENCODER = (ENCODER_SCALE.name, JOINT_OFFSET.name)
_ROUNDS = 6  # estimates of the torque before a search
_PARTS = (1.0, 0.5, 0.2, 0.05)  # of a step that are tried
_SMALLER = 0.1  # share of the residual that a round must remove to be followed
_SEARCHES = 2  # each beside the torque that is left by what the one before found
_KNOTS = 8  # of the torque that is drawn over position and over velocity


@dataclass(frozen=True)
class _Freed:
    """A joint set free: what it does, and with which torques the robot is compared."""

    problem: ArmRollouts
    torques: TorqueOverTime
    amounts: Array  # of each hat in all, (K,)

    @property
    def free(self) -> Free:
        return Free(self.torques.columns())


def free_joint(state: State, additions: Additions) -> Generator[State, None, State]:
    """Yield the state after each step of searches with one joint free; return the last.

    Args:
        state: Of a search that has added and dropped its effects.
        additions: How a search goes on.

    Returns:
        The state of the first of these that explains most of the residual; the given
        one where none does, and with the torque alone where no effect is named beside.
    """
    problem = state.setting.problem
    if _residual(state.best) <= LARGE or state.lateness is not None:
        return state
    # Where a motor hardly holds its arm, small differences of the model decide on its
    # course, and a torque that makes up for them hides how uncertain effects are.
    if state.sensitivity > SENSITIVE:
        return state
    # With one joint, nothing tells a free torque from an effect.
    if not isinstance(problem, ArmRollouts) or len(problem.log.joints) < 2:
        return state
    for base, joint in _likely(state, problem)[:JOINTS]:
        yield state
        found = yield from _beside(state, problem, base, joint, additions)
        if found is None:
            continue
        if found.best.effects and kind(found) in NAMED:
            return found
        # No effect is named beside it, but it is there.
        return replace(state, free_form=found.free_form)
    return state


def _likely(state: State, problem: ArmRollouts) -> list[tuple[Scored, str]]:
    """Return joints that explain most when they are free, each beside which effects.

    Each is kept on its measured path; what then is left is left at the others.
    """
    bases = {one.names: one for one in (*_singles(state), state.best, state.none)}
    none_free = np.zeros((0, len(problem.layout.channel)))
    amounts = _Amounts.of(state, none_free)
    found = []
    for joint in problem.log.joints:
        if actuator_of(problem.model, joint) < 0:
            continue
        errors = {}
        for names, base in bases.items():
            hypothesis = Hypothesis(base.effects)
            torque = following_torque(problem, hypothesis, joint)
            if torque is None:
                continue
            (rows,) = problem.with_torques(joint, torque).residuals([hypothesis])
            errors[names] = amounts.residual(rows)
        if errors:
            best = min(errors, key=errors.__getitem__)
            nothing = errors.get(state.none.names, np.inf)
            if errors[best] > (1.0 - FEWER) * nothing:
                best = state.none.names  # what explains little is found again
            found.append((errors[best], bases[best], joint))
    found.sort(key=lambda one: one[0])
    return [(base, joint) for _, base, joint in found]


def _singles(state: State) -> list[Scored]:
    """Return the best single effects of a search."""
    singles = (one for one in state.scores.values() if len(one.effects) == 1)
    return sorted(singles, key=lambda one: one.fit.cost)[:3]


@dataclass(frozen=True)
class _Amounts:
    """Amounts of changes that make residuals smallest, by ridge regression.

    Those of a free torque each reach over few rows, so their products are sparse.
    """

    columns: Any  # in units of the noise, each times its prior, (changes, N)
    solve: Callable[[Array], Array]
    prior: Array
    scale: Array

    @classmethod
    def of(cls, state: State, free: Array) -> _Amounts:
        """Return them for the tolerance's parameters and free changes (free, N)."""
        setting, problem = state.setting, state.setting.problem
        scale = problem.noise[problem.layout.channel]
        counts = often(len(scale) if problem.calibration is None else -1)
        prior = setting.prior / np.sqrt(counts)
        tolerance = setting.weights.moved * prior[:, None] / scale
        columns = sparse.vstack(
            [sparse.csr_array(tolerance), sparse.csr_array(free / scale)], format="csr"
        )
        squares = (columns @ columns.T).toarray()
        factor = cho_factor(squares + np.eye(len(squares)))
        whole = np.concatenate([prior, np.ones(len(free))])
        return cls(columns, lambda rows: cho_solve(factor, rows), whole, scale)

    def fitted(self, rows: Array) -> Array:
        """Return the amounts for residuals (N,), (changes,)."""
        along = self.columns @ (rows / self.scale)
        return np.asarray(-self.solve(along) * self.prior)

    def residual(self, rows: Array) -> float:
        """Return the root mean square of residuals (N,), whitened."""
        if not np.isfinite(rows).all():
            return float("inf")
        scaled = rows / self.scale
        along = self.columns @ scaled
        square = float(scaled @ scaled - along @ self.solve(along))
        return float(np.sqrt(max(square, 0.0) / len(rows)))


def _beside(
    state: State,
    problem: ArmRollouts,
    base: Scored,
    joint: str,
    additions: Additions,
) -> Generator[State, None, State | None]:
    """Yield the given state at each step of a search with a joint free.

    Returns:
        The last state of that search; None where it explains little.
    """
    effects = tuple(one for one in base.effects if not _is_of_encoder(one, joint))
    for _ in range(_SEARCHES):
        # The torque is estimated beside what is known of the effects.
        estimated = _estimated(state, problem, Hypothesis(effects), joint)
        if estimated is None:
            return None
        freed = estimated
        try:
            begun = _begun(state, freed)
        except UnstableModelError:
            return None  # with that torque and no effect, the robot runs away
        if effects:
            begun, fits = begun.fit([effects])
            if not fits:
                return None
            begun = drop(begun_with(begun, fits[0]))
        found = begun
        for step in additions(begun):
            found = step
            yield state  # what is found is kept aside until it is whole
        found = without_small(found)
        known, effects = effects, found.best.effects
        if candidates_of(effects) == candidates_of(known):
            break
    if not _is_worth_it(state.best, found.best):
        return None
    form = _drawn(state, problem, found, freed)
    return replace(found, as_it_is=problem, free_form=form)


def without_small(state: State) -> State:
    """Return the state without effects that explain little beside a free joint.

    A free torque is not quite what acts there, and some effect always makes up for a
    little of the difference.
    """
    while state.best.effects:
        best, effects = state.best, state.best.effects
        fewer = [tuple(e for e in effects if e is not one) for one in effects]
        options = [state.none]
        if len(effects) > 1:
            state, options = state.fit(fewer)
        least = min(options, key=_residual, default=None)
        if least is None or _residual(best) < (1.0 - LITTLE) * _residual(least):
            break
        state = replace(state, best=least).noted(effects=least.effects, dropped=True)
    return state


def _residual(one: Scored) -> float:
    """Return the root mean square of the residual of a set of effects, everywhere.

    Held-out recordings alone may hold little of what happens once.
    """
    return float(np.sqrt(np.mean(one.everything**2)))


def _is_worth_it(before: Scored, found: Scored) -> bool:
    """Return whether a free joint explains enough to be named for."""
    fewer = len(found.effects) < len(before.effects)
    return _residual(found) < (1.0 - (FEWER if fewer else GAIN)) * _residual(before)


def _begun(state: State, freed: _Freed) -> State:
    """Return the first state of a search with a joint free."""
    setting = state.setting
    begun = start(
        freed.problem,
        spread=float(np.max(setting.prior, initial=0.0)),
        exclude=setting.excluded,
        free=freed.free,
    )
    joint = freed.torques.joint
    wider = {**begun.setting.library, **setting.library}
    wider = {c: known for c, known in wider.items() if not _is_of_encoder(c, joint)}
    begun = replace(begun, setting=replace(begun.setting, library=wider))
    begun = replace(begun, trail=state.trail)
    return begun.noted(effects=(), free_joint=joint)


def _is_of_encoder(one: Candidate | AppliedEffect, joint: str) -> bool:
    """Return whether an effect is at an encoder whose error is free anyway."""
    return one.target == joint and one.name in _ENCODER


def _estimated(
    state: State, problem: ArmRollouts, hypothesis: Hypothesis, joint: str
) -> _Freed | None:
    """Return a joint set free, with the torque that fits best; None if it diverges.

    Args:
        state: Of a search without it.
        problem: Its robot and log.
        hypothesis: What else acts.
        joint: The joint.
    """
    scale = problem.noise[problem.layout.channel]

    def compared(moved: ArmRollouts) -> tuple[float, Array]:
        (rows,) = moved.residuals([hypothesis])
        return float(np.sqrt(np.mean((rows / scale) ** 2))), rows

    followed = following_torque(problem, hypothesis, joint)
    if followed is None:
        return None
    knots = finer_knots(problem, followed)
    begun = as_hats(problem, followed, knots)
    moved = with_hats(problem, joint, knots, begun)
    size, rows = compared(moved)
    torques = torque_over_time(moved, hypothesis, joint, knots)
    if torques is None or not np.isfinite(size):
        return None
    total = np.concatenate(begun) / torques.torque
    for _ in range(_ROUNDS):
        # Torques alone: an encoder's error would cancel a constant one.
        fitted = _Amounts.of(state, torques.moved).fitted(rows)
        step, before = fitted[len(state.setting.prior) :], size
        for part in _PARTS:
            # A motor at its limit does not hold against more: whole steps go too far.
            trial = with_amounts(problem, torques, total + part * step)
            size, rows = compared(trial)
            if size < before:
                break
        else:
            break
        moved, total = trial, total + part * step
        again = torque_over_time(moved, hypothesis, joint, knots)
        if again is None:
            return None
        torques = again
        if size > (1.0 - _SMALLER) * before:
            break
    return _Freed(moved, torques, total)


def _drawn(state: State, problem: ArmRollouts, found: State, freed: _Freed) -> FreeForm:
    """Return the torque of the free joint, as it is drawn."""
    torques = freed.torques
    # Without it, the robot may even diverge under these effects.
    alone = state.setting.score([found.best.fit])
    before = alone[0].error if alone else float("inf")
    torque = freed.amounts * torques.torque
    where = problem, torques.joint, torques.recording, torques.time
    position, velocity = at_times(*where)
    time = torques.time + session_begins(problem.log.recordings)[torques.recording]
    return FreeForm(
        torques.joint,
        1.0 - found.best.error / before,
        _over(position, torque),
        _over(velocity, torque),
        np.stack([time, torque]),
        predicts=False,
    )


def _over(values: Array, torque: Array) -> Array:
    """Return the torque as a smooth function of a value, (2, knots)."""
    knots = np.unique(np.quantile(values, np.linspace(0.005, 0.995, _KNOTS)))
    weights = hats(values, knots)
    squares = weights @ weights.T
    ridge = 1e-3 * float(np.trace(squares)) / len(squares)
    fitted = np.linalg.solve(squares + ridge * np.eye(len(squares)), weights @ torque)
    return np.stack([knots, fitted])
