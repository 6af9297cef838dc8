"""What a report draws: before and after, and the seconds that show an effect best."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_problems import Arm, arm_problem
from small_verdicts import DAMPING, FRICTION, named, nothing_named

from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.verdict import HeldOut, HeldOutGroup
from rlco.gap.diagnose.regimes import label_regimes
from rlco.gap.diagnose.traces import REFITTED, best_stretches, figure_data
from rlco.gap.diagnose.where import where


@pytest.fixture(scope="module")
def problem() -> Arm:
    return arm_problem(FRICTION, DAMPING)


def test_a_trace_shows_its_own_effect_where_it_helps_most(problem: Arm) -> None:
    friction, damping = best_stretches(problem, named(problem))
    assert (friction.channel, damping.channel) == ("elbow", "shoulder")
    for stretch in (friction, damping):
        assert stretch.recording == "episode 2"  # the only one that was held out
        assert stretch.corrected is not None
        left = np.sqrt(np.mean((stretch.measured - stretch.corrected) ** 2))
        before = np.sqrt(np.mean((stretch.measured - stretch.nominal) ** 2))
        assert left < 0.1 * before
    # Each window of 4 s of the elbow, tried one after the other.
    (whole,) = (problem.traces(h, 2) for h in [Hypothesis((FRICTION, DAMPING))])
    other = problem.traces(Hypothesis((DAMPING,)), 2)
    gains = [
        sum(
            np.sum((t["measured"] - t["simulated"])[i : i + 200, 1] ** 2) * sign
            for t, sign in ((other, 1), (whole, -1))
        )
        for i in range(len(whole["time"]) - 199)
    ]
    assert friction.time[0] == whole["time"][int(np.argmax(gains))]


def test_without_effects_the_largest_disagreement_is_shown(problem: Arm) -> None:
    (stretch,) = best_stretches(problem, nothing_named(problem))
    assert stretch.corrected is None
    worst = where(problem, recordings=[2])
    assert stretch.channel == worst.channels[int(worst.rms.argmax())]


def test_before_and_after_are_of_all_recordings_and_of_those_held_out(
    problem: Arm,
) -> None:
    labels, verdict = label_regimes(problem), named(problem)
    before = where(problem, labels=labels)
    data = figure_data(problem, verdict, before, labels)
    after = Hypothesis((FRICTION, DAMPING))
    assert data.after is not None
    assert data.heldout_after is not None
    for found, hypothesis, recordings in (
        (data.before, None, None),
        (data.after, after, None),
        (data.heldout_before, None, [2]),
        (data.heldout_after, after, [2]),
    ):
        expected = where(problem, hypothesis, labels=labels, recordings=recordings)
        np.testing.assert_array_equal(found.rms, expected.rms)


def test_where_nothing_is_named_there_is_no_after(problem: Arm) -> None:
    labels, verdict = label_regimes(problem), nothing_named(problem)
    data = figure_data(problem, verdict, where(problem, labels=labels), labels)
    assert data.after is None
    assert data.heldout_after is None
    assert len(data.stretches) == 1


def test_recordings_held_out_in_turn_are_drawn_as_they_were_judged(
    problem: Arm,
) -> None:
    labels, one = label_regimes(problem), named(problem)
    weak = replace(DAMPING, parameters={"damping": 0.1})
    after = [Hypothesis((FRICTION, weak)), Hypothesis((FRICTION, DAMPING))]
    groups = (
        HeldOutGroup("a", (0, 2), 0.3, 0.2, 0.1, Hypothesis((weak,)), after[0]),
        HeldOutGroup("b", (1,), 0.3, 0.2, 0.1, Hypothesis((DAMPING,)), after[1]),
    )
    verdict = replace(
        one, heldout=(0, 1, 2), held_out=HeldOut("rad", 1, 2, groups), train=(0, 1, 2)
    )
    data = figure_data(problem, verdict, where(problem, labels=labels), labels)
    assert data.nominal == REFITTED
    assert data.heldout_after is not None
    rows = [problem.residuals([after[i]], [r])[0] for r, i in enumerate((0, 1, 0))]
    away = np.concatenate(rows).reshape(-1, 2)
    np.testing.assert_allclose(data.heldout_after.rms, np.sqrt(np.mean(away**2, 0)))
    for stretch in data.stretches:
        index = int(stretch.recording.split()[-1])
        group = groups[1 if index == 1 else 0]
        column = problem.layout.channels.index(stretch.channel)
        start = int(
            np.searchsorted(problem.log.recordings[index].time, stretch.time[0])
        )
        part = slice(start, start + len(stretch.time))
        for drawn, hypothesis in (
            (stretch.nominal, group.hypothesis_before),
            (stretch.corrected, group.hypothesis_after),
        ):
            simulated = problem.traces(hypothesis, index)["simulated"]
            np.testing.assert_array_equal(drawn, simulated[part, column])
