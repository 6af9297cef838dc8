"""The rules of close_drawer, worked out by hand, and its expert."""

from __future__ import annotations

import numpy as np
import pytest
from drawer_cases import drawer_scene
from expert_cases import DOMAINS, expert_slopes, solved

from rlco.physics.spec.domain import STAND_IN, Domain
from rlco.physics.tasks.close_drawer import TASK, sample

pytestmark = pytest.mark.slow

# Before the handle, where a finger touches it.
TOUCHING = {"outside": 0.017, "side": 0.0, "above": 0.0}


@pytest.mark.thorough
@pytest.mark.parametrize("domain", DOMAINS, ids=lambda d: d.name)
def test_the_expert_closes_95_percent_in_every_domain(domain: Domain) -> None:
    assert solved(TASK, domain, 20).mean() >= 0.95


def test_a_training_episode_is_long_enough_in_the_slower_domain() -> None:
    assert solved(TASK, STAND_IN, 20, steps=TASK.training_horizon).mean() >= 0.95


@pytest.mark.thorough
def test_the_expert_copes_with_a_teleoperators_noise() -> None:
    assert solved(TASK, STAND_IN, 20, noise=0.1).mean() >= 0.9


def test_the_shaped_reward_worked_out_by_hand() -> None:
    # Closed from 10 to 6 cm: 10 * 0.04 = 0.4.
    # The corridor is 4 cm wide and ends 4.5 cm before the handle. Before, the tool is
    # 5.5 cm short of it, 3 cm beside it and 8 cm above: sqrt(0.055^2 + 0.03^2 + 0.08^2)
    # = 0.101612; after, it is 1 cm too low: 4 * (0.101612 - 0.01) = 0.366448.
    before = drawer_scene(0.10, 0.10, -0.05, 0.08)
    after = drawer_scene(0.06, 0.03, 0.01, -0.01)
    reward = TASK.reward(before, after, "shaped")
    assert reward == pytest.approx(0.4 + 0.366448, abs=1e-5)
    back = TASK.reward(after, before, "shaped")
    assert reward + back == pytest.approx(0.0)


def test_a_closed_drawer_earns_a_twentieth_and_lets_the_tool_leave() -> None:
    there = drawer_scene(0.01, **TOUCHING)
    left = drawer_scene(0.01, 0.1, 0.1, 0.1)
    assert TASK.reward(there, left, "shaped") == pytest.approx(0.05)
    # 2 cm open, the way to the corridor counts by half: 4 cm above costs 8 cents.
    near, above = (drawer_scene(0.02, 0.03, 0.0, height) for height in (0.0, 0.04))
    assert TASK.reward(near, above, "shaped") == pytest.approx(-0.5 * 4.0 * 0.04)


def test_success_at_its_threshold() -> None:
    assert TASK.success(drawer_scene(0.0099, **TOUCHING))
    assert not TASK.success(drawer_scene(0.0101, **TOUCHING))


def test_the_expert_pushes_what_it_is_placed_before_and_rises_over_the_handle() -> None:
    # 3 of 5 cm a step, straight in.
    push = TASK.expert(drawer_scene(0.08, **TOUCHING))
    np.testing.assert_allclose(push, [0.6, 0, 0, 0, 0, 0, 1.0], atol=1e-12)
    # Behind the handle and low it goes up, hardly anywhere else.
    up = TASK.expert(drawer_scene(0.08, -0.028, 0.0, 0.0))
    assert up[2] > 0.85
    assert np.abs(up[:2]).max() < 0.06


def test_the_expert_is_a_continuous_function() -> None:
    rng = np.random.default_rng(0)
    for seed in range(200):
        place = rng.uniform((-0.05, -0.05, -0.02), (0.1, 0.05, 0.1))
        state = drawer_scene(rng.uniform(0.0, 0.1), *place)
        assert expert_slopes(TASK, state, seed).max() < 1e3


def test_starts_lie_within_their_bounds() -> None:
    starts = [sample(np.random.default_rng([1, i])) for i in range(500)]
    openings = np.stack([s.fixture_opening() for s in starts])
    assert 0.07 <= openings.min() < openings.max() <= 0.12
    places = np.stack([s.goal_position[0] for s in starts])
    np.testing.assert_allclose(places[:, 2], 0.8)
    assert np.abs(places[:, :2] - (0.20, 0.0)).max(axis=0).tolist() <= [0.02, 0.06]
    turns = np.stack([s.goal_orientation()[0] for s in starts])
    yaw = 2 * np.arctan2(turns[:, 3], turns[:, 0])
    assert 0.11 < np.abs(yaw).max() <= 0.12
