"""When rows were read: the ticks of a clock, the stamps, or between them."""

from __future__ import annotations

import numpy as np
import pytest

from rlco.gap.logs.log import Recording
from rlco.gap.logs.times.clock import Clock, clock_of, in_step
from rlco.gap.logs.times.read_times import at_read_times

PERIOD = 0.02


def logged(
    seed: int, stamped: float, read: float, *, rows: int = 400, lost: float = 0.0
) -> tuple[Recording, np.ndarray]:
    """Two moving joints, and when they were read; jitter in periods."""
    random = np.random.default_rng(seed)
    ticks = np.flatnonzero(random.random(rows) >= lost).astype(float)
    time = PERIOD * (ticks + random.normal(0.0, read, len(ticks)))
    stamps = 7.0 + time + PERIOD * random.normal(0.0, stamped, len(ticks))
    path = np.stack([np.sin(3.0 * time), 0.6 * np.cos(2.0 * time)], axis=1)
    path += random.normal(0.0, 4e-4, path.shape)
    return Recording(f"log {seed}", stamps, path), time


def off(found: Recording, truth: np.ndarray) -> float:
    """How far times are from the truth, but for their start, in periods."""
    apart = found.time - truth
    return float(np.std(apart)) / PERIOD


@pytest.mark.parametrize("stamped", [0.05, 0.2])
def test_jittering_stamps_of_a_regular_clock_become_its_ticks(stamped: float) -> None:
    logs = [logged(seed, stamped, 0.0, lost=0.05) for seed in range(4)]
    found, notes = at_read_times([recording for recording, _ in logs])
    for (recording, truth), now in zip(logs, found, strict=True):
        assert off(recording, truth) > 0.9 * stamped
        steps = np.diff(now.time) / PERIOD
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
        # A row in a thousand beside a lost one may be on the wrong side of it.
        if now.rows == len(truth):
            assert off(now, truth) < 0.01
        assert now.jitter == 0.0
    (note,) = notes
    assert "regular clock of 20.0 ms, which the motion fits better" in note


def test_reading_that_jitters_keeps_its_stamps() -> None:
    logs = [logged(seed, 0.0, 0.15)[0] for seed in range(3)]
    found, notes = at_read_times(logs)
    assert found == logs
    assert notes == []


def test_both_jitters_leave_a_doubt_that_is_said() -> None:
    logs = [logged(seed, 0.1, 0.1) for seed in range(6)]
    found, (note,) = at_read_times([recording for recording, _ in logs])
    before = np.mean([off(recording, truth) for recording, truth in logs])
    after = np.mean([off(f, t) for f, (_, t) in zip(found, logs, strict=True)])
    # The best estimate of one of two equal jitters from their sum is half of it.
    assert before == pytest.approx(0.1, rel=0.1)
    assert after == pytest.approx(0.1 / np.sqrt(2.0), rel=0.1)
    assert found[0].jitter == pytest.approx(after * PERIOD, rel=0.15)
    assert "of doubt are in the noise" in note


def test_a_robot_at_rest_cannot_tell_and_stamps_stay() -> None:
    recording, _ = logged(0, 0.15, 0.0)
    still = np.random.default_rng(1).normal(0.0, 4e-4, (recording.rows, 2))
    resting = Recording("rest", recording.time, still)
    found, notes = at_read_times([resting])
    assert found == [resting]
    assert notes == []


def test_stamps_that_run_backwards_a_little_are_jitter() -> None:
    recording, _ = logged(3, 0.2, 0.0, rows=600)
    recording.time[300] = recording.time[301] + 1e-4
    (found,), _ = at_read_times([recording])
    assert (np.diff(found.time) > 0).all()


def test_a_clock_that_is_regular_is_left_alone() -> None:
    recording, _ = logged(0, 0.0, 0.0, lost=0.05)
    found, notes = at_read_times([recording])
    assert found[0] is recording
    assert notes == []


def test_rows_written_twice_are_left_out_of_the_clock() -> None:
    recording, truth = logged(5, 0.15, 0.0)
    twice = np.sort(np.r_[np.arange(recording.rows), [100, 200]])
    (found,), _ = at_read_times([recording.take(twice)])
    assert found.rows == recording.rows
    assert off(found, truth) < 0.01


def test_stamps_without_a_clock_have_none() -> None:
    random = np.random.default_rng(0)
    assert clock_of(np.sort(random.uniform(0.0, 8.0, 400))) is None
    assert clock_of(np.cumsum(random.uniform(0.01, 0.03, 400))) is None
    assert clock_of(np.arange(10) * 0.02) is None


def test_a_measurement_of_a_lost_row_is_left_out() -> None:
    recording, _ = logged(6, 0.15, 0.0, rows=500)
    position = recording.position
    assert position is not None
    # The logger wrote row 250 into row 251, and lost row 250.
    position[251] = position[250]
    (found,), _ = at_read_times([recording.take(np.arange(500) != 250)])
    assert found.rows == 498
    assert np.diff(found.time).max() == pytest.approx(3 * PERIOD)


@pytest.mark.parametrize("late", [6.7e7, 1e12])
def test_one_stamp_of_another_age_is_no_clock(late: float) -> None:
    """To try all rates that it allows for would take hours, and any memory."""
    assert clock_of(np.append(np.arange(200) * 0.05, late)) is None


def test_a_stamp_that_belongs_elsewhere_leaves_no_clock() -> None:
    stamps = np.arange(160) * 0.05
    stamps[1] = 6.6  # no tick lies between its neighbours' and rises to it
    assert clock_of(stamps) is None


@pytest.mark.parametrize(
    ("away", "whole"), [(0.0, True), (3.4, True), (-4.2, True), (6.0, False)]
)
def test_a_rate_that_errors_of_stamps_alone_reach_is_a_whole_number(
    away: float, whole: bool
) -> None:
    # Ten logs of six seconds with stamps off by a fifth of a period, each of which
    # finds the rate `away` standard errors of all from 50 a second.
    ticks = np.arange(300.0)
    one = Clock(ticks, PERIOD, 0.0, 0.2 * PERIOD)
    period = PERIOD + away * one.doubt / np.sqrt(10)
    found = in_step([one._replace(period=period)] * 10)
    expected = PERIOD if whole else period
    assert [clock.period for clock in found] == pytest.approx(
        [expected] * 10, rel=1e-12
    )
    # The middle of each log stays where its stamps are.
    at = [clock.start + clock.period * ticks.mean() for clock in found]
    assert at == pytest.approx([period * ticks.mean()] * 10)


def test_rows_that_repeat_a_misplaced_one_go_with_it() -> None:
    recording, truth = logged(3, 0.2, 0.0)
    position = recording.position
    assert position is not None
    # Two rows repeat the measurement before them, whose own row is lost.
    position[201:203] = position[200]
    kept = np.arange(400) != 200
    log = Recording("log", recording.time[kept], position[kept])
    (found,), _ = at_read_times([log])
    assert found.position is not None
    assert not (found.position == position[200]).all(axis=1).any()
    assert len(found.time) >= 395
    assert off(found, truth[np.isin(np.round(truth / PERIOD), _ticks(found))]) < 0.01


def _ticks(found: Recording) -> np.ndarray:
    since = (found.time - found.time[0]) / PERIOD
    return np.asarray(np.round(since))
