"""What changed between two sets of demonstrations of one task.

A task's simulator has no numbers that demonstrations could calibrate under a prior: its
controller cancels the arm's masses, and few episodes touch an object. What the
simulator lacks in the first set is therefore named by a search, and taken as known in
the second. What no name explains there is not known in the second set either.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from rlco.errors import DataError
from rlco.gap.calibrate.changed import Changed
from rlco.gap.calibrate.summary import Before, Summary, sizes_of
from rlco.gap.compare.problem import Hypothesis, Integers, Problem
from rlco.gap.compare.verdict import Verdict
from rlco.gap.demos.conventions.check import check_conventions
from rlco.gap.demos.replay.plants import Plants
from rlco.gap.demos.replay.rollouts import Rollouts
from rlco.gap.demos.replay.task_space import TaskSpaceProblem, task_at_rate
from rlco.gap.logs.log import Array, Log
from rlco.gap.search.comparison import seconds_of
from rlco.gap.search.outliers import Outliers
from rlco.physics.spec.domain import with_effects


@dataclass(frozen=True)
class ChangedTask:
    """Two sets of demonstrations, compared with what the first one tells.

    Attributes:
        problem: The second set, and the simulator with what it lacked in the first; the
            noise is the standard deviation of what is not known.
        summary: What the simulator lacked, and what the first set disagrees by.
        before: What the first set tells of the second.
    """

    problem: Changed
    summary: Summary
    before: Before


def changed_task(
    nominal: TaskSpaceProblem,
    before: Log,
    after: Log,
    lacking: Verdict,
    threads: int | None = None,
) -> ChangedTask:
    """Return the problem of what changed in a task since some demonstrations.

    Args:
        nominal: The task and the demonstrations before, as compared.
        before: The same as they were read.
        after: Later ones.
        lacking: What a search names in those before.
        threads: Simulations that run in parallel.

    Raises:
        DataError: The two sets hold different columns or rates.
    """
    _check_same(before, after)
    domain = with_effects(nominal.domain, lacking.hypothesis.effects)
    task = nominal.task
    # Units or axes that change have changed: conventions are those of before.
    conventions = check_conventions(
        task, before, domain=nominal.domain, rollouts=nominal.rollouts
    )
    if task_at_rate(task, after).control_frequency != task.control_frequency:
        raise DataError(
            f"reference= has {task.control_frequency:g} rows per second, and data= has "
            "another rate; give two recordings of one rate."
        )
    rollouts = Rollouts(Plants(task, domain), threads)
    compare = partial(TaskSpaceProblem, task, domain=domain, rollouts=rollouts)
    known, later = compare(nominal.log), compare(conventions.apply(after))
    unknown = np.array(later.noise)
    # A log has channels of what moves in it; of another object nothing is known.
    mine, theirs = _shared_channels(later, known)
    before_it = np.maximum(_usual_size(known), known.noise)[theirs]
    unknown[mine] = np.maximum(unknown[mine], before_it)
    problem = Changed(later, np.zeros(len(later.layout.channel)), unknown)
    layout, nothing = later.layout, Hypothesis()
    summary = Summary(
        None,
        lacking.hypothesis.effects,
        tuple(layout.channels[i] for i in mine),
        tuple(layout.units[i] for i in mine),
        sizes_of(nominal, nothing)[theirs],
        sizes_of(known, nothing)[theirs],
        lacking.effects,
    )
    difference = sizes_of(problem, nothing)[mine]
    seconds = sum(one.seconds for one in before.recordings)
    of_before = Before(
        np.zeros(len(mine)),
        unknown[mine],
        difference,
        difference,
        len(before.recordings),
        seconds,
    )
    return ChangedTask(problem, summary, of_before)


def _shared_channels(one: Problem, other: Problem) -> tuple[Integers, Integers]:
    """Return the indices of the channels that both have, in either, (shared,)."""
    names = [name for name in one.layout.channels if name in other.layout.channels]
    pair = [[p.layout.channels.index(name) for name in names] for p in (one, other)]
    return np.array(pair[0], dtype=int), np.array(pair[1], dtype=int)


def _usual_size(problem: TaskSpaceProblem) -> Array:
    """Return the root mean square of each channel's residual, (channels,).

    A search limits what a second may count in which a contact went another way, and so
    does this.
    """
    layout = problem.layout
    noise = problem.noise[layout.channel]
    scaled = problem.residuals([Hypothesis()])[0] / noise
    bound = Outliers.of(scaled, seconds_of(layout)).cut(scaled)
    counts = np.bincount(layout.channel, minlength=len(problem.noise))
    squares = np.bincount(layout.channel, bound**2, minlength=len(problem.noise))
    return np.asarray(np.sqrt(squares / counts) * problem.noise)


def _check_same(before: Log, after: Log) -> None:
    columns = [
        (one.actuators, frozenset(one.recordings[0].extra)) for one in (before, after)
    ]
    if columns[0] != columns[1]:
        raise DataError(
            "reference= and data= hold other columns, so they are not of one task "
            "as it was logged; give two recordings of one kind."
        )
