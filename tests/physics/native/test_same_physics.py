"""Worlds of the native stepper do not disturb each other; torques are robosuite's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stepping_cases import Array, starts

from rlco.errors import RlcoError, SimulationError
from rlco.physics.native.osc import (
    NULL_STIFFNESS,
    delta_rotation,
    joint_torques,
    orientation_error,
    robosuite_joint_torques,
)
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.robosuite.stepper import RobosuiteStepper
from rlco.physics.spec.domain import SIM
from rlco.physics.tasks.push_cube import TASK


def test_threads_and_copies_change_nothing() -> None:
    initial = starts(5, seed=9)
    actions = np.random.default_rng(9).uniform(-1, 1, (5, 8, 7))
    many = NativeStepper(TASK, SIM, num_envs=5, threads=2)
    many.reset(initial)
    together = many.step(actions)
    one = NativeStepper(TASK, SIM, num_envs=1, threads=1)
    for index, start in enumerate(initial):
        one.reset([start])
        alone = one.step(actions[index : index + 1])
        for name, value in vars(alone).items():
            np.testing.assert_array_equal(vars(together)[name][index], value[0])


def test_a_copy_executes_only_the_steps_it_has_left() -> None:
    stepper = NativeStepper(TASK, SIM, num_envs=2, threads=1)
    stepper.reset(starts(2))
    actions = np.full((2, 4, 7), 0.5)
    out = stepper.step(actions, np.array([4, 2])).joint_position
    # 25 physics steps of 2 ms a control step.
    assert [data.time for data in stepper.data] == pytest.approx([0.2, 0.1])
    np.testing.assert_array_equal(out[1, 3], out[1, 2])
    np.testing.assert_array_equal(out[1, 4], out[1, 2])
    assert not np.array_equal(out[0, 3], out[0, 2])


def test_what_lies_outside_the_range_is_clipped() -> None:
    stepper = NativeStepper(TASK, SIM, num_envs=2, threads=1)
    stepper.reset(starts(1) * 2)
    actions = np.zeros((2, 3, 7))
    actions[0, :, :3], actions[1, :, :3] = 1.0, 7.0
    out = stepper.step(actions).joint_position
    np.testing.assert_array_equal(out[0], out[1])


def test_a_later_reset_leaves_states_returned_earlier_alone() -> None:
    stepper = NativeStepper(TASK, SIM, num_envs=1, threads=1)
    first, second = starts(2)
    stepper.reset([first])
    state = stepper.step(np.zeros((1, 1, 7)))
    present = stepper.scene_state()
    goals, tool = state.goal_position.copy(), present.tool_position.copy()
    stepper.reset([second])
    np.testing.assert_array_equal(state.goal_position, goals)
    np.testing.assert_array_equal(present.tool_position, tool)


@pytest.mark.parametrize("backend", [NativeStepper, RobosuiteStepper])
def test_actions_that_are_nan_are_refused(
    backend: type[NativeStepper] | type[RobosuiteStepper],
) -> None:
    stepper = backend(TASK, SIM, num_envs=2)
    stepper.reset(starts(2))
    actions = np.zeros((2, 2, 7))
    actions[1, 1, 0] = np.nan
    with pytest.raises(RlcoError, match=r"environments \[1\] are NaN"):
        stepper.step(actions)


@pytest.mark.parametrize("backend", [NativeStepper, RobosuiteStepper])
def test_a_simulation_that_diverges_is_reported(
    backend: type[NativeStepper] | type[RobosuiteStepper],
    tmp_path: object,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(str(tmp_path))  # MuJoCo writes its warning into a file
    stepper = backend(TASK, SIM, num_envs=2)
    stepper.reset(starts(2))
    stepper.data[1].qvel[0] = np.nan
    with pytest.raises(SimulationError, match=r"diverged .* environments \[1\]"):
        stepper.step(np.zeros((2, 1, 7)))


# -- Torques -------------------------------------------------------------------


def both_torques(seed: int, size: int = 7) -> tuple[Array, Array]:
    """Return fast and robosuite's torques of one random robot."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(size, size))
    mass = root @ root.T + 0.5 * np.eye(size)
    jacobian = rng.normal(size=(6, size))
    bias, posture, position, velocity = rng.normal(size=(4, size))
    wanted = 10.0 * rng.normal(size=6)
    null = NULL_STIFFNESS * (posture - position)
    null -= 2.0 * np.sqrt(NULL_STIFFNESS) * velocity
    fast, slow = np.empty(size), np.empty(size)
    robosuite_joint_torques(
        mass.copy(), jacobian, bias, wanted.copy(), posture, position, velocity, slow
    )
    joint_torques(mass.copy(), jacobian, bias, wanted.copy(), null, fast)
    return fast, slow


def test_fast_torques_equal_robosuites_on_random_robots() -> None:
    for seed in range(200):
        fast, slow = both_torques(seed)
        assert np.abs(fast - slow).max() <= 1e-10 * np.abs(slow).max()


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(1_000, 2**32 - 1))
def test_fast_torques_equal_robosuites(seed: int) -> None:
    fast, slow = both_torques(seed)
    # Random Jacobians can be all but singular; the error grows with the torques.
    assert np.abs(fast - slow).max() <= 1e-9 * np.abs(slow).max()


def test_torques_of_a_robot_worked_out_by_hand() -> None:
    # Six joints, each moving one direction of the tool: J = I, M = diag(2).
    # Lambda = (J M^-1 J^T)^-1 = 2 I, so tau = 2 a + h + (M - Lambda) qdd0 = 2 a + h.
    wanted = np.array([1.0, -2.0, 0.5, 0.0, 3.0, -1.0])
    bias = np.arange(6.0)
    torque = np.empty(6)
    joint_torques(
        2.0 * np.eye(6), np.eye(6), bias, wanted.copy(), np.full(6, 9.0), torque
    )
    np.testing.assert_allclose(torque, 2.0 * wanted + bias, atol=1e-12)


def test_a_quarter_turn_as_matrix_and_as_error() -> None:
    # About z: x goes to y. robosuite rounds to float32 on the way.
    quarter = delta_rotation(np.array([0.0, 0.0, np.pi / 2]))
    expected = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(quarter, expected, atol=2e-7)
    # Half the crossed axes: sin(angle) about the axis, here sin(0.3) about x.
    c, s = np.cos(0.3), np.sin(0.3)
    desired = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    error = np.empty(3)
    orientation_error(desired, np.eye(3).ravel(), error)
    np.testing.assert_allclose(error, [np.sin(0.3), 0.0, 0.0], atol=1e-12)
