"""The rules of open_drawer, worked out by hand, its cabinet and its expert."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drawer_cases import drawer_scene
from expert_cases import DOMAINS, expert_slopes, solved

from rlco.physics.native.stepper import NativeStepper
from rlco.physics.spec.domain import SIM, STAND_IN, Domain
from rlco.physics.spec.observation import noise_size, observe
from rlco.physics.tasks.open_drawer import TASK, sample

# The place behind the handle: 2.85 cm towards the cabinet, 3 mm below its middle.
HOOKED = {"outside": -0.0285, "side": 0.0, "above": -0.003}


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize("domain", DOMAINS, ids=lambda d: d.name)
def test_the_expert_opens_95_percent_in_every_domain(domain: Domain) -> None:
    assert solved(TASK, domain, 20).mean() >= 0.95


def test_a_training_episode_is_long_enough_in_the_slower_domain() -> None:
    assert solved(TASK, STAND_IN, 20, steps=TASK.training_horizon).mean() >= 0.95


@pytest.mark.thorough
def test_the_expert_copes_with_a_teleoperators_noise() -> None:
    assert solved(TASK, STAND_IN, 20, noise=0.1).mean() >= 0.9


def test_the_shaped_reward_worked_out_by_hand() -> None:
    # Opened from 2 to 5 cm: 10 * 0.03 = 0.3.
    # Before, the tool is 5 cm before the handle; the slot above ends 2.05 cm behind it:
    # 7.05 cm off and 6 cm too high, sqrt(0.0705^2 + 0.06^2) = 0.0925756. After, it is
    # above the slot and 3 cm too high: 4 * (0.0925756 - 0.03) = 0.2503026.
    before = drawer_scene(0.02, 0.05, 0.0, 0.057)
    after = drawer_scene(0.05, -0.0285, 0.0, 0.027)
    reward = TASK.reward(before, after, "shaped")
    assert reward == pytest.approx(0.3 + 0.2503026, abs=1e-6)
    back = TASK.reward(after, before, "shaped")
    assert reward + back == pytest.approx(0.0)


def test_the_slot_is_wider_for_a_tool_that_is_in_it() -> None:
    # A finger against the handle, 1.7 cm behind its middle, has nothing left to gain.
    def gain(above: float) -> float:
        there = drawer_scene(0.0, **{**HOOKED, "above": above})
        touching = drawer_scene(0.0, -0.017, 0.0, above)
        return float(TASK.reward(there, touching, "shaped"))

    assert gain(-0.003) == pytest.approx(0.0)
    # At travel height it is 3.5 mm beside the slot: 0.048 up, sqrt(.048^2 + .0035^2).
    away = np.hypot(0.048, 0.0035) - 0.048
    assert gain(0.045) == pytest.approx(-4.0 * away)


def test_an_open_drawer_earns_a_twentieth_and_no_more() -> None:
    # From 11 cm on nothing is missing; 8 cm is solved.
    there, further = (drawer_scene(width, **HOOKED) for width in (0.11, 0.14))
    assert TASK.reward(there, further, "shaped") == pytest.approx(0.05)
    # And the tool may leave.
    left = drawer_scene(0.11, 0.1, 0.1, 0.1)
    assert TASK.reward(there, left, "shaped") == pytest.approx(0.05)


def test_success_at_its_threshold() -> None:
    assert TASK.success(drawer_scene(0.0801, **HOOKED))
    assert not TASK.success(drawer_scene(0.0799, **HOOKED))


def test_the_expert_turns_with_the_cabinet() -> None:
    # Everything turned by 0.1 rad about the cabinet: so is the planar move.
    for place in (HOOKED, {"outside": 0.1, "side": 0.03, "above": 0.08}):
        straight = TASK.expert(drawer_scene(0.02, **place))
        turned = TASK.expert(drawer_scene(0.02, **place, yaw=0.1))
        c, s = np.cos(0.1), np.sin(0.1)
        expected = np.array([[c, -s], [s, c]]) @ straight[:2]
        np.testing.assert_allclose(turned[:2], expected, atol=1e-12)
        np.testing.assert_allclose(turned[2:], straight[2:], atol=1e-12)
    # Hooked it pulls straight out, 3 of 5 cm a step.
    pull = TASK.expert(drawer_scene(0.02, **HOOKED))
    np.testing.assert_allclose(pull, [-0.6, 0, 0, 0, 0, 0, 1.0], atol=1e-12)


def test_the_expert_is_a_continuous_function() -> None:
    rng = np.random.default_rng(0)
    for seed in range(200):
        place = rng.uniform((-0.05, -0.05, -0.02), (0.1, 0.05, 0.1))
        state = drawer_scene(rng.uniform(0.0, 0.1), *place)
        # The steepest ramp takes 4 mm; a jump would be a slope of a million.
        assert expert_slopes(TASK, state, seed).max() < 1e3


def test_the_runners_are_rougher_in_the_stand_in() -> None:
    for domain, expected in ((SIM, 1.2), (STAND_IN, 2.4)):
        model = NativeStepper(TASK, domain, num_envs=1).model
        dof = model.joint("cabinet_slide").dofadr[0]
        assert model.dof_frictionloss[dof] == pytest.approx(expected)


def test_a_drawer_that_nobody_touches_stays_where_it_is() -> None:
    stepper = NativeStepper(TASK, SIM, num_envs=1)
    start = sample(np.random.default_rng(1))
    start = replace(start, joint_opening=np.array([0.07]))
    state = stepper.reset([start])
    # The handle is where the cabinet's pose and the opening say.
    x, y, _ = start.goal_position[0]
    yaw = 2 * np.arctan2(start.goal_quaternion[0, 3], start.goal_quaternion[0, 0])
    expected = (x - 0.221 * np.cos(yaw), y - 0.221 * np.sin(yaw), 0.88)
    np.testing.assert_allclose(state.object_position[0, 0], expected, atol=1e-12)
    after = stepper.step(np.zeros((1, 20, 7)))
    assert np.abs(after.joint_opening - 0.07).max() < 1e-4


def test_what_is_seen_tells_yaw_and_opening() -> None:
    state = drawer_scene(0.04, **HOOKED, yaw=0.1)
    silent = np.zeros(noise_size(TASK))
    seen = observe(TASK, SIM, state, silent)[1]
    line = seen[2:] - seen[:2]
    assert np.arctan2(line[1], line[0]) == pytest.approx(0.1)
    assert np.linalg.norm(line) - 0.151 == pytest.approx(0.04)
