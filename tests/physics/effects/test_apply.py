"""Effects are applied in one order, checked first, and matched by name."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations

import mujoco
import numpy as np
import pytest

from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.effects import (
    EFFECTS,
    AppliedEffect,
    Parameter,
    register,
    searched,
)
from rlco.physics.effects.apply import (
    EffectError,
    apply_to_commands,
    apply_to_measurement,
    apply_to_spec,
    check_of_task,
    checked,
    library_effect,
    step_forces,
    true_positions,
)
from rlco.physics.effects.link_parameters import LINK_NUMBERS
from rlco.physics.effects.names import in_model, plain_name
from rlco.physics.effects.step_forces import law_value

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
        np.testing.assert_allclose(true_positions(told, JOINTS, listed), true)
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
        corrected = spec.compile()
        found.append(
            [corrected.dof_damping, corrected.dof_armature, corrected.actuator_biasprm]
        )
    for other in found[1:]:
        for one, same in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(one, same)
    # kp of 20 doubled, and 1 N m beside it.
    np.testing.assert_allclose(found[0][2][1, :2], [1.0, -40.0])


def test_targets_are_found_beside_a_body_that_another_effect_added() -> None:
    """MuJoCo's own look-up counts wrong in a copy of a spec that was compiled."""
    spec = mujoco.MjSpec.from_string(ARM)
    plain = spec.compile()
    changed = spec.copy()
    held = effect("payload", "robot0_upper", mass=0.5, x=0.0, y=0.0, z=0.1)
    heavy = effect("link_inertia", "gripper0_right_wrist", factor=3.0)
    play = effect("joint_compliance", "robot0_shoulder", compliance=0.01)
    rough = effect("coulomb_friction", "gripper0_right_elbow_wrist", frictionloss=2.0)
    apply_to_spec(changed, [held, heavy])
    wrist = changed.compile().body("gripper0_right_wrist")
    assert wrist.mass == pytest.approx(3.0 * plain.body(wrist.name).mass)
    changed = spec.copy()
    apply_to_spec(changed, [play])
    apply_to_spec(changed, [rough])
    loss = changed.compile().joint("gripper0_right_elbow_wrist").frictionloss
    assert loss == pytest.approx(2.0)


def test_forces_of_each_step_are_those_of_their_joints() -> None:
    forces = step_forces(
        model(),
        [
            effect("drive_loss", "robot0_elbow", loss=0.5),
            effect("load_friction", "gripper0_right_elbow_wrist", ratio=0.2),
            effect("stribeck_friction", "robot0_elbow", static=2.0, speed=0.1),
            effect("viscous_damping", "robot0_shoulder", damping=1.0),
        ],
    )
    # In the library's order; Stribeck's friction has two numbers.
    np.testing.assert_array_equal(forces.friction.rows[:, 1:], [[1, 1], [2, 2]])
    np.testing.assert_array_equal(forces.friction.values, [[2.0, 0.1], [0.2, 0.0]])
    np.testing.assert_array_equal(forces.torque.rows[:, 1:], [[1, 1]])
    np.testing.assert_array_equal(forces.torque.values, [[0.5]])


def test_laws_by_hand() -> None:
    """A joint at 0.5 rad/s whose motor gives 4 N m, with 6 N m in its gear."""
    forces = step_forces(
        model(),
        [
            effect("drive_loss", "robot0_elbow", loss=0.5),
            effect("load_friction", "robot0_elbow", ratio=0.2),
            effect("stribeck_friction", "robot0_elbow", static=2.0, speed=0.5),
        ],
    )
    now = 0.1, 0.5, 4.0, 6.0
    assert law_value(forces.friction, 0, *now) == pytest.approx(2.0 * np.exp(-1.0))
    assert law_value(forces.friction, 1, *now) == pytest.approx(1.2)
    # 4 / (1 + 0.5 * 4) are left of 4.
    assert law_value(forces.torque, 0, *now) == pytest.approx(4.0 / 3.0 - 4.0)


def test_an_effect_that_only_a_domain_needs_is_not_searched() -> None:
    register(replace(EFFECTS["torque_bias"], name="stiff_fixture", candidate=False))
    try:
        assert library_effect("stiff_fixture")
        assert "stiff_fixture" not in [e.name for e in searched("positions")]
    finally:
        del EFFECTS["stiff_fixture"]


def test_what_an_effect_acts_on_follows_from_what_it_declares() -> None:
    found = {name: set(known.acts_on) for name, known in EFFECTS.items()}
    assert found["viscous_damping"] == {"model"}
    assert found["command_delay"] == found["random_delay"] == {"command"}
    assert found["backlash"] == {"goal"}
    assert found["joint_offset"] == {"reading"}
    assert found["drive_loss"] == {"step"}


def test_numbers_come_in_the_librarys_order() -> None:
    given = effect("payload", "robot0_lower", z=3.0, y=2.0, x=1.0, mass=0.5)
    assert checked(model(), given).values.tolist() == [0.5, 1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (effect("damping", "robot0_elbow", damping=1.0), "unknown effect 'damping'"),
        (effect("armature", "robot0_elbow"), "armature, given: none; give"),
        (effect("armature", "robot0_elbow", armature=np.inf), "armature is inf"),
        (effect("command_delay", None, delay=-0.02), "delay=-0.02 s .* give 0 or more"),
        (effect("control_rate", None, period=-0.1), "period=-0.1 s cannot be so small"),
        (
            effect("stribeck_friction", "robot0_elbow", static=1.0, speed=0.0),
            "speed=0 rad/s cannot be so small; give a number above 0",
        ),
        (effect("control_rate", None, period=1e300), "period=1e.300 s is beyond 60 s;"),
        (
            effect("armature", "robot0_elbow", armature=1e300),
            r"beyond \S+ kg m\^2; give",
        ),
        (
            effect("load_friction", "robot0_elbow", ratio=-0.1),
            "ratio=-0.1 cannot be so",
        ),
        (
            effect("encoder_scale", "robot0_elbow", factor=0.0),
            "factor=0 cannot be so small; give a number above 0",
        ),
        (
            effect(
                "link_parameters", "robot0_lower", **dict.fromkeys(LINK_NUMBERS, 50.0)
            ),
            "mass=50 is beyond 20; give a smaller number",
        ),
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


@pytest.mark.parametrize("factor", [0.0, -1.0, 1e300, np.nan, np.inf])
def test_a_factor_of_a_scene_is_above_0_and_a_number(factor: float) -> None:
    with pytest.raises(EffectError, match=r"factor is \S+; give a number above 0, of"):
        check_of_task(effect("scene_mass", None, factor=factor))
    check_of_task(effect("scene_mass", None, factor=1e3))


def test_an_effect_of_ones_own_may_be_given_beyond_what_is_searched() -> None:
    mine = replace(
        EFFECTS["torque_bias"],
        name="mine",
        parameters=lambda model, target: (
            Parameter("torque", "N m", -1.0, 1.0, 0.0, (0.1,)),
            Parameter("share", "", -1.0, 1.0, 0.0, (0.1,), most=5.0),
        ),
    )
    register(mine)
    try:
        given = effect("mine", "robot0_elbow", torque=-9e5, share=-5.0)
        assert checked(model(), given) == given
        with pytest.raises(
            EffectError, match=r"torque=2e\+06 N m is beyond 1e\+06 N m"
        ):
            checked(model(), effect("mine", "robot0_elbow", torque=2e6, share=0.0))
        with pytest.raises(EffectError, match="share=6 is beyond 5"):
            checked(model(), effect("mine", "robot0_elbow", torque=0.0, share=6.0))
    finally:
        del EFFECTS["mine"]


def test_a_model_may_have_less_friction_and_not_less_than_none() -> None:
    rubbing = model()
    rubbing.dof_frictionloss[0] = 0.5
    less, gone = (
        effect("coulomb_friction", "robot0_shoulder", frictionloss=size)
        for size in (-0.4, -0.6)
    )
    assert checked(rubbing, less) == less
    with pytest.raises(EffectError, match="less than none"):
        checked(rubbing, gone)


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


def test_a_target_that_is_there_and_cannot_be_acted_on_says_so() -> None:
    model = mujoco.MjModel.from_xml_string(ARM)
    payload = AppliedEffect(
        "payload", "world", {"mass": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}
    )
    with pytest.raises(EffectError, match="at other targets alone; it can act on "):
        checked(model, payload)
