"""Commands that a log has lost and that are guessed: what an error of a guess changes.

A guess between a step's two levels may be off by half of the step, and one in smooth
motion by next to nothing. Each guess that could be observed is a free amount of a fit,
with the standard deviation of `Recording.guessed`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol, Self

import mujoco
import numpy as np

from rlco.gap.compare.arm.combs import combs_of, until
from rlco.gap.compare.problem import Hypothesis, Layout
from rlco.gap.compare.segments import held_commands
from rlco.gap.logs.log import Array, Log, Recording
from rlco.physics.effects.targets import actuator_of

_OBSERVABLE = 0.5  # error of a command, over the noise, that a joint could show
_COUNTS = 1.0  # root of the sum of squares, over the noise, of a response that counts


class Replayed(Protocol):
    """A robot with a log whose commands may be guessed, see `ArmRollouts`."""

    model: mujoco.MjModel
    log: Log
    layout: Layout
    noise: Array

    def residuals(self, hypotheses: Sequence[Hypothesis]) -> Array:
        """Return measured minus simulated under each hypothesis, (hypotheses, N)."""
        ...

    def with_other_guesses(self, off: Sequence[Array | None]) -> Self:
        """Return the same with unread commands that are off by other amounts."""
        ...


def by_guesses(problem: Replayed, hypothesis: Hypothesis) -> Array:
    """Return the changes of the residuals by guesses that are off, (K, N).

    Args:
        problem: The robot and its log.
        hypothesis: What acts.

    Returns:
        Of each guess that shows, for one standard deviation; infinite rows of
        simulations that diverge are left out.
    """
    logs, layout = problem.log.recordings, problem.layout
    none = np.zeros((0, len(layout.recording)))
    if all(one.guessed is None for one in logs):
        return none
    noise = _noise_of_commands(problem)
    turns = [_turns(one, noise) for one in logs]
    count = max(int(one.max(initial=-1)) for one in turns) + 1
    if not count:
        return none
    problems = [problem]
    for actuator in range(len(noise)):
        for turn in range(count):
            off = [
                _off(*both, turn, actuator) for both in zip(logs, turns, strict=True)
            ]
            problems.append(problem.with_other_guesses(off))
    rows = np.concatenate([one.residuals([hypothesis]) for one in problems])
    if not np.isfinite(rows[0]).all():
        return none
    moved = (rows[1:] - rows[0]).reshape(len(noise), count, -1)
    scale = problem.noise[layout.channel]
    found = []
    for index, (log, own) in enumerate(zip(logs, turns, strict=True)):
        here = np.flatnonzero(layout.recording == index)
        for actuator, turn in enumerate(own.T):
            guesses = np.flatnonzero(turn >= 0)
            if log.unread is None or not len(guesses):
                continue
            begins = log.unread[0][guesses]
            ends = until(begins, begins, turn[guesses])
            for begin, end, one in zip(begins, ends, turn[guesses], strict=True):
                near = here[(layout.time[here] >= begin) & (layout.time[here] < end)]
                column = np.zeros(len(scale))
                column[near] = moved[actuator, one, near]
                size = float(np.linalg.norm(column / scale))
                if _COUNTS < size < np.inf:
                    found.append(column)
    return np.stack(found) if found else none


def _noise_of_commands(problem: Replayed) -> Array:
    """Return the noise of the joint that each of the log's commands moves."""
    noise = {
        actuator_of(problem.model, joint): float(size)
        for joint, size in zip(problem.log.joints, problem.noise, strict=True)
    }
    least = float(problem.noise.min())
    ids = [problem.model.actuator(name).id for name in problem.log.actuators]
    return np.array([noise.get(one, least) for one in ids])


def _turns(log: Recording, noise: Array) -> Array:
    """Return in which rollout each guess's response is measured, or -1, (L, actuators).

    In one rollout an actuator's guesses are as far apart as an arm remembers.
    """
    if log.guessed is None or log.unread is None:
        return np.full((0, len(noise)), -1)
    time, turns = log.unread[0], np.full(log.guessed.shape, -1)
    for actuator, off in enumerate(log.guessed.T):
        guesses = np.flatnonzero(off > _OBSERVABLE * noise[actuator])
        turns[guesses, actuator] = combs_of(time[guesses], time[guesses])
    return turns


def _off(log: Recording, turns: Array, turn: int, actuator: int) -> Array | None:
    """Return by how much a recording's unread commands are off in one rollout."""
    mine = turns[:, actuator] == turn
    if log.guessed is None or not mine.any():
        return None
    off = np.zeros_like(log.guessed)
    off[mine, actuator] = log.guessed[mine, actuator]
    return off


def held_off(
    log: Recording, off: Array, step: float, nu: int, columns: list[int]
) -> Array:
    """Return what unread commands that are off change at each step, (steps, nu).

    Args:
        log: The recording.
        off: Of each of its unread commands, (L, actuators).
        step: The physics step [s].
        nu: Actuators of the model.
        columns: Which of these each command is of.
    """
    if log.unread is None:
        raise ValueError(f"{log.name!r} has no unread commands")
    time, sent = log.unread
    other = replace(log, unread=(time, sent + off))
    return held_commands(other, step, nu, columns) - held_commands(
        log, step, nu, columns
    )
