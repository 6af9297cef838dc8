"""The noise of a measurement is found under motion, quantised or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rlco.gap.compare.noise import measurement_noise, position_noise
from rlco.gap.logs.log import Array, Log, Recording

TRUE = 4e-4  # [rad]
STEP = 2.0 * np.pi / 4096  # a 12-bit encoder's


def swing(time: Array, rate: float = 1.3) -> Array:
    """A joint that swings by 0.9 rad, up to 6 rad/s, with a faster wobble on it."""
    return 0.7 * np.sin(2 * np.pi * rate * time) + 0.2 * np.sin(2.2 * time + 1)


def moves_and_holds(time: Array) -> Array:
    """Minimum-jerk moves of 1.2 s with rests of 0.8 s between them."""
    places = np.random.default_rng(5).uniform(-1, 1, int(time[-1] / 2) + 2)
    number = (time / 2).astype(int)
    part = np.clip((time - 2 * number) / 1.2, 0, 1)
    smooth = part**3 * (10 - 15 * part + 6 * part**2)
    return places[number] + smooth * (places[number + 1] - places[number])


def noisy(clean: Array, seed: int = 0, size: float = TRUE) -> Array:
    return clean + np.random.default_rng(seed).normal(0, size, clean.shape)


def estimate(time: Array, values: Array) -> tuple[float, float]:
    noise = measurement_noise([(time, values[:, None])])
    return float(noise.deviation[0]), float(noise.quantum[0])


@pytest.mark.parametrize("rate", [30.0, 50.0, 200.0])
@pytest.mark.parametrize("motion", [swing, moves_and_holds, np.zeros_like])
def test_white_noise_is_found_under_any_motion(rate: float, motion: object) -> None:
    time = np.arange(int(40 * rate)) / rate
    deviation, quantum = estimate(time, noisy(motion(time)))
    assert deviation == pytest.approx(TRUE, rel=0.2)
    assert quantum == 0.0


def test_motion_that_is_a_thousand_times_larger_is_not_taken_for_noise() -> None:
    time = np.arange(2000) / 50
    clean = swing(time)
    assert np.diff(clean).std() > 100 * TRUE
    assert estimate(time, clean)[0] < 0.05 * TRUE


def test_uneven_times_are_no_noise() -> None:
    time = np.cumsum(np.random.default_rng(1).uniform(0.012, 0.028, 2000))
    assert estimate(time, noisy(swing(time)))[0] == pytest.approx(TRUE, rel=0.2)
    # As if the rows were even, the same readings look many times noisier.
    even = np.arange(2000) / 50
    assert estimate(even, noisy(swing(time)))[0] > 5 * TRUE


@pytest.mark.parametrize("motion", [swing, moves_and_holds])
@pytest.mark.parametrize("rate", [30.0, 50.0])
def test_a_twelve_bit_encoder_adds_its_steps(rate: float, motion: object) -> None:
    time = np.arange(int(60 * rate)) / rate
    clean = noisy(motion(time), size=3e-4)
    read = (STEP * np.round(clean / STEP)).astype(np.float32).astype(float)
    deviation, quantum = estimate(time, read)
    assert quantum == pytest.approx(STEP, rel=1e-3)
    # Noise and steps are independent: sqrt(0.3^2 + 1.534^2 / 12) = 0.535 mrad.
    assert deviation == pytest.approx(5.35e-4, rel=0.2)


def test_at_rest_the_steps_alone_are_the_floor() -> None:
    time = np.arange(1000) / 50
    read = STEP * np.round((0.4 + 0.01 * np.sin(0.3 * time)) / STEP)
    deviation, quantum = estimate(time, read)
    assert quantum == pytest.approx(STEP)
    assert deviation == pytest.approx(STEP / np.sqrt(12))


def test_rounded_text_is_a_quantum_and_floating_point_is_none() -> None:
    time = np.arange(1000) / 50
    values = noisy(swing(time), size=1e-5)
    assert estimate(time, np.round(values, 3))[1] == pytest.approx(1e-3)
    assert estimate(time, values.astype(np.float32).astype(float))[1] == 0.0


def test_jerks_and_repeated_rows_do_not_move_the_estimate() -> None:
    time = np.arange(3000) / 50
    values = noisy(swing(time))
    values[100::150] = values[99::150]
    values += 0.05 * (time > 31)
    assert estimate(time, values)[0] == pytest.approx(TRUE, rel=0.25)


def test_each_joint_of_a_log_has_its_own() -> None:
    sizes = np.array([2e-4, 1e-3])
    recordings = []
    for seed in range(4):
        time = np.arange(300) / 50
        clean = np.stack([swing(time), moves_and_holds(time)], axis=1)
        noise = np.random.default_rng(seed).normal(size=clean.shape) * sizes
        recordings.append(Recording(str(seed), time, clean + noise))
    log = Log(tuple(recordings), ("a", "b"))
    np.testing.assert_allclose(position_noise(log).deviation, sizes, rtol=0.2)


def test_times_that_are_not_known_add_noise_in_motion() -> None:
    time = np.arange(1000) * 0.02
    random = np.random.default_rng(0)
    still, moving = np.zeros(1000), 0.5 * np.sin(4.0 * time)
    position = np.stack([still, moving], axis=1) + random.normal(0, 4e-4, (1000, 2))
    recording = Recording("log", time, position)
    known = position_noise(Log((recording,))).deviation
    doubted = position_noise(Log((replace(recording, jitter=1e-3),))).deviation
    assert doubted[0] == pytest.approx(known[0], rel=0.01)
    # 2 rad/s at most, 2 / sqrt(2) in the mean square, times a millisecond.
    assert doubted[1] == pytest.approx(np.hypot(known[1], 2e-3 / np.sqrt(2)), rel=0.02)


def test_a_reading_that_never_changes_is_as_noisy_as_the_others() -> None:
    """Its own noise, that of numbers alone, would outweigh every other joint."""
    time = np.arange(2000) / 50
    columns = [noisy(swing(time)), 0.0 * time, noisy(swing(time), 1, 3 * TRUE)]
    recordings = [(time, np.column_stack(columns)), (time, np.column_stack(columns))]
    deviation = measurement_noise(recordings).deviation
    assert deviation[0] == pytest.approx(TRUE, rel=0.2)
    assert deviation[1] == pytest.approx(2 * TRUE, rel=0.2)
    # What stands at another place in each recording does not change there, either.
    recordings[1] = (time, recordings[1][1] + np.array([0.0, 1.0, 0.0]))
    moved = measurement_noise(recordings)
    assert moved.deviation[1] == pytest.approx(2 * TRUE, rel=0.2)
    assert moved.quantum[1] == 0.0
    alone = measurement_noise([(time, np.full((2000, 1), 0.5))]).deviation
    assert 0.0 < alone[0] < 1e-6
