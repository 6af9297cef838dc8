"""Each effect changes the motion in the direction that its physics has."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from effect_cases import (
    EFFECTS,
    TASK,
    Array,
    effect,
    height,
    hold,
    play,
    rise,
    start_of,
)

from rlco.envs import make_env
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.spec.domain import SIM, Domain
from rlco.physics.spec.sensors import Sensors

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    "name",
    ["payload", "link_inertia", "actuator_gain", "torque_limit", "drive_loss"],
)
def test_an_arm_that_is_weaker_or_heavier_than_it_knows_sinks(name: str) -> None:
    plain, weak = play(None, hold()), play([EFFECTS[name]], hold())
    assert height(weak) < height(plain) - 0.002


@pytest.mark.parametrize(
    "name",
    ["coulomb_friction", "viscous_damping", "stribeck_friction", "load_friction"],
)
def test_friction_leaves_an_arm_behind(name: str) -> None:
    plain, slow = play(None, rise()), play([EFFECTS[name]], rise())
    start = play(None, hold(1))
    assert height(plain) - height(start) > 0.05
    assert height(slow) < height(plain) - 5e-4


@pytest.mark.parametrize("name", ["armature", "actuator_lag"])
def test_inertia_and_lag_delay_the_start_of_a_motion(name: str) -> None:
    after_rest = np.concatenate([hold(3), rise(1)])

    def risen(effects: Any) -> float:
        return height(play(effects, after_rest)) - height(play(effects, hold(4)))

    assert 0.0 < risen([EFFECTS[name]]) < risen(None) - 1e-4


QUIET = Domain("quiet", sensors=Sensors(object_noise=0.0))


def test_nothing_moves_before_a_delayed_command_arrives() -> None:
    # 0.13 s: after two control steps of 0.05 s, and 15 physics steps of the third.
    late = [EFFECTS["command_delay"]]
    assert height(play(late, rise(2))) == height(play(late, hold(2)))
    assert height(play(late, rise(3))) > height(play(late, hold(3))) + 1e-4
    # What has arrived by then is the command's first 20 ms.
    assert height(play(late, rise(3))) < height(play(None, rise(1)))


def test_a_delay_of_whole_control_steps_is_that_of_a_copy() -> None:
    late = play([effect("command_delay", delay=0.05)], rise(4))
    copies = NativeStepper(TASK, SIM, num_envs=1, threads=1)
    copies.randomise([0], command_delay=1)
    copies.reset([start_of(3)])
    copies.step(rise(4)[None])
    np.testing.assert_array_equal(late.data[0].qpos, copies.data[0].qpos)


def test_a_copys_own_delay_takes_the_place_of_the_domains() -> None:
    # 70 ms are a control step and 20 ms more, which stay.
    longer, shorter = (
        NativeStepper(
            TASK,
            SIM,
            num_envs=1,
            threads=1,
            effects=[effect("command_delay", delay=delay)],
        )
        for delay in (0.12, 0.07)
    )
    shorter.randomise([0], command_delay=2)
    for stepper in (longer, shorter):
        stepper.reset([start_of(3)])
        stepper.step(rise(5)[None])
    np.testing.assert_array_equal(longer.data[0].qpos, shorter.data[0].qpos)


def test_commands_between_two_readings_are_never_executed() -> None:
    # Read at 0, 0.12 and 0.24 s: the commands that count are the first, the third
    # and the fifth, whose 0.05 s the readings lie in.
    slow = [EFFECTS["control_rate"]]
    unread = hold(6)
    unread[[1, 3, 5]] = 0.5
    np.testing.assert_array_equal(
        play(slow, unread).data[0].qpos, play(slow, hold(6)).data[0].qpos
    )
    read = hold(6)
    read[4, 2] = 0.5
    assert height(play(slow, read)) > height(play(slow, hold(6))) + 1e-3


def test_a_torque_and_a_spring_pull_their_joint() -> None:
    plain = play(None, hold()).scene_state().joint_position[0]
    pushed = play([EFFECTS["torque_bias"]], hold()).scene_state().joint_position[0]
    pulled = play([EFFECTS["joint_stiffness"]], hold()).scene_state().joint_position[0]
    assert pushed[1] > plain[1] + 0.005
    # The spring rests at 0, and the elbow is at -2.8.
    assert pulled[3] > plain[3] + 0.005


def test_a_tilted_base_lets_the_arm_fall_to_the_low_side() -> None:
    plain = play(None, hold()).scene_state().tool_position[0]
    tilted = play([EFFECTS["gravity_tilt"]], hold()).scene_state().tool_position[0]
    assert tilted[0] > plain[0] + 0.002
    assert tilted[1] < plain[1] - 0.002


def test_encoders_tell_another_pose_than_the_arm_has() -> None:
    native = play([EFFECTS["joint_offset"], EFFECTS["encoder_scale"]], hold(3))
    true, told = native.scene_state(), native.reported_state()
    expected = true.joint_position[0] * [1, 1.06, 1, 1, 1, 1, 1]
    expected[3] += 0.05
    np.testing.assert_allclose(told.joint_position[0], expected, atol=1e-12)
    # The tool is told where the arm would have it at these angles.
    model, data = native.model, mujoco.MjData(native.model)
    data.qpos[:] = native.worlds.observed[0].qpos
    mujoco.mj_kinematics(model, data)
    site = native.tracked.site
    np.testing.assert_allclose(told.tool_position[0], data.site_xpos[site], atol=1e-12)
    assert np.abs(told.tool_position - true.tool_position).max() > 0.01
    # What a policy reads is what is told.
    env = make_env("push_cube", effects=[EFFECTS["joint_offset"]], domain=QUIET)
    seen = env.reset()["observation", "state"][0, :3].numpy()
    base = np.array([-0.56, 0.0, 0.912])
    told_now = env.stepper.reported_state().tool_position[0]
    np.testing.assert_allclose(seen, told_now - base, atol=1e-6)


def cube_after(effects: Any, *, push: float, force: float) -> Array:
    """Place of a cube after 0.2 s that begins with a speed, or under a force."""
    native = NativeStepper(TASK, SIM, num_envs=1, threads=1, effects=effects)
    native.reset([start_of(3)])
    joint = native.model.joint("red_cube_joint0")
    body = native.model.body("red_cube_main").id
    native.step(rise(4)[None])
    native.data[0].qvel[joint.dofadr[0] + 1] = push
    native.data[0].xfrc_applied[body, 1] = force
    native.step(rise(4)[None])
    place: Array = native.data[0].qpos[joint.qposadr[0] :][:3].copy()
    return place


def test_a_cube_slides_further_sinks_deeper_and_starts_slower() -> None:
    plain = cube_after(None, push=0.6, force=0.0)
    slippery = cube_after([EFFECTS["contact_friction"]], push=0.6, force=0.0)
    assert slippery[1] > plain[1] + 0.005
    soft = cube_after([EFFECTS["contact_stiffness"]], push=0.0, force=0.0)
    still = cube_after(None, push=0.0, force=0.0)
    assert soft[2] < still[2] - 1e-4
    # 1 N beats the friction of 0.06 kg, and not that of four times as much.
    light = cube_after(None, push=0.0, force=1.0)
    heavy = cube_after([EFFECTS["object_mass"]], push=0.0, force=1.0)
    assert light[1] - still[1] > 0.05
    assert abs(heavy[1] - still[1]) < 1e-3
