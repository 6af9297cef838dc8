"""The rules of pick_and_place, worked out by hand, its bowl and its expert."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from expert_cases import DOMAINS, expert_slopes, solved

from rlco.physics.native.stepper import NativeStepper
from rlco.physics.spec.domain import SIM, STAND_IN, Domain
from rlco.physics.spec.robot import PANDA
from rlco.physics.spec.task import SceneState
from rlco.physics.tasks.pick_and_place import SHAPES, TASK, sample

pytestmark = pytest.mark.slow

FAR = np.array([[0.0, 0.3, 0.82], [0.0, 0.0, 0.0], [0.0, -0.3, 0.822]])


def scene(
    centre: tuple[float, float, float] = (-0.07, 0.0, 0.825),
    tool: tuple[float, float, float] = (-0.15, 0.0, 0.98),
    opening: float = 0.08,
) -> SceneState:
    """Place the green object (instruction 1) and a bowl at (0.13, 0)."""
    objects = FAR.copy()
    objects[1] = centre
    return SceneState(
        tool_position=np.array(tool),
        tool_rotation=PANDA.down,
        gripper_opening=np.array(opening),
        joint_position=np.zeros(7),
        object_position=objects,
        object_quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)),
        joint_opening=np.zeros(0),
        goal_position=np.array([[0.13, 0.0, 0.8]]),
        goal_quaternion=np.array([[1.0, 0.0, 0.0, 0.0]]),
        instruction_id=np.array(1),
    )


@pytest.mark.parametrize("domain", DOMAINS, ids=lambda d: d.name)
def test_the_expert_solves_95_percent_in_every_domain(domain: Domain) -> None:
    assert solved(TASK, domain, 20).mean() >= 0.95


@pytest.mark.thorough
def test_a_training_episode_is_long_enough_in_the_slower_domain() -> None:
    assert solved(TASK, STAND_IN, 20, steps=TASK.training_horizon).mean() >= 0.95


@pytest.mark.thorough
def test_the_expert_copes_with_a_teleoperators_noise() -> None:
    assert solved(TASK, STAND_IN, 20, noise=0.1).mean() >= 0.9


def test_the_shaped_reward_worked_out_by_hand() -> None:
    # Before: 20 cm to go, 11.5 - 2.5 = 9 cm to rise, the tool 10 cm above it:
    # -10 * (0.20 + 0.09) - 4 * 0.10 = -3.3. After: 15 cm and 2 cm, in the hand: -1.7.
    before = scene((-0.07, 0.0, 0.825), tool=(-0.07, 0.0, 0.925))
    after = scene((-0.02, 0.0, 0.895), tool=(-0.02, 0.0, 0.895))
    assert TASK.reward(before, after, "shaped") == pytest.approx(3.3 - 1.7)
    assert TASK.reward(after, before, "shaped") == pytest.approx(1.7 - 3.3)


def test_over_the_bowl_it_may_sink_but_not_beside_it() -> None:
    over = scene((0.13, 0.0, 0.875), tool=(0.13, 0.0, 0.875))
    dropped = scene((0.13, 0.0, 0.83), tool=(0.13, 0.0, 0.875))
    assert TASK.reward(over, dropped, "shaped") == pytest.approx(0.05)
    # 10 cm from the middle it costs all of the 4.5 cm, and what the tool is away.
    beside = scene((0.03, 0.0, 0.875), tool=(0.03, 0.0, 0.875))
    lost = scene((0.03, 0.0, 0.83), tool=(0.03, 0.0, 0.875))
    expected = -10.0 * 0.045 - 4.0 * 0.045
    assert TASK.reward(beside, lost, "shaped") == pytest.approx(expected)


def test_another_object_earns_nothing() -> None:
    start = scene()
    objects = start.object_position.copy()
    objects[0] = (0.13, 0.0, 0.83)  # the red one lies in the bowl
    after = replace(start, object_position=objects)
    assert TASK.reward(start, after, "shaped") == pytest.approx(0.0)
    assert not TASK.success(after)


def test_success_at_its_thresholds() -> None:
    # 5 cm from the bowl's middle in the plane, its centre below the rim at 4.5 cm.
    assert TASK.success(scene((0.1799, 0.0, 0.83)))
    assert not TASK.success(scene((0.1801, 0.0, 0.83)))
    assert TASK.success(scene((0.13, 0.0, 0.8449)))
    assert not TASK.success(scene((0.13, 0.0, 0.8451)))
    assert not TASK.success(scene((0.13, 0.0, 0.79)))  # under the table


def test_the_expert_closes_lifts_carries_and_lets_go() -> None:
    # Open above the object: straight down.
    down = TASK.expert(scene(tool=(-0.07, 0.0, 0.86)))
    np.testing.assert_allclose(down[:2], 0.0, atol=1e-12)
    assert down[2] < -0.5
    assert down[6] == -1.0
    # Around it: close and stay. Closed: straight up first.
    grasp = {"tool": (-0.07, 0.0, 0.825)}
    np.testing.assert_allclose(TASK.expert(scene(**grasp))[[0, 1, 2, 6]], [0, 0, 0, 1])
    lift = TASK.expert(scene(**grasp, opening=0.04))
    assert lift[2] > 0.9
    assert abs(lift[0]) < 0.15
    # High enough: towards the bowl, held. Above it and low: let go.
    high = TASK.expert(scene((-0.07, 0, 0.915), tool=(-0.07, 0, 0.915), opening=0.04))
    np.testing.assert_allclose(high[[0, 1, 2, 6]], [1, 0, 0, 1], atol=1e-12)
    release = scene((0.13, 0, 0.875), tool=(0.13, 0, 0.875), opening=0.04)
    assert TASK.expert(release)[6] == -1.0
    # In the bowl: up and away, open.
    done = TASK.expert(scene((0.13, 0, 0.83), tool=(0.13, 0, 0.875)))
    np.testing.assert_allclose(done[[0, 1, 6]], [0, 0, -1], atol=1e-12)
    assert done[2] > 0.0


def test_the_expert_is_a_continuous_function() -> None:
    rng = np.random.default_rng(0)
    for seed in range(200):
        centre = np.array([0.0, 0.0, 0.82]) + rng.uniform(0, (0.15, 0.05, 0.1))
        tool = centre + rng.uniform(-0.03, 0.03, 3)
        state = scene(tuple(centre), tuple(tool), rng.uniform(0.04, 0.06))
        # Gripper and held weigh tens of a centimetre's ramp; a jump is a million.
        assert expert_slopes(TASK, state, seed).max() < 2e3


def test_what_falls_into_the_bowl_stays_in_it() -> None:
    stepper = NativeStepper(TASK, SIM, num_envs=3)
    starts = []
    for index in range(3):
        start = sample(np.random.default_rng([3, index]))
        pose = start.object_pose.copy()
        pose[index, :2] = start.goal_position[0, :2] + (0.02, 0.02)
        pose[index, 2] = 0.88
        starts.append(replace(start, object_pose=pose, instruction_id=index))
    state = stepper.reset(starts)
    assert not TASK.success(state).any()
    after = stepper.step(np.zeros((3, 30, 7)))
    assert TASK.success(after.at(np.s_[:, -1])).all()
    # At rest on its bottom, which is 4 mm thick.
    heights = after.object_position[range(3), -1, range(3), 2] - 0.804
    np.testing.assert_allclose(
        heights, [shape.height for shape in SHAPES.values()], atol=0.004
    )


def test_objects_stand_still_until_they_are_touched() -> None:
    stepper = NativeStepper(TASK, STAND_IN, num_envs=1)
    state = stepper.reset([sample(np.random.default_rng(8))])
    after = stepper.step(np.zeros((1, 40, 7))).at((0, -1))
    moved = np.abs(after.object_position - state.object_position[0])
    assert moved.max() < 1e-3


def test_starts_lie_within_their_bounds() -> None:
    starts = [sample(np.random.default_rng([1, i])) for i in range(500)]
    poses = np.stack([s.object_pose for s in starts])
    bowls = np.stack([s.goal_position[0] for s in starts])
    assert poses[..., 0].min() >= -0.10
    assert poses[..., 0].max() <= -0.04
    columns = np.sort(poses[..., 1], axis=1)
    assert np.abs(columns - [-0.12, 0.0, 0.12]).max() <= 0.015
    np.testing.assert_allclose(poses[..., 2], [[0.82, 0.825, 0.822]] * 500)
    # Neither the bowl, 7 cm wide on either side, nor its rim meets an object.
    assert (bowls[:, None, 0] - poses[..., 0]).min() > 0.07 + 0.03
    assert np.abs(bowls[:, 1]).max() <= 0.10
    counts = np.bincount([s.instruction_id for s in starts], minlength=3)
    # Expected 166.7 each, standard deviation 10.5; four of them.
    assert np.abs(counts - 500 / 3).max() <= 42
