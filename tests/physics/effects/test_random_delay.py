"""Commands that arrive late at random: their distribution, their order, their seeds."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from rlco.physics.effects import EFFECTS, AppliedEffect
from rlco.physics.effects.apply import EffectError, checked, controller_timing
from rlco.physics.effects.command import delay_quantiles, drawn_delay, newest_arrival
from rlco.physics.effects.corrected_model import without_effects

FINE = 1e-5  # physics step of which a delay is hardly rounded [s]
MODEL = mujoco.MjModel.from_xml_string("""<mujoco><worldbody><body>
<joint name="j"/><geom size=".1"/></body></worldbody>
<actuator><motor joint="j"/></actuator></mujoco>""")


def late(mean: float, spread: float) -> AppliedEffect:
    return AppliedEffect("random_delay", None, {"mean": mean, "spread": spread})


def drawn(mean: float, spread: float, episodes: int, commands: int) -> np.ndarray:
    """Return delays [s] of the first commands of episodes 0, 1, ..."""
    quantiles = delay_quantiles(mean, spread**2, FINE)
    return FINE * np.array(
        [
            [drawn_delay(quantiles, seed, number) for number in range(commands)]
            for seed in range(episodes)
        ]
    )


@pytest.mark.parametrize(
    ("mean", "spread"), [(0.05, 0.005), (0.05, 0.02), (0.02, 0.03)]
)
def test_delays_have_the_mean_the_spread_and_the_tail_of_a_gamma(
    mean: float, spread: float
) -> None:
    found = drawn(mean, spread, 100, 100)
    count, shape = found.size, (mean / spread) ** 2
    # Of a gamma: skewness 2 / sqrt(shape), kurtosis 3 + 6 / shape. Standard errors of
    # a mean and of a deviation follow; the quantiles themselves miss by up to 0.5 %.
    of_mean = spread / np.sqrt(count)
    of_spread = spread * np.sqrt((2 + 6 / shape) / (4 * count))
    assert abs(found.mean() - mean) < 4 * of_mean + 0.001 * mean
    assert abs(found.std() - spread) < 4 * of_spread + 0.005 * spread
    assert found.min() >= 0.0
    skewness = np.mean(((found - found.mean()) / found.std()) ** 3)
    assert skewness == pytest.approx(2 / np.sqrt(shape), rel=0.2, abs=0.1)


def test_delays_depend_neither_on_the_one_before_nor_on_the_episode_before() -> None:
    found = drawn(0.05, 0.02, 100, 100)
    normed = (found - found.mean()) / found.std()
    # A correlation of n independent pairs has a standard error of 1 / sqrt(n).
    for one, other in ((normed[:, 1:], normed[:, :-1]), (normed[1:], normed[:-1])):
        assert abs(np.mean(one * other)) < 4 / np.sqrt(one.size)
    np.testing.assert_array_equal(found, drawn(0.05, 0.02, 100, 100))


def with_delays(wanted: list[int], seed: int) -> np.ndarray:
    """Return quantiles by which the first commands of an episode have these delays."""
    ranks = np.arange(100_003)
    quantiles = np.zeros(ranks.size, dtype=np.int64)
    for number, delay in enumerate(wanted):
        quantiles[drawn_delay(ranks, seed, number)] = delay
    return quantiles


def held(
    wanted: list[int], steps: int, *, fixed: int = 0, period: float = 0.0
) -> list[int]:
    """Return the command that a robot holds at each step; one is sent every 5 steps."""
    quantiles, passed, holds, found = with_delays(wanted, 7), -1, -1, []
    for clock in range(steps):
        before = passed
        passed, arrived = newest_arrival(
            quantiles, 7, fixed, period, 5, clock, before, clock // 5
        )
        holds = arrived if arrived > before else holds
        found.append(holds)
    return found


def test_a_robot_holds_the_latest_command_that_has_arrived() -> None:
    # Sent at 0, 5, 10, 15 and 20, they would be there at 7, 6, 23, 15 and 22. The
    # second waits for the first, and the last two for the third.
    delays = [7, 1, 13, 0, 2]
    assert held(delays, 25) == [-1] * 7 + [1] * 16 + [4] * 2
    # A delay of 4 steps besides moves all of it.
    assert held(delays, 29, fixed=4) == [-1] * 11 + [1] * 16 + [4] * 2


def test_a_sender_that_reads_slowly_sends_what_it_has_read() -> None:
    # Read at 0, 8, 16 and 24: the third, given at 10, is replaced by the fourth, given
    # at 15. The first is read at once, the second at 8, the fourth at 16 and the fifth
    # at 24; there they are at 7, 9, 16 and 26.
    found = held([7, 1, 13, 0, 2], 30, period=8.0)
    assert found == [-1] * 7 + [0] * 2 + [1] * 7 + [3] * 10 + [4] * 4


@pytest.mark.parametrize("period", [0.0, 3.3, 12.0])
def test_what_has_arrived_is_what_no_earlier_command_holds_back(period: float) -> None:
    rng = np.random.default_rng(3)
    for _ in range(30):
        quantiles = rng.integers(0, 60, 16)
        model = replace(without_effects(MODEL), random_delay=quantiles, period=period)
        room = model.acting(5).room
        # Commands are read at the first tick from when they are given on, and the last
        # of those read at a tick is sent. At most 100 commands are before the first.
        numbers = np.arange(-100, 60)
        ticks = np.arange(-600, 600)
        if period:
            ticks = ticks[np.diff(np.floor(np.r_[-601, ticks] / period + 1e-9)) > 0]
        read = ticks[np.searchsorted(ticks, 5 * numbers)]
        sent = np.r_[read[:-1] < read[1:], True]
        due = [
            t + drawn_delay(quantiles, 1, n) for t, n in zip(read, numbers, strict=True)
        ]
        due = np.maximum.accumulate(np.where(sent, due, -1000))
        passed = holds = -room
        for clock in range(1, 250):
            before, last = passed, clock // 5
            # A queue of this length has room for each.
            assert last - before <= room
            passed, arrived = newest_arrival(
                quantiles, 1, 0, period, 5, clock, before, last
            )
            holds = arrived if arrived > before else holds
            expected = numbers[sent & (due <= clock) & (5 * numbers <= clock)]
            assert holds == max(expected[-1], -room)


def test_without_a_spread_it_is_a_command_delay() -> None:
    fixed = AppliedEffect("command_delay", None, {"delay": 0.07})
    assert controller_timing(MODEL, [late(0.07, 0.0)]).delay == 0.07
    assert controller_timing(MODEL, [late(0.07, 0.0)]).random_variance == 0.0
    commands = np.sin(np.arange(300.0) / 20)[:, None]
    both = [
        EFFECTS[one.name].on_command(commands, None, 0.002, one.values)
        for one in (fixed, late(0.07, 0.03))
    ]
    # Recorded commands come late by the mean, whatever the spread.
    np.testing.assert_array_equal(*both)


def test_two_random_delays_add_their_means_and_variances() -> None:
    timing = controller_timing(MODEL, [late(0.02, 0.03), late(0.05, 0.04)])
    assert timing.random_mean == pytest.approx(0.07)
    assert timing.random_variance == pytest.approx(0.05**2)


@pytest.mark.parametrize(
    ("mean", "spread", "message"),
    [
        (0.0, 0.02, "spread=0.02 of delays that are never negative and whose mean is"),
        (-0.01, 0.0, "mean=-0.01 s cannot be so small; give 0 or more"),
        (0.05, -0.02, "spread=-0.02 s cannot be so small; give 0 or more"),
    ],
)
def test_delays_that_no_gamma_has_are_refused(
    mean: float, spread: float, message: str
) -> None:
    with pytest.raises(EffectError, match=message) as caught:
        checked(MODEL, late(mean, spread))
    assert "\n" not in str(caught.value)
    assert checked(MODEL, late(0.0, 0.0)) == late(0.0, 0.0)
