"""Every row gets the regime that a person would give it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_runs import write_run
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from small_problems import PERIOD, Arm, arm_problem, ball_problem, commands

from rlco.gap import load_model, make_problem, read_log
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.diagnose.regimes import label_regimes, motion_flags
from rlco.gap.logs.log import Array

RATE = 50


def named(speed: Array) -> list[str]:
    """Return the one name of each row of a single channel."""
    time = np.arange(len(speed)) / RATE
    flags = motion_flags(time, speed[:, None], np.full(1, 0.05), 1.0)
    names = list(flags)
    table = np.stack([flags[name][:, 0] for name in names])
    assert (table.sum(axis=0) == 1).all()
    return [names[i] for i in table.argmax(axis=0)]


def runs(names: list[str]) -> list[tuple[str, float]]:
    """Return the stretches of equal names with their seconds."""
    found: list[tuple[str, float]] = []
    for name in names:
        if found and found[-1][0] == name:
            found[-1] = (name, found[-1][1] + 1 / RATE)
        else:
            found.append((name, 1 / RATE))
    return [(name, round(seconds, 2)) for name, seconds in found]


def test_a_turn_is_a_reversal_until_the_motion_runs_again() -> None:
    speed = np.concatenate([np.ones(50), -np.ones(50)])
    # The turn lies between row 49 (0.98 s) and row 50 (1.00 s): from 0.93 s, which
    # row 47 is the first to pass, until 1.30 s, row 65.
    assert runs(named(speed)) == [("fast", 0.94), ("reversal", 0.38), ("fast", 0.68)]


def test_a_turn_after_a_long_rest_is_a_hold_and_no_reversal() -> None:
    speed = np.concatenate([np.ones(50), np.zeros(40), -0.3 * np.ones(50)])
    assert runs(named(speed)) == [("fast", 1.0), ("hold", 0.8), ("slow", 1.0)]


def test_a_short_rest_in_one_direction_is_slow_motion() -> None:
    speed = np.concatenate([np.ones(50), np.zeros(8), np.ones(50)])
    assert runs(named(speed)) == [("fast", 1.0), ("slow", 0.16), ("fast", 1.0)]


@settings(max_examples=50, deadline=None)
@given(arrays(float, st.integers(8, 60), elements=st.floats(-2, 2)))
def test_each_row_has_exactly_one_motion(speed: Array) -> None:
    named(speed)


def test_loaded_follows_gravity_torque() -> None:
    problem = arm_problem()
    position = problem.log.recordings[0].position
    assert position is not None
    (labels, *_) = label_regimes(problem)
    # The lower arm hangs on the elbow: its torque goes with the cosine of the angle,
    # which swings within 0.7 rad, so it is never below half of the largest.
    assert np.cos(position[:, 1]).min() > 0.55
    assert labels.flags["loaded"][:, 1].all()
    # The shoulder turns about an upright axis and feels no gravity.
    torque = np.abs(problem.traces(Hypothesis(), 0)["torque"])
    assert torque[:, 0].max() < 1e-6
    assert not labels.flags["loaded"][:, 0].any()


def test_saturated_where_a_servo_asks_for_more_than_its_limit() -> None:
    problem = arm_problem(recordings=1)
    recording = problem.log.recordings[0]
    assert recording.command is not None
    # kp 40 N m/rad and a limit of 9 N m: a command 0.3 rad away asks for 12 N m.
    recording.command[100:105, 0] += 0.3
    (labels,) = label_regimes(problem)
    flagged = np.flatnonzero(labels.flags["saturated"][:, 0])
    np.testing.assert_array_equal(flagged, np.arange(100, 105))


def test_a_drive_is_saturated_at_its_full_duty(tmp_path: Path) -> None:
    write_run(tmp_path, "run", 800.0, "steps", seconds=5.0)
    loaded = load_model("bam:xl330")
    problem = make_problem(loaded, read_log(tmp_path, loaded))
    (labels,) = label_regimes(problem)
    (recording,) = problem.log.recordings
    assert recording.command is not None
    assert recording.position is not None
    # 4096 / 2 pi steps for a radian, in 256ths, of 885, times the gain of 800.
    duty = 800.0 * 4096.0 / (2.0 * np.pi) / 256.0 / 885.0
    full = duty * np.abs(recording.command - recording.position) > 0.95
    np.testing.assert_array_equal(labels.flags["saturated"], full)
    assert 0.05 < full.mean() < 0.5


def test_a_toss_is_free_until_it_lands() -> None:
    (labels,) = label_regimes(ball_problem())
    free = labels.time[labels.flags["free"][:, 0]]
    # From 1 m up at 1 m/s down to the radius of 0.05 m:
    # t = (1 + sqrt(1 + 2 * 9.81 * 0.95)) / 9.81 = 0.554 s.
    assert abs(free[-1] - 0.554) < PERIOD
    contact, after = (labels.flags[n][:, 0] for n in ("contact", "after contact"))
    assert contact.any()
    assert after.any()
    assert (labels.flags["free"][:, 0] ^ contact ^ after).all()


def test_regimes_that_the_data_cannot_tell_are_absent() -> None:
    (labels, *_) = label_regimes(arm_problem())
    assert not {"contact", "free", "after contact"} & set(labels.flags)


def test_rests_of_a_noisy_encoder_are_holds() -> None:
    problem = arm_problem(recordings=1)
    time, sent = commands(0)
    resting = np.abs(np.gradient(sent, time, axis=0)) == 0
    (labels,) = label_regimes(problem)
    # The joint follows within 0.3 s.
    late = np.concatenate([np.zeros((20, 2), bool), resting[:-20]]) & resting
    assert labels.flags["hold"][late].mean() > 0.95
    assert labels.flags["hold"][~resting].mean() < 0.15


def test_accelerating_and_fast_take_turns_in_a_swing() -> None:
    # x = sin(w t): |v| = w |cos|, |a| = w^2 |sin|; each above half of its largest for
    # two thirds of the time, with the other below half for one third.
    time = np.arange(0.0, 8.0, PERIOD)
    problem = arm_problem(recordings=1)
    swing = 0.7 * np.sin(2 * np.pi * 0.5 * time)
    record = replace(
        problem.log.recordings[0],
        time=time,
        position=np.stack([swing, swing], axis=1),
        command=np.stack([swing, swing], axis=1),
    )
    (labels,) = label_regimes(Arm(replace(problem.log, recordings=(record,))))
    accelerating = labels.flags["accelerating"][:, 0]
    assert accelerating.mean() == pytest.approx(2 / 3, abs=0.05)
    slowest = np.abs(np.cos(2 * np.pi * 0.5 * time)) < 0.4
    assert accelerating[slowest].all()
    assert not accelerating[np.abs(np.cos(2 * np.pi * 0.5 * time)) > 0.93].any()
