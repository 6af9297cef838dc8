"""Set the torque of one joint free where the residual is large; search beside it.

Knocks, a cable, a drift or a worn encoder act at one joint in a way that no effect of a
library describes, and no other recording repeats. What they do hides what effects do at
other joints, and effects are then named for them. So where a search leaves more than
noise, the torque of a joint may take any course over time, and its encoder may err by
any function of position: these changes cost nothing. If one joint set free lets the
library explain the rest, effects are named beside it, and its torque is drawn.

First only what acts from outside most often is allowed, a drift, knocks or an error of
the encoder, beside which effects at the same joint can be named, too. A torque of any
course is allowed where this leaves more than noise.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rlco.gap.compare.arm.encoder_error import encoder_error
from rlco.gap.compare.arm.following_torque import following_torque
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Candidate, Hypothesis
from rlco.gap.compare.stability.instability import UnstableModelError
from rlco.gap.search.fit import candidates_of
from rlco.gap.search.judge import NAMED, kind
from rlco.gap.search.outside.course import ANY, PARTS, USUAL, Course
from rlco.gap.search.outside.drawn import drawn
from rlco.gap.search.outside.freed import USUAL_ERROR, Amounts, Freed, estimated
from rlco.gap.search.setting import Free, Scored
from rlco.gap.search.state import State
from rlco.gap.search.steps.closing import SENSITIVE
from rlco.gap.search.steps.drop import drop
from rlco.gap.search.steps.elsewhere import Additions, begun_with
from rlco.gap.search.steps.start import start
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.sensing import ENCODER_SCALE, JOINT_OFFSET
from rlco.physics.effects.targets import actuator_of

LARGE = 1.15  # residual over the noise, in all recordings, for which a joint is freed
GAIN = 0.3  # share of this residual that a torque of any course must remove
FEW = 0.1  # the same of a course that has few amounts
FEWER = 0.05  # the same where it leaves fewer effects to be named
SIMPLER = 1.05  # ratio to the residual of a course that a part of it may leave instead
LITTLE = 0.1  # share that an effect must explain beside a torque of any course
LITTLE_OF_FEW = 0.03  # the same beside a course of few amounts
JOINTS = 2  # that are tried
ROUGHLY = 6  # knots of an encoder's error, to see which joint it explains most at
_ENCODER = (ENCODER_SCALE.name, JOINT_OFFSET.name)

Effects = tuple[AppliedEffect, ...]


@dataclass(frozen=True)
class _AtJoint:
    """Where searches with a joint free are made.

    Attributes:
        state: Of a search without it.
        problem: Its robot and log.
        joint: The joint.
        additions: How a search goes on.
    """

    state: State
    problem: ArmRollouts
    joint: str
    additions: Additions

    def freed(self, effects: Effects, course: Course) -> Freed | None:
        """Return the joint set free beside effects; None where the robot diverges."""
        hypothesis = Hypothesis(effects)
        return estimated(self.state, self.problem, hypothesis, self.joint, course)


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
        at = _AtJoint(state, problem, joint, additions)
        found = yield from _searched(at, base.effects)
        if found is None:
            continue
        if _names(found):
            return found
        # No effect is named beside it, but it is there.
        return replace(state, free_form=found.free_form)
    return state


def _searched(at: _AtJoint, base: Effects) -> Generator[State, None, State | None]:
    """Yield the given state at each step of searches with a joint free.

    Args:
        at: The joint.
        base: Effects beside which it explains most.

    Returns:
        The last state of the search to follow; None where the joint explains little.
    """
    effects = tuple(one for one in base if not _is_of_encoder(one, at.joint))
    # One at the joint that made up for a part of what acts there hides the part.
    others = tuple(one for one in effects if one.target != at.joint)
    usual = yield from _beside(at, others, USUAL)
    if usual is not None and not _is_enough(at.state.best, usual.best):
        usual = (yield from _refined(at, usual, others, USUAL)) or usual
    if usual is None or not _is_enough(at.state.best, usual.best):
        yield at.state
        found = yield from _again(at, effects, ANY)
        worth = found is not None and _is_worth_it(at.state.best, found.best, GAIN)
        return found if worth else None
    # Beside less, more is told apart: a drift replaces a constant torque, an error of
    # the encoder an offset. A part that leaves as little is what acts.
    least = SIMPLER * _residual(usual.best)
    known = usual.best.effects
    for part in _parts(at, known, least):
        found = yield from _again(at, known, part)
        if found is not None and _names(found) and _residual(found.best) <= least:
            return found
    if not known:
        return usual
    again = yield from _beside(at, known, USUAL)
    return usual if again is None else again


def _parts(at: _AtJoint, effects: Effects, least: float) -> Sequence[Course]:
    """Return parts of the usual course that may suffice, the best first.

    Args:
        at: The joint.
        effects: That were named beside the whole; without any, no part is ruled out.
        least: Residual that a part may leave.
    """
    if not effects:
        return PARTS
    every = {part: at.freed(effects, part) for part in PARTS}
    hypothesis = Hypothesis(effects)
    residual = {
        part: freed.residual(at.state, hypothesis)
        for part, freed in every.items()
        if freed is not None
    }
    enough = (part for part in residual if residual[part] <= least)
    return sorted(enough, key=residual.__getitem__)


def _names(found: State) -> bool:
    """Return whether a search names effects."""
    return bool(found.best.effects) and kind(found) in NAMED


def _likely(state: State, problem: ArmRollouts) -> list[tuple[Scored, str]]:
    """Return joints that explain most when they are free, each beside which effects.

    Each is kept on its measured path, and what then is left is left at the others; or
    its encoder errs as fits best.
    """
    bases = {one.names: one for one in (*_singles(state), state.best, state.none)}
    found = []
    for joint in problem.log.joints:
        if actuator_of(problem.model, joint) < 0:
            continue
        errors = {n: _with_free(state, problem, b, joint) for n, b in bases.items()}
        best = min(errors, key=errors.__getitem__)
        if errors[best] > (1.0 - FEWER) * errors[state.none.names]:
            best = state.none.names  # what explains little is found again
        if errors[best] < (1.0 - FEWER) * _residual(state.best):
            found.append((errors[best], bases[best], joint))
    found.sort(key=lambda one: one[0])
    return [(base, joint) for _, base, joint in found]


def _with_free(state: State, problem: ArmRollouts, base: Scored, joint: str) -> float:
    """Return about the residual with a joint free beside some effects.

    Args:
        state: Of a search without it.
        problem: Its robot and log.
        base: The effects.
        joint: The joint.
    """
    # What the library says of its encoder would count twice.
    effects = tuple(e for e in base.effects if not _is_of_encoder(e, joint))
    hypothesis, residual = Hypothesis(effects), float("inf")
    torque = following_torque(problem, hypothesis, joint)
    if torque is not None:
        (rows,) = problem.with_torques(joint, torque).residuals([hypothesis])
        nothing = np.zeros((0, len(problem.layout.channel)))
        residual = Amounts.of(state, nothing).residual(rows)
    if base not in (state.best, state.none):
        return residual
    logs = range(len(problem.log.recordings))
    encoder = encoder_error(problem, hypothesis, joint, logs, ROUGHLY)
    if encoder is not None:
        (rows,) = problem.residuals([hypothesis])
        columns = USUAL_ERROR * encoder.moved
        residual = min(residual, Amounts.of(state, columns).residual(rows))
    return residual


def _singles(state: State) -> list[Scored]:
    """Return the best single effects of a search."""
    singles = (one for one in state.scores.values() if len(one.effects) == 1)
    return sorted(singles, key=lambda one: one.fit.cost)[:3]


def _again(
    at: _AtJoint, effects: Effects, course: Course
) -> Generator[State, None, State | None]:
    """Yield as `_beside` does, and again where that finds others than it began with."""
    found = yield from _beside(at, effects, course)
    if found is None:
        return None
    return (yield from _refined(at, found, effects, course))


def _refined(
    at: _AtJoint, found: State, effects: Effects, course: Course
) -> Generator[State, None, State | None]:
    """Yield as `_beside` does for what a search found, if it began with others.

    What acts at the joint is estimated beside what is known of the effects.
    """
    if found.best.names == frozenset(candidates_of(effects)):
        return found
    return (yield from _beside(at, found.best.effects, course))


def _beside(
    at: _AtJoint, effects: Effects, course: Course
) -> Generator[State, None, State | None]:
    """Yield the given state at each step of a search beside a course at a joint.

    Args:
        at: The joint.
        effects: That the search begins with.
        course: What may act there.

    Returns:
        The last state of that search; None where the robot diverges.
    """
    freed = at.freed(effects, course)
    begun = None if freed is None else _begun(at.state, freed, effects)
    if freed is None or begun is None:
        return None
    found = begun
    for step in at.additions(begun):
        found = step
        yield at.state  # what is found is kept aside until it is whole
    found = without_small(found, LITTLE if course == ANY else LITTLE_OF_FEW)
    form = drawn(at.state, at.problem, found, freed)
    return replace(found, as_it_is=at.problem, free_form=form)


def without_small(state: State, little: float) -> State:
    """Return the state without effects that explain little beside a free joint.

    What is free is not quite what acts there, and some effect always makes up for a
    little of the difference.

    Args:
        state: Of a search beside it.
        little: Share of the residual.
    """
    while state.best.effects:
        best, effects = state.best, state.best.effects
        fewer = [tuple(e for e in effects if e is not one) for one in effects]
        options = [state.none]
        if len(effects) > 1:
            state, options = state.fit(fewer)
        least = min(options, key=_residual, default=None)
        if least is None or _residual(best) < (1.0 - little) * _residual(least):
            break
        state = replace(state, best=least).noted(effects=least.effects, dropped=True)
    return state


def _residual(one: Scored) -> float:
    """Return the root mean square of the residual of a set of effects, everywhere.

    Held-out recordings alone may hold little of what happens once.
    """
    return float(np.sqrt(np.mean(one.everything**2)))


def _is_enough(before: Scored, found: Scored) -> bool:
    """Return whether the usual course at a joint leaves no more than noise."""
    return _residual(found) <= LARGE and _is_worth_it(before, found, FEW)


def _is_worth_it(before: Scored, found: Scored, gain: float) -> bool:
    """Return whether a free joint explains enough to be named for."""
    fewer = len(found.effects) < len(before.effects)
    return _residual(found) < (1.0 - (FEWER if fewer else gain)) * _residual(before)


def _begun(state: State, freed: Freed, effects: Effects) -> State | None:
    """Return the first state of a search with a joint free; None where it diverges.

    Args:
        state: Of a search without it.
        freed: The joint.
        effects: That the search begins with.
    """
    setting = state.setting
    try:
        begun = start(
            freed.problem,
            spread=float(np.max(setting.prior, initial=0.0)),
            exclude=setting.excluded,
            free=Free(freed.columns()),
        )
    except UnstableModelError:
        return None  # with that torque and no effect, the robot runs away
    joint = freed.torques.joint
    wider = {**begun.setting.library, **setting.library}
    if freed.encoder is not None or freed.any:
        wider = {c: known for c, known in wider.items() if not _is_of_encoder(c, joint)}
    begun = replace(begun, setting=replace(begun.setting, library=wider))
    begun = replace(begun, trail=state.trail).noted(effects=(), free_joint=joint)
    if not effects:
        return begun
    begun, fits = begun.fit([effects])
    return drop(begun_with(begun, fits[0])) if fits else None


def _is_of_encoder(one: Candidate | AppliedEffect, joint: str) -> bool:
    """Return whether an effect is at an encoder whose error is free anyway."""
    return one.target == joint and one.name in _ENCODER
