"""What ``report.json`` says of a search that ended before its first fit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from small_problems import Arm, arm_problem
from small_verdicts import FRICTION, named, nothing_named

from rlco.gap.nothing_yet import nothing_yet
from rlco.gap.problem import Verdict
from rlco.gap.report_json import report
from rlco.gap.where import where


@pytest.fixture(scope="module")
def problem() -> Arm:
    return arm_problem(FRICTION)


def note(problem: Arm, verdict: Verdict) -> str:
    content: dict[str, Any] = dict(report(verdict, where(problem), problem.model))
    return str(content["unexplained"]["note"])


def test_nothing_searched_is_not_told_as_unexplained(problem: Arm) -> None:
    early = replace(nothing_named(problem), complete=False, closest=())
    assert note(problem, early).startswith("Nothing was searched: ")
    assert note(problem, early).endswith(nothing_named(problem).unexplained["note"])
    assert note(problem, nothing_yet(problem)).count("Nothing was searched") == 1


def test_an_interrupted_search_that_fitted_something_is_told_as_it_is(
    problem: Arm,
) -> None:
    for verdict in (nothing_named(problem), named(problem)):
        later = replace(verdict, complete=False)
        assert note(problem, later) == verdict.unexplained["note"]
