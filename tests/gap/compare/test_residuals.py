"""The unexplained residual: its channel, and the signal it correlates with."""

from __future__ import annotations

from collections.abc import Mapping

import pytest
from small_problems import Arm, arm_problem

from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.residuals import describe_residual
from rlco.gap.logs.log import Array
from rlco.physics.effects import AppliedEffect


class Counted(Arm):
    """An arm that counts which recordings were simulated for their traces."""

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        self.__dict__.setdefault("asked", []).append(recording)
        return super().traces(hypothesis, recording)


@pytest.fixture(scope="module")
def problem() -> Counted:
    friction = AppliedEffect("coulomb_friction", "elbow", {"frictionloss": 0.6})
    return Counted(arm_problem(friction, seconds=4.0).log)


def test_the_channel_with_most_of_it_is_told_and_what_it_goes_with(
    problem: Counted,
) -> None:
    rows = problem.residuals([Hypothesis()])[0]
    target, note = describe_residual(problem, Hypothesis(), rows)
    assert target == "elbow"
    assert "of the residual is in elbow; it correlates with" in note
    assert "correlation 0." in note


def test_each_recording_is_simulated_once(problem: Counted) -> None:
    rows = problem.residuals([Hypothesis()])[0]
    problem.__dict__["asked"] = []
    describe_residual(problem, Hypothesis(), rows)
    assert problem.__dict__["asked"] == [0, 1, 2]
