"""What is said of the robot is so in robosuite's model, and sizes follow from it."""

from __future__ import annotations

import numpy as np
import pytest

from rlco.physics.native.kernels import Tracked, feature_count
from rlco.physics.native.stepper import scene_of, tracked_of
from rlco.physics.spec.domain import SIM, STAND_IN
from rlco.physics.spec.robot import GRIPPER, PANDA, POSE
from rlco.physics.tasks.plain_robosuite import make_robosuite


def test_robosuites_model_has_the_pandas_parts() -> None:
    env = make_robosuite("push_cube")
    model, robot = env.sim.model._model, env.robots[0]
    assert list(robot.arms) == [PANDA.arm]
    addresses = [model.joint(name).qposadr[0] for name in PANDA.model_joints]
    np.testing.assert_array_equal(tracked_of(env).arm_qpos, addresses)
    for body in (*PANDA.bases, PANDA.hand):
        assert model.body(body).id > 0
    # Each finger moves by twice the half range, one to each side.
    fingers = robot._ref_gripper_joint_pos_indexes[PANDA.arm]
    joints = [i for i in range(model.njnt) if model.jnt_qposadr[i] in fingers]
    np.testing.assert_allclose(model.jnt_range[joints[0]], [0.0, PANDA.widest / 2.0])
    np.testing.assert_allclose(model.jnt_range[joints[1]], [-PANDA.widest / 2.0, 0.0])


def test_the_gripper_holds_the_opening_that_it_is_told() -> None:
    env = make_robosuite("pick_and_place")
    before = env.scene_state().gripper_opening
    goal = env.robots[0].gripper[PANDA.arm].current_action
    np.testing.assert_array_equal(goal, PANDA.gripper_goal(0.08))
    for _ in range(3):
        env.step(np.zeros(env.action_dim))
    assert env.scene_state().gripper_opening == pytest.approx(before, abs=1e-3)


def test_commands_are_as_large_as_the_controller_takes_them() -> None:
    arm = make_robosuite("push_cube").robots[0].part_controllers[PANDA.arm]
    np.testing.assert_array_equal(arm.output_max[:3], PANDA.largest_move)
    np.testing.assert_array_equal(arm.output_max[3:], PANDA.largest_turn)
    for names in (PANDA.state_names, PANDA.action_names):
        assert all(name.startswith("tool.") for name in names[POSE])
        assert names[GRIPPER].startswith("gripper")
        assert len(names) == GRIPPER + 1


def test_features_of_an_arm_with_six_joints() -> None:
    none = np.zeros(0, dtype=np.int64)
    six, two = np.arange(6), np.arange(2)
    tracked = Tracked(0, 0, 99, six, two, two, none, np.arange(1))
    features = np.arange(feature_count(tracked), dtype=float)
    state = scene_of(features, tracked, np.zeros((0, 7)), np.array(0))
    # Place 3, rotation 9, fingers 2; then joints, two poses, one opening.
    np.testing.assert_array_equal(state.joint_position, np.arange(14.0, 20.0))
    np.testing.assert_array_equal(
        state.object_position, [[20.0, 21.0, 22.0], [27.0, 28.0, 29.0]]
    )
    np.testing.assert_array_equal(state.joint_opening, [34.0])


def test_the_stand_ins_friction_is_that_of_every_joint() -> None:
    targets = [e.target for e in STAND_IN.effects if e.name == "coulomb_friction"]
    assert tuple(targets) == PANDA.joints
    assert SIM.effects == ()
