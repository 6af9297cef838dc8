"""Check whether recorded demonstrations follow the simulator's conventions.

Mismatched conventions are the first problem when simulated and recorded demonstrations
are mixed: a flipped axis, motions along the tool's axes, targets instead of relative
motions, another quaternion order, actions shifted by one row. `check_conventions` tests
all of them against the motion of the tool and states the differences in one sentence;
`Conventions.apply` corrects the log.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from rlco.errors import DataError, counted
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.demos.conventions.action_units import (
    MOVES,
    TURNS,
    Gripper,
    Scale,
    read_gripper,
    simulated_moves,
)
from rlco.gap.demos.conventions.actions import ActionConvention, scores
from rlco.gap.demos.conventions.likely import (
    EXPLAINED,
    best_distinct,
    likeliest_state,
    move_scale,
    turn_conventions,
)
from rlco.gap.demos.conventions.nominal_response import nominal_responses
from rlco.gap.demos.conventions.states import (
    StateConvention,
    as_simulated,
    columns_of,
    opening,
    read_state,
    state_columns,
)
from rlco.gap.demos.conventions.tool_motions import motions_of, shifted
from rlco.gap.demos.replay.plants import Plants
from rlco.gap.demos.replay.rollouts import Rollouts
from rlco.gap.demos.replay.task_space import TaskSpaceProblem, task_at_rate
from rlco.gap.logs.log import Array, Log, Recording
from rlco.physics.spec.domain import GivenDomain, make_domain
from rlco.physics.spec.names import ACTION_NAMES, STATE_NAMES
from rlco.physics.spec.robot import POSITION, ROTATION
from rlco.physics.spec.task import Task
from rlco.physics.tasks.make_task import make_task

_ROWS = 40  # fewer rows are not informative enough
_REPLAYED = 4  # recordings that are replayed
_BETTER = 0.9  # ratio of replay errors at which a convention is preferred
# The same for a unit of a size that is no known one. A robot that moves less than the
# simulator, by a damping or a soft servo, is replayed better with smaller actions, but
# not well; an effect explains it.
_FITTED = 0.5
_FITS = 4  # iterations of a fit of sizes
_LOST = 1.0  # error that a replay that diverges counts as [m]
_ARM = 0.1  # distance at which a rotation error counts as a position error [m/rad]
_FULL_MOVE, _FULL_TURN = MOVES["parts of 5 cm"], TURNS["parts of 0.5 rad"]


@dataclass(frozen=True)
class Conventions:
    """The conventions of a log, compared with the simulator's.

    Attributes:
        state: Convention of the tool's pose.
        moves: Convention of the action's translations.
        move_scale: Size of one of their units [m].
        turns: Convention of the action's rotations.
        turn_scale: Size of one of their units [rad].
        gripper: Convention of the gripper command.
        ambiguous: What this log cannot determine, one phrase each.
        columns: Names of the log's columns that hold the robot's state.
        explained: Share of the tool's translation that the actions explain beyond its
            inertia, under the chosen convention.
        error: Root mean square tool position error of one-second replays, as corrected
            [m].
        error_as_is: The same for the uncorrected log; None where it cannot be replayed.
    """

    state: StateConvention
    moves: ActionConvention
    move_scale: Scale
    turns: ActionConvention
    turn_scale: Scale
    gripper: Gripper
    ambiguous: tuple[str, ...]
    columns: tuple[str, ...]
    explained: float
    error: float = np.nan
    error_as_is: float | None = None

    @property
    def changes(self) -> tuple[str, ...]:
        """Differences from the simulator, one phrase each."""
        phrases = [
            *self.state.changes(),
            *self.moves.changes("translations"),
            *_units("translations", self.moves, self.move_scale, _FULL_MOVE, "m"),
            *self.turns.changes("rotations"),
            *_units("rotations", self.turns, self.turn_scale, _FULL_TURN, "rad"),
            *self.gripper.changes(),
        ]
        if self.moves.lead > 0:
            phrases.append("each row holds the action that preceded it, not the next")
        return tuple(phrases)

    @property
    def is_named(self) -> bool:
        """Whether the columns have the simulator's names."""
        return set(self.columns) <= set(STATE_NAMES)

    @property
    def agrees(self) -> bool:
        """Whether nothing differs."""
        return not self.changes

    @property
    def summary(self) -> str:
        """The result in one sentence."""
        if self.explained < EXPLAINED:
            return (
                "No convention of the actions explains how the tool moved (the best "
                f"explains {self.explained:.0%}): these may be actions of another "
                "kind, or of another recording."
            )
        miss = f"one-second replays miss the tool by {1e3 * self.error:.1f} mm"
        if self.agrees:
            text = f"The log follows the simulator's conventions: {miss}"
        else:
            before = ""
            if self.error_as_is is not None:
                before = f", before by {1e3 * self.error_as_is:.1f} mm"
            text = f"The log differs from the simulator: {'; '.join(self.changes)}; "
            text += f"corrected, {miss}{before}"
        if self.moves.lead < 0:
            rows = f"{-self.moves.lead} row" + "s" * (self.moves.lead < -1)
            text += (
                f"; actions reach the tool {rows} later than in the simulator: they "
                "are delayed (command_delay), or were logged too early"
            )
        if self.ambiguous:
            text += f"; this log cannot determine {'; '.join(self.ambiguous)}"
        return text + "."

    def apply(self, log: Log) -> Log:
        """Return the log in the simulator's conventions.

        The last row of an episode is dropped where actions were one row late. Actions
        beyond the simulator's range are clipped.
        """
        if self.agrees and self.is_named:
            return log
        recordings = tuple(self._corrected(recording) for recording in log.recordings)
        notes = (*log.notes, *(f"conventions: {change}" for change in self.changes))
        return replace(log, recordings=recordings, actuators=ACTION_NAMES, notes=notes)

    def _corrected(self, recording: Recording) -> Recording:
        lead = max(self.moves.lead, 0)
        position, turn = motions_of(recording, self.columns, self.state)
        moves = simulated_moves(
            shifted(position, lead), self.moves, self.move_scale, _FULL_MOVE
        )
        turns = simulated_moves(
            shifted(turn, lead), self.turns, self.turn_scale, _FULL_TURN
        )
        numbers = np.asarray(recording.command, dtype=float)[lead:, 6:]
        command = np.concatenate([moves, turns, self.gripper.simulated(numbers)], 1)
        simulated = as_simulated(recording, self.columns, self.state)
        rows = slice(0, recording.rows - lead)
        return replace(
            simulated,
            time=simulated.time[rows],
            position=None if simulated.position is None else simulated.position[rows],
            velocity=None if simulated.velocity is None else simulated.velocity[rows],
            torque=None if simulated.torque is None else simulated.torque[rows],
            command=np.clip(command, -1.0, 1.0),
            extra={name: column[rows] for name, column in simulated.extra.items()},
        )


def check_conventions(
    task: str | Task,
    log: Log,
    *,
    domain: GivenDomain = "sim",
    rollouts: Rollouts | None = None,
) -> Conventions:
    """Compare a log's conventions with the simulator's.

    First every convention of a finite set is scored by the motion it predicts. Then the
    best ones, and the log as it is, are replayed in the simulator.

    Args:
        task: The task or its name.
        log: Recordings with `command` (T, A) and the robot's state in `extra`: the
            tool's position, its rotation and the gripper, under any names.
        domain: The simulator.
        rollouts: Existing simulations of the task and domain, to reuse.

    Raises:
        DataError: If the log holds no such columns, or too little motion.

    Example:
        >>> check_conventions("push_cube", Log(()))
        Traceback (most recent call last):
        ...
        rlco.errors.DataError: the log holds no recordings; give one episode at least.
    """
    task = task_at_rate(make_task(task), log)
    columns = state_columns(log, task)
    rows = sum(recording.rows for recording in log.recordings)
    if rows < _ROWS:
        raise DataError(
            f"the log has {counted(rows, 'row')}; checking conventions takes {_ROWS} "
            "rows or more."
        )
    rollouts = rollouts or Rollouts(Plants(task, make_domain(domain)))
    responses, home = nominal_responses(rollouts)
    states = [columns_of(recording, columns) for recording in log.recordings]
    state, ambiguous = likeliest_state(log, columns, read_state(states, home))
    motions = [motions_of(recording, columns, state) for recording in log.recordings]
    positions, turned = (
        [position for position, _ in motions],
        [turn for _, turn in motions],
    )
    gripper = read_gripper(
        [np.asarray(r.command, dtype=float)[:, 6] for r in log.recordings],
        [opening(one) for one in states],
    )
    if not gripper.observed:
        ambiguous.append("which way the gripper closes, as it never moves")
    moves = best_distinct(scores(positions))
    turns = turn_conventions(turned, moves[0].convention, responses[1])
    found = [
        Conventions(
            state,
            move.convention,
            move_scale(positions, move, responses[0]),
            turn,
            scale,
            gripper,
            tuple(ambiguous),
            columns,
            move.explained,
        )
        for move in moves
        for turn, scale in turns
    ]
    if moves[0].explained < EXPLAINED:
        found = found[:1]
    part = replace(log, recordings=log.recordings[:_REPLAYED])
    return _replayed(found, part, rollouts)


def _replayed(
    found: Sequence[Conventions], log: Log, rollouts: Rollouts
) -> Conventions:
    """Replay a log under several conventions, and return the one with the least error.

    Of those with about the same error, the first is returned. Where the motion measured
    the size of no known unit, it is fitted, and must leave far less.
    """
    errors = [_miss(one.apply(log), rollouts) for one in found]
    totals = [position + _ARM * turn for position, turn in errors]
    best = 0
    for number, total in enumerate(totals):
        if total < _BETTER * totals[best]:
            best = number
    fitted = _fitted(found[best], log, rollouts)
    if fitted is not found[best]:
        found = [*found, fitted]
        errors.append(_miss(fitted.apply(log), rollouts))
        totals.append(errors[-1][0] + _ARM * errors[-1][1])
        if totals[-1] < _FITTED * totals[best]:
            best = len(found) - 1
    chosen = replace(found[best], error=errors[best][0])
    phrases = [
        f"whether {' and '.join(one.changes) or 'nothing differs'} instead"
        for one, total in zip(found, totals, strict=True)
        if one is not found[best] and total < totals[best] / _BETTER
    ]
    if not chosen.agrees and not chosen.state.changes() and chosen.is_named:
        chosen = replace(chosen, error_as_is=_miss(log, rollouts)[0])
    return replace(chosen, ambiguous=(*chosen.ambiguous, *phrases))


def _fitted(one: Conventions, log: Log, rollouts: Rollouts) -> Conventions:
    """Return conventions with sizes as replays fit best, where they are not as known.

    The given ones where the motion measured the sizes that they have.
    """
    scales = {"move_scale": one.move_scale, "turn_scale": one.turn_scale}
    far = {field: scale for field, scale in scales.items() if not scale.is_measured}
    if not far:
        return one

    def resized(factors: Array) -> Conventions:
        sizes: dict[str, Any] = {
            field: Scale("", scale.measured * factor, scale.measured)
            for (field, scale), factor in zip(far.items(), factors, strict=True)
        }
        return replace(one, **sizes)

    def missed(factors: Array) -> Array:
        position, turn = _misses(resized(factors).apply(log), rollouts)
        rows = np.concatenate([position.ravel(), _ARM * turn.ravel()])
        return np.clip(rows, -_LOST, _LOST)

    ones = np.ones(len(far))
    return resized(least_squares(missed, ones, diff_step=0.02, max_nfev=_FITS).x)


def _miss(log: Log, rollouts: Rollouts) -> tuple[float, float]:
    """Return the root mean square replay error of the tool, [m] and [rad]."""
    position, turn = (
        float(np.sqrt((part**2).sum(axis=1).mean())) for part in _misses(log, rollouts)
    )
    return position, turn


def _misses(log: Log, rollouts: Rollouts) -> tuple[Array, Array]:
    """Return the replay errors of the tool, (rows, 3) each, [m] and [rad]."""
    plants = rollouts.plants
    # Over longer ones, a robot that moves less looks like smaller units.
    problem = TaskSpaceProblem(
        plants.task,
        log,
        domain=plants.domain,
        whole_contacts=False,
        rollouts=rollouts,
        draws=0,
    )
    residuals = problem.residuals([Hypothesis()])[0]
    missed = []
    for names in (STATE_NAMES[POSITION], STATE_NAMES[ROTATION]):
        channels = [problem.layout.channels.index(name) for name in names]
        part = residuals[np.isin(problem.layout.channel, channels)]
        missed.append(part.reshape(-1, 3))
    return missed[0], missed[1]


def _units(
    what: str, convention: ActionConvention, scale: Scale, full: float, unit: str
) -> list[str]:
    if convention.kind == "absolute" or scale.size == full:
        return []
    if scale.name:
        return [f"{what} are in {scale.name}, not in parts of {full:g} {unit}"]
    return [
        f"one unit of {what} moves the tool by {scale.size:.3g} {unit}, not {full:g}"
    ]
