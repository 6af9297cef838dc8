"""A search that is interrupted: at any moment, with the last whole state."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from small_problems import Interruptible, arm_problem

from rlco.gap.compare.verdict import Verdict
from rlco.gap.search.find_gap import closed, find_gap, search, states
from rlco.gap.search.state import State
from rlco.gap.search.steps.start import start
from rlco.gap.search.verdict import NOTHING_SEARCHED, conclude
from rlco.physics.effects import AppliedEffect

HIDDEN = (
    AppliedEffect("coulomb_friction", "elbow", {"frictionloss": 0.6}),
    AppliedEffect("viscous_damping", "shoulder", {"damping": 0.6}),
)


@dataclass(frozen=True)
class Step:
    """A step of a search: the states about it, and the simulations it needed."""

    before: State
    after: State
    calls: range


@pytest.fixture(scope="module")
def problem() -> Interruptible:
    return Interruptible(arm_problem(*HIDDEN, recordings=3, seconds=2.0).log)


@pytest.fixture(scope="module")
def steps(problem: Interruptible) -> list[Step]:
    problem = problem.again(interrupt_at=0)
    before = start(problem)
    found, calls = [], problem.calls
    for after in states(before):
        found.append(Step(before, after, range(calls + 1, problem.calls + 1)))
        before, calls = after, problem.calls
    return found


def same(one: Verdict, other: Verdict) -> bool:
    """Whether two verdicts say the same, but for how long they took."""
    drawn = [np.zeros(0) if v.sample is None else v.sample for v in (one, other)]
    rest = [{**vars(v), "seconds": 0, "sample": None} for v in (one, other)]
    return rest[0] == rest[1] and np.array_equal(*drawn)


@pytest.mark.slow
def test_two_effects_are_found_where_nobody_interrupts(steps: list[Step]) -> None:
    names = {(e.name, e.target) for e in steps[-1].after.best.effects}
    assert names == {(e.name, e.target) for e in HIDDEN}
    assert len([step for step in steps if step.calls]) >= 12


def moments(steps: list[Step]) -> Iterator[tuple[Step, int]]:
    """Each step with its first and last simulation, and one between."""
    for step in steps:
        for call in sorted({*step.calls[:1], *step.calls[-1:]}):
            yield step, call
        if len(step.calls) > 2:
            yield step, step.calls[len(step.calls) // 2]


def test_an_interruption_in_any_step_leaves_the_state_before_it(
    problem: Interruptible, steps: list[Step]
) -> None:
    for step, call in moments(steps):
        state, complete = search(start(problem.again(call)))
        assert not complete
        expected = closed(step.before)
        assert state.best.effects == expected.best.effects
        assert state.scores.keys() == expected.scores.keys()
        assert state.trail == expected.trail
        assert state.rivals == expected.rivals
        assert [one.candidate for one in state.screenings] == [
            one.candidate for one in expected.screenings
        ]
        told = conclude(expected, complete=False)
        assert same(conclude(state, complete=False), told)


def test_a_verdict_simulates_nothing(
    steps: list[Step], monkeypatch: pytest.MonkeyPatch
) -> None:
    def simulated(*_: object) -> None:
        raise AssertionError("a verdict simulates")

    monkeypatch.setattr(Interruptible, "residuals", simulated)
    monkeypatch.setattr(Interruptible, "traces", simulated)
    verdict = conclude(steps[-1].after)
    assert verdict.verdict == "named"
    assert len(verdict.effects) == 2
    assert all(
        value.low < value.value < value.high
        for effect in verdict.effects
        for value in effect.parameters.values()
    )


def test_a_verdict_needs_the_steps_that_close_a_search(steps: list[Step]) -> None:
    with pytest.raises(ValueError, match="residual"):
        conclude(steps[0].after)


def test_the_earliest_interruption_is_told_as_nothing_searched(
    problem: Interruptible,
) -> None:
    verdict = find_gap(problem.again(interrupt_at=1))
    assert not verdict.complete
    assert verdict.unexplained["note"] == NOTHING_SEARCHED


def test_an_interruption_before_the_first_fit_is_told_as_nothing_searched(
    steps: list[Step],
) -> None:
    verdict = conclude(closed(steps[0].before), complete=False)
    note = str(verdict.unexplained["note"])
    assert note.startswith(NOTHING_SEARCHED)
    assert "of the residual is in" in note


def test_an_interrupted_search_that_fitted_something_is_told_as_it_is(
    steps: list[Step],
) -> None:
    fitted = next(step.after for step in steps if len(step.after.scores) > 1)
    verdict = conclude(closed(fitted), complete=False)
    assert verdict.closest or verdict.effects
    assert NOTHING_SEARCHED not in str(verdict.unexplained["note"])
