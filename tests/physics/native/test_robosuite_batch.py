"""Native worlds of robosuite's own tasks are robosuite's own tasks."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import pytest
from robosuite.wrappers import GymWrapper
from robosuite_cases import CASES, JOINTS, arm_config, compare, make_case, pair, start

from rlco.errors import RlcoError, SimulationError, UnknownNameError
from rlco.physics.native.robosuite_batch import RobosuiteBatch
from rlco.physics.robosuite.robosuite_api import robosuite
from rlco.physics.robosuite.tasks import make_plain


@pytest.fixture(autouse=True, scope="module")
def forgotten_pairs() -> Iterator[None]:
    """Free the pairs at the end: with 35 GB of address space no process can fork."""
    yield
    pair.cache_clear()
    gc.collect()


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_every_control_step_is_robosuites(name: str) -> None:
    worst = compare(name, exact=True, episodes=2, steps=12)

    assert worst.qpos <= 1e-9
    assert worst.observation <= 1e-9
    assert worst.reward <= 1e-9


def test_fast_arithmetic_differs_by_rounding() -> None:
    worst = compare("Lift", exact=False, episodes=2, steps=8)

    assert 0.0 < worst.qpos <= 1e-9
    assert worst.reward <= 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Lift", "Door", "joint position"])
def test_an_open_loop_in_the_air_stays_with_robosuite(name: str) -> None:
    env, batch = pair(name, exact=False)
    size = batch.action_size
    for seed in (7, 8):
        start(env, batch, seed)
        rng = np.random.default_rng(seed)
        for step in range(20):
            action = rng.uniform(-0.3, 0.3, size)
            if size == 7:
                action[2] = 0.5 if step < 8 else 0.0  # up, away from things
            action[-1] = -1.0  # fingers that stay open touch nothing
            env.step(action)
            batch.step(action[None, None])
            apart = np.abs(env.sim.data._data.qpos - batch.data[0].qpos).max()
            assert apart <= 1e-6


def test_a_door_stands_elsewhere_in_every_copy() -> None:
    # A reset of Door writes into the model: each world has its own numbers there.
    batch = RobosuiteBatch(make_case("Door"), num_envs=3, threads=1)
    batch.reset([1, 2, 3])
    alone = RobosuiteBatch(make_case("Door"), num_envs=1, threads=1)
    actions = np.random.default_rng(0).uniform(-1, 1, (3, 2, 7))
    together = batch.step(actions)
    doors = together.observations["door_pos"]
    assert len(np.unique(doors.round(6), axis=0)) == 3
    for index in range(3):
        alone.reset([index + 1])
        out = alone.step(actions[index : index + 1])
        np.testing.assert_array_equal(out.observations["door_pos"][0], doors[index])
        np.testing.assert_array_equal(alone.data[0].qpos, batch.data[index].qpos)


def test_a_partial_reset_leaves_the_others_alone() -> None:
    batch = RobosuiteBatch(make_case("Door"), num_envs=2, threads=1)
    batch.reset([1, 2])
    batch.step(np.full((2, 2, 7), 0.3))
    before = {k: v.copy() for k, v in batch.observations().items()}
    qpos = batch.data[0].qpos.copy()

    after = batch.reset([5], np.array([1]))

    np.testing.assert_array_equal(batch.data[0].qpos, qpos)
    whole = RobosuiteBatch(make_case("Door"), num_envs=2, threads=1)
    fresh = whole.reset([1, 5])
    for key, value in after.items():
        np.testing.assert_array_equal(value[0], before[key][0])
        np.testing.assert_array_equal(value[1], fresh[key][1])
    # And the copy left alone moves on as if nothing had happened.
    whole.step(np.full((2, 2, 7), 0.3))
    np.testing.assert_array_equal(whole.data[0].qpos, qpos)
    again = np.full((2, 1, 7), -0.2)
    batch.step(again)
    whole.step(again)
    np.testing.assert_array_equal(whole.data[0].qpos, batch.data[0].qpos)


@pytest.mark.parametrize("rewards", [True, False])
def test_a_chunk_is_its_control_steps(rewards: bool) -> None:
    # NutAssembly's observations tell where a nut was one control step before.
    options: dict[str, Any] = {"num_envs": 2, "threads": 2, "rewards": rewards}
    batch = RobosuiteBatch(make_case("NutAssemblySquare"), **options)
    actions = np.random.default_rng(3).uniform(-1, 1, (2, 3, 7))
    batch.reset([1, 2])
    coarse = batch.step(actions, np.array([3, 2]))
    batch.reset([1, 2])
    fine = [batch.step(actions[:, t : t + 1], np.array([1, t < 2])) for t in range(3)]

    for key, value in coarse.observations.items():
        np.testing.assert_array_equal(value, fine[-1].observations[key])
    sums = np.concatenate([out.reward for out in fine], axis=1)
    np.testing.assert_array_equal(coarse.reward, sums)
    assert (coarse.reward[:, 0] > 0).all() == rewards
    assert coarse.reward[1, 2] == 0.0


def test_only_the_wanted_observations_are_there() -> None:
    batch = RobosuiteBatch(
        make_case("NutAssemblySquare"),
        num_envs=1,
        observations=["robot0_eef_pos", "object-state"],
    )
    seen = batch.reset([4])
    whole = RobosuiteBatch(make_case("NutAssemblySquare"), num_envs=1).reset([4])
    assert list(seen) == ["robot0_eef_pos", "object-state"]
    for key, value in seen.items():
        np.testing.assert_array_equal(value, whole[key])


def test_a_copy_that_diverges_is_marked_and_comes_back_with_its_reset(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings into a file
    batch = RobosuiteBatch(
        make_case("Lift"), num_envs=2, threads=1, exact=True, on_divergence="mark"
    )
    sound = {k: v.copy() for k, v in batch.reset([1, 2]).items()}
    batch.data[1].qvel[3] = 1e12
    out = batch.step(np.zeros((2, 2, 7)))
    assert out.diverged.tolist() == [False, True]
    for key, value in sound.items():
        np.testing.assert_array_equal(out.observations[key][1], value[1])
    assert (out.reward[1] == 0).all()

    batch.reset([2], np.array([1]))
    out = batch.step(np.zeros((2, 2, 7)))
    assert not out.diverged.any()
    assert (out.reward[1] > 0).all()


def test_divergence_raises_by_default(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    _, batch = pair("Lift", exact=False)
    batch.reset([1])
    batch.data[0].qpos[0] = np.nan
    with pytest.raises(SimulationError, match=r"'Lift' diverged .* environments \[0\]"):
        batch.step(np.zeros((1, 1, 7)))
    batch.reset([1])


# -- What is refused -----------------------------------------------------------

PLAIN = {"has_offscreen_renderer": False, "use_camera_obs": False, "renderer": "mujoco"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"type": "OSC_POSITION"}, "the controller OSC_POSITION"),
        ({"type": "JOINT_VELOCITY"}, "the controller JOINT_VELOCITY"),
        ({"impedance_mode": "variable_kp"}, "impedance_mode='variable_kp' of OSC_POSE"),
        ({"input_type": "absolute"}, "input_type='absolute' of OSC_POSE"),
        ({"interpolation": "linear"}, "interpolation of OSC_POSE"),
        ({"uncouple_pos_ori": False}, "uncouple_pos_ori=False of OSC_POSE"),
        (
            {**JOINTS, "qpos_limits": [[-1.0] * 7, [1.0] * 7]},
            "limits of the goal of JOINT_POSITION",
        ),
    ],
)
def test_controllers_that_are_not_computed_are_refused(
    changes: dict[str, Any], message: str
) -> None:
    env = make_plain("Lift", controller_configs=arm_config("Panda", changes))
    with pytest.raises(RlcoError, match=f"Lift: .* does not support {message}"):
        RobosuiteBatch(env, num_envs=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("TwoArmLift", {"robots": ["Panda", "Panda"]}, "more than one arm"),
        ("Lift", {"robots": "PandaOmron"}, r"the base of PandaOmron \(WheeledRobot\)"),
        ("Lift", {"robots": "IIWA"}, "IIWA, whose controller's frame moves"),
        ("Lift", {"lite_physics": False}, "lite_physics=False"),
        ("Lift", {"gripper_types": "RobotiqThreeFingerGripper"}, "the gripper Robotiq"),
        ("NutAssemblySingle", {}, "single_object_mode=1"),
        ("Wipe", {"gripper_types": "WipingGripper"}, r"its own _post_action\(\)"),
        ("ToolHang", {}, "observables that hold on to the arrays"),
    ],
)
def test_environments_that_do_more_are_refused(
    name: str, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(RlcoError, match=message):
        RobosuiteBatch(make_plain(name, **options), num_envs=1)


def test_noise_on_an_observable_and_a_model_that_is_rebuilt_are_refused() -> None:
    env = make_plain("Lift")
    env.modify_observable("cube_pos", "corrupter", lambda value: value + 1.0)
    with pytest.raises(RlcoError, match=r"noise, delay .* observable 'cube_pos'"):
        RobosuiteBatch(env, num_envs=1)
    env = robosuite.make("Lift", robots="Panda", **PLAIN)
    with pytest.raises(RlcoError, match="does not support hard_reset=True"):
        RobosuiteBatch(env, num_envs=1)
    with pytest.raises(RlcoError, match="GymWrapper is not a manipulation environment"):
        RobosuiteBatch(GymWrapper(env), num_envs=1)


def test_wrong_names_and_actions_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'Lift'"):
        make_plain("Lfit")
    with pytest.raises(RlcoError, match="hard_reset=True is not allowed"):
        make_plain("Lift", hard_reset=True)
    with pytest.raises(UnknownNameError, match="unknown observation 'cube_position'"):
        RobosuiteBatch(make_plain("Lift"), num_envs=1, observations=["cube_position"])
    _, batch = pair("Lift", exact=False)
    with pytest.raises(RlcoError, match="actions have size 6; Lift takes 7"):
        batch.step(np.zeros((1, 1, 6)))


def test_contacts_are_those_that_robosuite_finds() -> None:
    plain, batch = pair("NutAssembly", exact=True)
    env = batch.source.env
    start(plain, batch, 1)
    batch.data[0].qpos[:] = plain.sim.data._data.qpos
    nuts = [nut.contact_geoms for nut in plain.nuts]
    rng = np.random.default_rng(1)
    found = []
    for _ in range(12):
        # Nuts thrown onto the table, the pegs and each other.
        for at in (9, 16):
            batch.data[0].qpos[at : at + 3] = rng.uniform(
                [0, -0.2, 0.82], [0.3, 0.2, 0.9]
            )
        plain.sim.data._data.qpos[:] = batch.data[0].qpos
        mujoco.mj_forward(batch.model, batch.data[0])
        plain.sim.forward()
        groups: list[Any] = [*nuts, "table_collision", plain.robots[0].gripper["right"]]
        for one in groups:
            for other in [*groups, None]:
                expected = plain.check_contact(one, other)
                assert env.check_contact(one, other) == expected
                found.append(expected)
    assert 0 < sum(found) < len(found)
