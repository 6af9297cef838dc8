"""Find commands that each arrive late by a time of their own, where much is left.

Whoever sends commands over a network or from a busy computer has them arrive late by
other times, and each moves the joints as an unknown torque would. Where the likelihood
of such times is clearly the best on recordings that were not fitted
(`rlco.gap.search.lateness`), the time of each command is estimated from the motion of
all joints, and the search begins again with commands at these times: other effects are
then found as in a log whose commands were in time. What is named in the end is the
distribution of the times, `random_delay`.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.search.judge import NEAR_FLOOR
from rlco.gap.search.state import State
from rlco.gap.search.steps.command_times import command_times
from rlco.gap.search.steps.elsewhere import Additions
from rlco.gap.search.steps.start import start
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.command import COMMAND_DELAY, CONTROL_RATE, RANDOM_DELAY

GAIN = 0.3  # share of the held-out error that the commands' times must remove
# A slow controller holds commands until its next turn; times of their own would fit as
# well, and what its turns leave besides. Only where it leaves much more is it none.
TURNS = 2.0


def late_commands(state: State, additions: Additions) -> Generator[State, None, State]:
    """Yield the state after each step of a search with commands at their own times.

    Args:
        state: Of a search that has added and dropped its effects.
        additions: How a search goes on.

    Returns:
        Its last state, with the times; the given state where commands do not clearly
        arrive late at random.
    """
    setting = state.setting
    problem, needed = setting.problem, {RANDOM_DELAY.name, COMMAND_DELAY.name}
    if state.best.error <= NEAR_FLOOR or not isinstance(problem, ArmRollouts):
        return state
    # With one joint, nothing tells a late command from a torque.
    if len(problem.log.joints) < 2 or needed & setting.excluded:
        return state
    names = {effect.name for effect in state.best.effects}
    if CONTROL_RATE.name in names and state.best.error < TURNS:
        return state
    lateness = command_times(setting, problem, _with_delay(state))
    if lateness is None:
        return state
    begun = start(
        problem.with_late_commands(lateness.late),
        spread=float(np.max(setting.prior, initial=0.0)),
        exclude=setting.excluded,
    )
    begun = replace(begun, trail=state.trail, lateness=lateness)
    found = begun = begun.noted(effects=(), late_commands=True)
    for step in additions(begun):
        found = step
        yield state  # what was found with other commands is kept aside until whole
    return found if found.best.error < (1.0 - GAIN) * state.best.error else state


def _with_delay(state: State) -> Hypothesis:
    """Return the best effects with a constant delay, from which the others vary."""
    # A slow controller stands for late commands until their times are known.
    slow = CONTROL_RATE.name
    effects = tuple(one for one in state.best.effects if one.name != slow)
    if any(effect.name == COMMAND_DELAY.name for effect in effects):
        return Hypothesis(effects)
    (known,) = COMMAND_DELAY.parameters(state.setting.problem.model, None)
    delays = [
        AppliedEffect(COMMAND_DELAY.name, None, {known.name: size})
        for size in known.starts
    ]
    _, fits = state.fit([(*effects, delay) for delay in delays])
    return Hypothesis(fits[0].effects if fits else effects)
