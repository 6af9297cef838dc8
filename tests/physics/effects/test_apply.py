"""Effects are applied in one order, checked first, and matched by name."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations

import mujoco
import numpy as np
import pytest

from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.effects import EFFECTS, AppliedEffect, register
from rlco.physics.effects.apply import (
    EffectError,
    apply_to_commands,
    apply_to_measurement,
    apply_to_spec,
    checked,
    step_terms,
    true_from_told,
)
from rlco.physics.effects.names import in_model, plain_name

# Two servos in a row, and a motor at the wrist.
ARM = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="robot0_upper">
      <inertial pos="0 0 .2" mass="1" diaginertia=".1 .1 .1"/>
      <joint name="robot0_shoulder" axis="0 1 0" damping="2"/>
      <body name="robot0_lower" pos="0 0 .4">
        <inertial pos="0 0 .2" mass="1" diaginertia=".1 .1 .1"/>
        <joint name="robot0_elbow" axis="0 1 0"/>
        <body name="gripper0_right_wrist" pos="0 0 .4">
          <inertial pos="0 0 .1" mass=".2" diaginertia=".01 .01 .01"/>
          <joint name="gripper0_right_elbow_wrist" axis="0 1 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="s" joint="robot0_shoulder" kp="50"/>
    <position name="e" joint="robot0_elbow" kp="20"/>
    <motor name="w" joint="gripper0_right_elbow_wrist"/>
  </actuator>
</mujoco>
"""
JOINTS = ("robot0_shoulder", "robot0_elbow", "gripper0_right_elbow_wrist")


def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(ARM)


def effect(name: str, target: str | None = None, **numbers: float) -> AppliedEffect:
    return AppliedEffect(name, target, numbers)


@pytest.fixture
def own_effect() -> Iterator[str]:
    """An effect of a user's own: it turns commands round, and measurements."""

    def negated(values: np.ndarray, column: int, *_: object) -> np.ndarray:
        values = values.copy()
        values[..., column] *= -1.0
        return values

    register(
        replace(
            EFFECTS["joint_offset"],
            name="crossed_wires",
            on_command=negated,
            on_measurement=negated,
            on_start=negated,
        )
    )
    yield "crossed_wires"
    del EFFECTS["crossed_wires"]


def test_commands_go_the_same_way_however_effects_are_listed(own_effect: str) -> None:
    # Steps of 2 ms. The controller reads 0 and 3 (at 0 and 6 ms) of 0 .. 5, which
    # arrive 4 ms later, lose half the play of 2, and count from an offset of 10.
    effects = [
        effect("control_rate", period=0.006),
        effect("command_delay", delay=0.004),
        effect("backlash", "robot0_elbow", width=2.0),
        effect("joint_offset", "robot0_elbow", offset=10.0),
        effect(own_effect, "robot0_elbow", offset=0.0),
    ]
    commands = np.zeros((6, 3))
    commands[:, 1] = np.arange(6.0)
    for listed in permutations(effects):
        out = apply_to_commands(commands, model(), listed)
        # The user's own comes last, and turns all round.
        np.testing.assert_allclose(out[:, 1], [10, 10, 10, 10, 10, 8])
    assert commands[5, 1] == 5.0


def test_a_measurement_takes_the_encoders_way_back(own_effect: str) -> None:
    effects = [
        effect("joint_offset", "robot0_elbow", offset=0.5),
        effect("encoder_scale", "robot0_elbow", factor=2.0),
        effect(own_effect, "robot0_elbow", offset=0.0),
    ]
    true = np.array([[1.0, 3.0, 5.0]])
    for listed in permutations(effects):
        told = apply_to_measurement(true, JOINTS, listed)
        # What a servo is told to reach is what it says when it is there.
        np.testing.assert_allclose(told, [[1.0, -3.0 * 2.0 + 0.5, 5.0]])
        np.testing.assert_allclose(true_from_told(told, JOINTS, listed), true)
        servo = apply_to_commands(told, model(), listed)
        np.testing.assert_allclose(servo[:, 1], true[:, 1])


def test_a_spec_is_changed_alike_however_effects_are_listed() -> None:
    effects = [
        effect("armature", "robot0_elbow", armature=0.3),
        effect("joint_compliance", "robot0_elbow", compliance=0.01),
        effect("actuator_gain", "robot0_elbow", factor=2.0),
        effect("torque_bias", "robot0_elbow", torque=1.0),
    ]
    found = []
    for listed in permutations(effects):
        spec = mujoco.MjSpec.from_string(ARM)
        apply_to_spec(spec, listed)
        mended = spec.compile()
        found.append([mended.dof_damping, mended.dof_armature, mended.actuator_biasprm])
    for other in found[1:]:
        for one, same in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(one, same)
    # kp of 20 doubled, and 1 N m beside it.
    np.testing.assert_allclose(found[0][2][1, :2], [1.0, -40.0])


def test_terms_of_each_step_are_those_of_their_joints() -> None:
    terms = step_terms(
        model(),
        [
            effect("load_friction", "gripper0_right_elbow_wrist", ratio=0.2),
            effect("drive_loss", "robot0_elbow", loss=0.5),
            effect("viscous_damping", "robot0_shoulder", damping=1.0),
        ],
    )
    np.testing.assert_array_equal(terms.load, [0.0, 0.0, 0.2])
    np.testing.assert_array_equal(terms.drive, [0.0, 0.5, 0.0])
    assert not terms.static.any()


def test_numbers_come_in_the_librarys_order() -> None:
    given = effect("payload", "robot0_lower", z=3.0, y=2.0, x=1.0, mass=0.5)
    assert checked(model(), given).values.tolist() == [0.5, 1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (effect("damping", "robot0_elbow", damping=1.0), "unknown effect 'damping'"),
        (effect("armature", "robot0_elbow"), "armature, and given were none; give"),
        (effect("armature", "robot0_elbow", armature=np.inf), "armature is inf"),
        (effect("armature", "knee", armature=1.0), "can act on robot0_shoulder, rob"),
        (effect("gravity_tilt", "robot0_elbow", roll=0, pitch=0), "the whole robot"),
        (effect("object_mass", "robot0_lower", factor=2), "nothing that it acts on"),
        (
            effect("backlash", "gripper0_right_elbow_wrist", width=0.1),
            "its actuator is a motor, which is commanded by a torque",
        ),
    ],
)
def test_what_does_not_fit_is_refused(wrong: AppliedEffect, message: str) -> None:
    with pytest.raises(RlcoError, match=message):
        checked(model(), wrong)


def test_encoders_of_motors_may_err_where_a_controller_reads_them() -> None:
    wrong = effect("joint_offset", "gripper0_right_elbow_wrist", offset=0.1)
    with pytest.raises(EffectError, match="its actuator is a motor"):
        checked(model(), wrong)
    assert checked(model(), wrong, controlled=True) == wrong


def test_names_are_found_with_and_without_robosuites_prefixes() -> None:
    def found(name: str, **names: str) -> str | None:
        given = [effect("armature", name, armature=1.0)]
        return in_model(given, model(), names)[0].target

    assert found("robot0_elbow") == "robot0_elbow"
    assert found("elbow") == "robot0_elbow"
    # The end of another joint's name is not that name.
    assert found("elbow_wrist") == "gripper0_right_elbow_wrist"
    assert found("wrist") == "gripper0_right_wrist"
    assert found("knee", knee="robot0_elbow") == "robot0_elbow"
    assert plain_name("fixed_mount0_base") == "base"
    with pytest.raises(UnknownNameError, match="unknown target of an effect 'knee'"):
        found("knee")


def test_a_lag_is_the_exact_filter_of_mujoco() -> None:
    constant, steps = 0.013, 60
    spec = mujoco.MjSpec.from_string(ARM)
    shoulder = spec.actuator("s")
    shoulder.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
    shoulder.dynprm[0] = constant
    lagging = spec.compile()
    data = mujoco.MjData(lagging)
    sent = np.random.default_rng(0).normal(size=(steps, 3)).cumsum(axis=0)
    data.act[0] = sent[0, 0]  # as our own filter starts
    reached = []
    for row in sent:
        data.ctrl[:] = row
        mujoco.mj_step(lagging, data)
        reached.append(float(data.act[0]))
    lag = effect("actuator_lag", JOINTS[0], time_constant=constant)
    out = apply_to_commands(sent, model(), [lag])
    np.testing.assert_allclose(out[:, 0], reached, atol=1e-12)
    np.testing.assert_array_equal(out[:, 1:], sent[:, 1:])
