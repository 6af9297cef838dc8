"""Torques beside positions: searched as well, or checked against what was named."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rlco.errors import DataError
from rlco.gap.compare.comparisons import Comparison, warned
from rlco.gap.compare.problem import Problem
from rlco.gap.compare.torque.check import carried_over, check_gap
from rlco.gap.compare.torque.convention import torque_problem
from rlco.gap.compare.torque.held_commands import effort_jumps, warning
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.compare.verdict import Verdict
from rlco.gap.logs.log import Log
from rlco.gap.make_problem import in_parts
from rlco.gap.model import LoadedModel
from rlco.gap.search.find_gap import find_gap

Progress = Callable[[str, float], None]
#: Fraction done when nothing is searched any more, but may still be interrupted.
SEARCHED = 0.99


def torque_warning(problem: Problem) -> str | None:
    """Return why a problem's measurements should name nothing; None if they may."""
    jumps = effort_jumps(problem) if isinstance(problem, TorqueLog) else None
    return None if jumps is None else warning(jumps)


def torques_beside(
    loaded: LoadedModel,
    log: Log,
    verdict: Verdict,
    options: Mapping[str, Any] | None,
    say: Progress,
) -> tuple[Comparison, bool]:
    """Return the comparison of torques, and whether it completed.

    Args:
        loaded: The model.
        log: The recordings.
        verdict: The result for positions.
        options: Those of a search by torques; None only checks `verdict`.
        say: Called with the progress.
    """
    say("comparing torques", SEARCHED * (0.5 if options else 1.0))
    try:
        problem = torque_problem(loaded.spec, in_parts(log))
    except DataError as error:
        if options:
            raise
        return Comparison("torques", notes=(str(error),)), True
    notes = tuple(note for note in problem.log.notes if note not in log.notes)
    if options:
        found = find_gap(
            problem,
            **options,
            on_step=lambda said, part: say(said, SEARCHED * (0.5 + part / 2.0)),
        )
        second = Comparison("torques", found, found.gap, notes)
        return warned(second, torque_warning(problem)), found.complete
    gap = check_gap(problem, carried_over(verdict.hypothesis))
    check = Comparison("torques", None, gap, notes)
    return warned(check, torque_warning(problem)), True
