"""Times: uneven, repeated, missing, backwards."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rlco.errors import DataError
from rlco.gap.logs.log import Recording
from rlco.gap.logs.times.repeated_rows import repeated_rows
from rlco.gap.logs.times.timing import correct_timing


def swing(time: np.ndarray) -> np.ndarray:
    """Two joints, the first one fast."""
    return np.stack([np.sin(2 * time), 0.3 * np.cos(time)], axis=1)


def recording(time: np.ndarray, **channels: np.ndarray) -> Recording:
    return Recording("log", time, position=swing(time), **channels)


def test_even_times_stay_and_start_at_zero() -> None:
    time = 7.0 + np.arange(100) * 0.02
    parts, notes = correct_timing(recording(time))
    np.testing.assert_allclose(parts[0].time, np.arange(100) * 0.02, atol=1e-12)
    assert notes == ()


def test_times_rounded_to_single_precision_become_even() -> None:
    time = (np.arange(3000) / 50).astype(np.float32).astype(float)
    parts, _ = correct_timing(recording(time))
    assert np.ptp(np.diff(parts[0].time)) < 1e-12 < np.ptp(np.diff(time))


def test_a_long_gap_splits_and_nothing_is_made_up() -> None:
    time = np.r_[np.arange(50), 150 + np.arange(40)] * 0.02
    whole = recording(time)
    (first, second), notes = correct_timing(whole)
    assert first.rows, second.rows == (50, 40)
    np.testing.assert_array_equal(second.position, whole.position[50:])
    assert second.time[0] == 0.0
    assert second.seconds == pytest.approx(39 * 0.02)
    assert "gap of 2.02 s after 0.98 s" in notes[0]


def test_single_missing_frames_are_counted_and_their_times_kept() -> None:
    time = np.delete(np.arange(100) * 0.02, [30, 60, 61])
    (part,), notes = correct_timing(recording(time))
    np.testing.assert_allclose(part.time, time)
    assert "3 frames are missing in 2 places, at most 60 ms" in notes[0]


def test_frames_missing_from_even_times_move_later_rows() -> None:
    time = np.arange(200) * 0.02
    keep = np.delete(np.arange(200), [50, 130, 131])
    counted = np.arange(197) * 0.02
    part = Recording("log", counted, swing(time)[keep])
    (corrected,), notes = correct_timing(part)
    np.testing.assert_allclose(corrected.time, time[keep], atol=1e-9)
    assert "jump in 2 places by whole steps, as if 3 frames were missing" in notes[0]


def test_one_joint_alone_may_jump() -> None:
    time = np.arange(200) * 0.02
    position = swing(time)
    position[50:, 0] += 0.04
    position[120:, 0] += 0.04
    (corrected,), notes = correct_timing(Recording("log", time, position))
    np.testing.assert_allclose(corrected.time, time, atol=1e-12)
    assert notes == ()


def test_jitter_is_noted_and_kept() -> None:
    rng = np.random.default_rng(0)
    time = np.cumsum(0.005 + rng.uniform(-0.0015, 0.0015, 400))
    (part,), notes = correct_timing(recording(time))
    np.testing.assert_allclose(part.time, time - time[0])
    # A uniform spread of 3 ms has a standard deviation of 3 / 12 ** 0.5 = 0.87 ms.
    assert "ms apart with a jitter of 0.9 ms" in notes[0]


def test_two_rates_in_one_recording_are_no_missing_frames() -> None:
    time = np.cumsum(np.tile([0.0034, 0.0034, 0.0034, 0.0064], 100))
    _, notes = correct_timing(recording(time))
    assert "uneven" in notes[0]
    assert "missing" not in " ".join(notes)


@settings(deadline=None, max_examples=30)
@given(st.sets(st.integers(5, 90), min_size=1, max_size=5))
def test_repeated_frames_are_found_exactly(rows: set[int]) -> None:
    # At 2 rad/s or more throughout, so that every repetition is a visible stop.
    time = np.arange(100) * 0.02
    position = np.stack([3 * time + 0.2 * np.sin(5 * time), np.cos(time)], axis=1)
    stale = sorted(rows)
    for row in stale:
        position[row] = position[row - 1]
    found = repeated_rows(Recording("log", time, position=position))
    assert np.flatnonzero(found).tolist() == stale


def test_repeated_frames_are_dropped_and_noted() -> None:
    time = np.arange(100) * 0.02
    position = swing(time)
    position[[20, 21, 50]] = position[[19, 19, 49]]
    (part,), notes = correct_timing(Recording("log", time, position=position))
    np.testing.assert_allclose(part.time, np.delete(time, [20, 21, 50]))
    assert "3 of 100 rows repeat the measurement before" in notes[0]


def test_rest_and_coarse_encoders_repeat_nothing() -> None:
    time = np.arange(400) * 0.02
    # Moves, stops for two seconds, and moves again, on an encoder of 1.5 mrad.
    phase = np.interp(time, [0, 3, 5, 8], [0, 1, 1, 2])
    smooth = np.pi * phase - np.sin(2 * np.pi * phase) / 2
    quantum = 2 * np.pi / 4096
    position = np.round(0.3 * smooth / quantum)[:, None] * quantum
    assert not repeated_rows(Recording("log", time, position=position)).any()


def test_a_sensor_read_twice_as_often_as_it_measures_is_halved() -> None:
    time = np.arange(200) * 0.01
    position = swing(np.repeat(time[::2], 2))
    # It rests for a second at the end, which is not a second without measurements.
    position = np.concatenate([position, np.repeat(position[-1:], 100, axis=0)])
    later = np.arange(300) * 0.01
    (part,), _ = correct_timing(Recording("log", later, position=position))
    np.testing.assert_allclose(part.time[:100], time[::2])
    np.testing.assert_array_equal(part.position[:100], swing(time[::2]))
    # 99 pairs halved, and the last pair with all of its rest.
    assert part.rows == 99 + 102


def test_sticking_is_not_a_repeated_frame() -> None:
    # Stick and slip: each stop is one row, and the next step no larger than others.
    steps = np.tile([0.01, 0.012, 0.011, 0.0, 0.01], 40)
    position = np.cumsum(steps)[:, None]
    time = np.arange(len(steps)) * 0.02
    assert not repeated_rows(Recording("log", time, position=position)).any()


def test_backwards_times_raise() -> None:
    time = np.arange(100) * 0.02
    time[40:] -= 0.5
    with pytest.raises(DataError, match=r"run backwards: 0\.300 s in row 41 follows"):
        correct_timing(recording(time))


def test_rows_of_one_time_are_dropped_but_not_most_of_a_log() -> None:
    time = np.arange(100) * 0.02
    time[10] = time[9]
    (part,), notes = correct_timing(recording(time))
    assert part.rows == 99
    assert "dropped 1 row at the time of the row before" in notes[0]
    with pytest.raises(DataError, match="write times with more digits"):
        correct_timing(recording(np.repeat(np.arange(25) * 1.0, 4)))


def test_other_channels_lose_the_same_rows() -> None:
    time = np.r_[np.arange(30), 100 + np.arange(20)] * 0.02
    count = np.arange(50.0)
    (_, second), _ = correct_timing(
        recording(time, command=count[:, None], extra={"volts": count})
    )
    np.testing.assert_array_equal(second.extra["volts"], np.arange(30.0, 50.0))
    np.testing.assert_array_equal(second.command[:, 0], np.arange(30.0, 50.0))


def test_noise_of_several_readings_never_repeats_by_chance() -> None:
    time = np.arange(300) * 0.02
    noise = np.random.default_rng(0).normal(0.0, 4e-4, (300, 2))
    position = 1e-3 * swing(time) + noise  # hardly moves, so that no jump shows
    position[[50, 51, 200]] = position[[49, 49, 199]]
    found = repeated_rows(Recording("log", time, position=position))
    assert np.flatnonzero(found).tolist() == [50, 51, 200]
