"""Do recorded demonstrations and the simulator mean the same by their numbers?

The first thing that goes wrong when simulated and recorded demonstrations are mixed:
an axis with the other sign, moves along the tool's axes, targets in place of moves,
quaternions in another order, actions one row off. `check_conventions` tries them all
against how the tool then moved, says in one sentence what differs, and
`Conventions.apply` mends the log.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rlco.errors import DataError
from rlco.gap.action_readings import ActionReading, scores
from rlco.gap.action_units import (
    MOVES,
    TURNS,
    Gripper,
    Scale,
    read_gripper,
    simulated_moves,
)
from rlco.gap.likely_readings import (
    EXPLAINED,
    as_good_as,
    likeliest_state,
    move_scale,
    turn_readings,
)
from rlco.gap.log import Log, Recording
from rlco.gap.nominal_answer import nominal_answers
from rlco.gap.problem import Hypothesis
from rlco.gap.state_readings import (
    StateReading,
    as_simulated,
    columns_of,
    opening,
    read_state,
    state_columns,
)
from rlco.gap.task_motions import motions_of, shifted
from rlco.gap.task_plants import Plants
from rlco.gap.task_rollouts import Rollouts
from rlco.gap.task_space import TaskSpaceProblem, task_at_rate
from rlco.physics.domain import Domain, make_domain
from rlco.physics.observation import ACTION_NAMES, STATE_NAMES
from rlco.physics.task import Task, make_task

_ROWS = 40  # fewer tell too little
_REPLAYED = 4  # recordings that are replayed
_BETTER = 0.9  # a replay has to miss by so much less, to be preferred
_ARM = 0.1  # a turn misses as a place at this distance [m/rad]
_FULL_MOVE, _FULL_TURN = MOVES["parts of 5 cm"], TURNS["parts of 0.5 rad"]


@dataclass(frozen=True)
class Conventions:
    """What of a log's conventions differs from the simulator's.

    Attributes:
        state: How the tool's pose is written.
        moves: How the action's translations are written.
        move_scale: What one of their numbers is worth [m].
        turns: How the action's rotations are written.
        turn_scale: What one of their numbers is worth [rad].
        gripper: How the gripper's number is written.
        ambiguous: What this log cannot tell, one phrase each.
        columns: Names of the log's columns that hold the robot's state.
        explained: Part of the tool's translation that the moves explain beside its
            inertia, in the reading chosen.
        error: By how much replays of a second miss the tool, as mended [m].
        error_as_is: The same for the log as it is; None where it cannot be replayed.
    """

    state: StateReading
    moves: ActionReading
    move_scale: Scale
    turns: ActionReading
    turn_scale: Scale
    gripper: Gripper
    ambiguous: tuple[str, ...]
    columns: tuple[str, ...]
    explained: float
    error: float = np.nan
    error_as_is: float | None = None

    @property
    def changes(self) -> tuple[str, ...]:
        """What differs from the simulator, one phrase each."""
        words = [
            *self.state.changes(),
            *self.moves.changes("translations"),
            *_units("translations", self.moves, self.move_scale, _FULL_MOVE, "m"),
            *self.turns.changes("rotations"),
            *_units("rotations", self.turns, self.turn_scale, _FULL_TURN, "rad"),
            *self.gripper.changes(),
        ]
        if self.moves.lead > 0:
            words.append("each row holds the action that led to it, not the one it led")
        return tuple(words)

    @property
    def is_named(self) -> bool:
        """Whether the columns bear the names that the simulator gives them."""
        return set(self.columns) <= set(STATE_NAMES)

    @property
    def agrees(self) -> bool:
        """Whether nothing differs."""
        return not self.changes

    @property
    def summary(self) -> str:
        """What was found, in one sentence."""
        if self.explained < EXPLAINED:
            return (
                "No reading of the actions explains how the tool moved (the best "
                f"explains {self.explained:.0%}): these may be actions of another "
                "kind, or of another recording."
            )
        miss = f"replays of a second miss the tool by {1e3 * self.error:.1f} mm"
        if self.agrees:
            text = f"The log means what the simulator means: {miss}"
        else:
            before = ""
            if self.error_as_is is not None:
                before = f", before by {1e3 * self.error_as_is:.1f} mm"
            text = f"The log differs from the simulator: {'; '.join(self.changes)}; "
            text += f"mended, {miss}{before}"
        if self.moves.lead < 0:
            rows = f"{-self.moves.lead} row" + "s" * (self.moves.lead < -1)
            text += (
                f"; actions reach the tool {rows} later than in the simulator: they "
                "arrive late (command_delay), or were logged so much early"
            )
        if self.ambiguous:
            text += f"; not to be told from this log: {'; '.join(self.ambiguous)}"
        return text + "."

    def apply(self, log: Log) -> Log:
        """Return the log as the simulator would have written it.

        The last row of an episode goes where actions were a row late. Actions that
        ask for more than the simulator's can are cut to its range.
        """
        if self.agrees and self.is_named:
            return log
        recordings = tuple(self._mended(recording) for recording in log.recordings)
        notes = (*log.notes, *(f"conventions: {change}" for change in self.changes))
        return replace(log, recordings=recordings, actuators=ACTION_NAMES, notes=notes)

    def _mended(self, recording: Recording) -> Recording:
        lead = max(self.moves.lead, 0)
        place, turn = motions_of(recording, self.columns, self.state)
        moves = simulated_moves(
            shifted(place, lead), self.moves, self.move_scale, _FULL_MOVE
        )
        turns = simulated_moves(
            shifted(turn, lead), self.turns, self.turn_scale, _FULL_TURN
        )
        numbers = np.asarray(recording.command, dtype=float)[lead:, 6:]
        command = np.concatenate([moves, turns, self.gripper.simulated(numbers)], 1)
        told = as_simulated(recording, self.columns, self.state)
        rows = slice(0, recording.rows - lead)
        return replace(
            told,
            time=told.time[rows],
            position=None if told.position is None else told.position[rows],
            velocity=None if told.velocity is None else told.velocity[rows],
            torque=None if told.torque is None else told.torque[rows],
            command=np.clip(command, -1.0, 1.0),
            extra={name: column[rows] for name, column in told.extra.items()},
        )


def check_conventions(
    task: str | Task,
    log: Log,
    *,
    domain: str | Domain = "sim",
    rollouts: Rollouts | None = None,
) -> Conventions:
    """Find out whether a log of a task's actions means what the simulator means.

    First each reading of the finite set is scored by the motion it predicts; then the
    best of them, and the log as it is, are replayed in the simulator.

    Args:
        task: The task or its name.
        log: Recordings with `command` (T, 7) and the robot's state in `extra`: the
            tool's position, its rotation and the gripper, under any names.
        domain: The simulator.
        rollouts: Simulations of the task and domain, where they are there already.

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
            f"the log has {rows} rows; conventions show in {_ROWS} rows or more."
        )
    rollouts = rollouts or Rollouts(Plants(task, make_domain(domain)))
    answers, home = nominal_answers(rollouts)
    told = [columns_of(recording, columns) for recording in log.recordings]
    state, ambiguous = likeliest_state(log, columns, read_state(told, home))
    motions = [motions_of(recording, columns, state) for recording in log.recordings]
    places, turned = [place for place, _ in motions], [turn for _, turn in motions]
    gripper = read_gripper(
        [np.asarray(r.command, dtype=float)[:, 6] for r in log.recordings],
        [opening(one) for one in told],
    )
    if not gripper.told:
        ambiguous.append("which way the gripper closes, as it never moves")
    moves = as_good_as(scores(places))
    turns = turn_readings(turned, moves[0].reading, answers[1])
    found = [
        Conventions(
            state,
            move.reading,
            move_scale(places, move, answers[0]),
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
    """Replay a log under each of some readings; return what misses the tool least.

    Of those that miss by about as much, the first is returned.
    """
    errors = [_miss(one.apply(log), rollouts) for one in found]
    totals = [place + _ARM * turn for place, turn in errors]
    best = 0
    for number, total in enumerate(totals):
        if total < _BETTER * totals[best]:
            best = number
    chosen = replace(found[best], error=errors[best][0])
    words = [
        f"whether {' and '.join(one.changes) or 'nothing differs'} instead"
        for one, total in zip(found, totals, strict=True)
        if one is not found[best] and total < totals[best] / _BETTER
    ]
    if not chosen.agrees and not chosen.state.changes() and chosen.is_named:
        chosen = replace(chosen, error_as_is=_miss(log, rollouts)[0])
    return replace(chosen, ambiguous=(*chosen.ambiguous, *words))


def _miss(log: Log, rollouts: Rollouts) -> tuple[float, float]:
    """Return by how much replays of a log miss the tool, [m] and [rad]."""
    plants = rollouts.plants
    problem = TaskSpaceProblem(
        plants.task, log, domain=plants.domain, rollouts=rollouts, draws=0
    )
    left = problem.residuals([Hypothesis()])[0]
    missed = []
    for names in (STATE_NAMES[:3], STATE_NAMES[3:6]):
        channels = [problem.layout.channels.index(name) for name in names]
        part = left[np.isin(problem.layout.channel, channels)].reshape(-1, 3)
        missed.append(float(np.sqrt((part**2).sum(axis=1).mean())))
    return missed[0], missed[1]


def _units(
    what: str, reading: ActionReading, scale: Scale, full: float, unit: str
) -> list[str]:
    if reading.kind == "absolute" or scale.size == full:
        return []
    if scale.name:
        return [f"{what} are in {scale.name}, not in parts of {full:g} {unit}"]
    return [
        f"one unit of {what} moves the tool as {scale.size:.3g} {unit} do, not {full:g}"
    ]
