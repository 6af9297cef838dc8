"""Each effect of the library on a small arm: its names, neutral sizes and meaning."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.effects import EFFECTS, AppliedEffect, Effect, register
from rlco.physics.effects.apply import apply_to_spec, step_forces
from rlco.physics.effects.effect import Array
from rlco.physics.effects.step_forces import law_along

# Reports and files of others spell them so: they must not change.
_NAMES = {
    *("coulomb_friction", "viscous_damping", "stribeck_friction", "load_friction"),
    *("armature", "payload", "link_inertia", "actuator_gain", "actuator_lag"),
    *("torque_limit", "velocity_limit", "command_delay", "joint_offset"),
    *("encoder_scale", "joint_stiffness", "torque_bias", "backlash"),
    *("joint_compliance", "gravity_tilt", "control_rate", "drive_loss"),
    *("contact_friction", "contact_stiffness", "object_mass"),
    *("cogging", "hardening_spring"),
}
_ARM = """
<mujoco><compiler angle="radian"/><option timestep="0.002"/><worldbody>
<geom type="plane" size="1 1 .1"/>
<body name="block" pos="0 1 .5"><freejoint/><geom size=".05" mass="0.2"/></body>
<body name="link"><inertial pos="0.1 0 0" mass="0.5" diaginertia="1e-3 2e-3 2e-3"/>
<joint name="j" axis="0 1 0" damping="0.2" armature="0.01" stiffness="2"/>
<body name="hand" pos="0.3 0 0"><inertial pos="0.05 0 0" mass="0.1"
diaginertia="1e-4 1e-4 1e-4"/></body></body></worldbody>
<actuator><position name="j" joint="j" kp="30" kv="2"/></actuator></mujoco>
"""


def _spec() -> mujoco.MjSpec:
    return mujoco.MjSpec.from_string(_ARM)


def _values(effect: Effect, model: mujoco.MjModel, target: str | None) -> Array:
    return np.array([p.neutral for p in effect.parameters(model, target)])


def _changed(name: str, target: str | None, *values: float) -> mujoco.MjModel:
    spec = _spec()
    change = EFFECTS[name].on_spec
    assert change is not None
    change(spec, target, np.array(values))
    return spec.compile()


def test_the_names_are_those_that_reports_use() -> None:
    assert {effect.name for effect in EFFECTS.values() if effect.candidate} == _NAMES
    of_tasks = {"scene_friction", "scene_mass", "fixture_friction"}
    calibrated = {"link_parameters", "servo_damping", "torque_scale", "torque_offset"}
    given = {"controller_stiffness", "directional_friction", "random_delay"}
    assert set(EFFECTS) == _NAMES | of_tasks | calibrated | given


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(_NAMES))
def test_the_neutral_size_changes_neither_motion_nor_commands(name: str) -> None:
    effect, nominal = EFFECTS[name], _spec().compile()
    (target, *_) = effect.targets(nominal)
    values = _values(effect, nominal, target)
    names = [p.name for p in effect.parameters(nominal, target)]
    applied = AppliedEffect(name, target, dict(zip(names, values, strict=True)))
    spec = _spec()
    apply_to_spec(spec, [applied])
    model = spec.compile()
    commands = np.sin(np.arange(600.0) / 40)[:, None]
    sent = commands
    if effect.on_command is not None:
        sent = effect.on_command(commands, 0, 0.002, values)
    moving = np.array([0.3, -0.1]), np.array([0.5, -0.2]), np.ones(2), np.ones(2)
    for laws in step_forces(model, [applied]):
        for row in range(len(laws.rows)):
            assert not law_along(laws, row, *moving).any()
    # Commands of three units a second are below any limit of a servo's speed.
    np.testing.assert_allclose(sent, commands, atol=1e-15)
    ends = []
    for one in (nominal, model):
        data = mujoco.MjData(one)
        for command in commands:
            data.ctrl[:] = command
            mujoco.mj_step(one, data)
        ends.append(data.qpos.copy())
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-7)


@pytest.mark.parametrize("name", sorted(_NAMES))
def test_starts_lie_within_the_bounds_and_away_from_neutral(name: str) -> None:
    model = _spec().compile()
    for target in EFFECTS[name].targets(model):
        first = EFFECTS[name].parameters(model, target)[0]
        assert all(first.low <= start <= first.high for start in first.starts)
        assert all(start != first.neutral for start in first.starts)


def test_a_payload_may_lie_beyond_the_end_of_a_long_link() -> None:
    # A rod: inertia m l^2 / 12 about its middle; it ends where its length says.
    spec = mujoco.MjSpec.from_string("""<mujoco><worldbody><body name="rod">
    <joint axis="0 1 0"/><inertial pos="0.3 0 0" mass="2" diaginertia="1e-4 .06 .06"/>
    </body></worldbody></mujoco>""")
    mass, x, *_ = EFFECTS["payload"].parameters(spec.compile(), "rod")
    assert mass.low == 0.0
    assert (x.low, x.high) == pytest.approx((-0.7, 0.7))  # 0.6 m, and 10 cm more
    spec.body("rod").inertia, spec.body("rod").ipos = [1e-4] * 3, [0.02, 0, 0]
    _, x, *_ = EFFECTS["payload"].parameters(spec.compile(), "rod")
    assert x.high == 0.25


def test_a_payload_hangs_where_it_is_said_to() -> None:
    model = _changed("payload", "hand", 0.4, 0.1, 0.0, 0.05)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    # Hand: 0.1 kg at 0.35 m; payload: 0.4 kg at 0.3 + 0.1 m and 0.05 m up.
    hand = model.body("hand").id
    np.testing.assert_allclose(data.subtree_com[hand], [0.39, 0.0, 0.04])


def test_two_springs_at_a_joint_are_one() -> None:
    # 2 N m/rad at rest at 0 and 6 N m/rad at rest at 0.4: 8 at 0.3.
    model = _changed("joint_stiffness", "j", 6.0, 0.4)
    assert model.jnt_stiffness[model.joint("j").id] == pytest.approx(8.0)
    assert model.qpos_spring[model.joint("j").qposadr[0]] == pytest.approx(0.3)


def test_gravity_tilts_without_growing() -> None:
    gravity = _changed("gravity_tilt", None, 0.0, 0.3).opt.gravity
    np.testing.assert_allclose(gravity, 9.81 * np.array([np.sin(0.3), 0, -np.cos(0.3)]))


def test_play_a_slew_limit_and_a_slow_reader_by_hand() -> None:
    ramp = np.array([0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0])[:, None]

    def on_command(name: str, value: float) -> list[float]:
        change = EFFECTS[name].on_command
        assert change is not None
        return [float(x) for x in change(ramp, 0, 1.0, np.array([value]))[:, 0]]

    # Half of the play is used up on the way up, all of it after the reversal.
    assert on_command("backlash", 1.0) == [0.0, 0.5, 1.5, 2.5, 2.5, 1.5, 0.5]
    assert on_command("velocity_limit", 0.5) == [0.0, 0.5, 1.0, 1.5, 2.0, 1.5, 1.0]
    assert on_command("control_rate", 2.0) == [0.0, 0.0, 2.0, 2.0, 2.0, 2.0, 0.0]
    assert on_command("command_delay", 1.5) == [0.0, 0.0, 0.5, 1.5, 2.5, 2.5, 1.5]


@pytest.mark.parametrize("off", [-1e-15, 0.0, 1e-15])
def test_a_slow_reader_reads_no_step_early_for_a_rounded_period(off: float) -> None:
    """0.068 s are 34 steps of 2 ms, and 33.999... where it was added up."""
    change = EFFECTS["control_rate"].on_command
    assert change is not None
    frames = np.repeat(np.arange(40.0), 10)[:, None]  # a command each 10 steps
    read = change(frames, 0, 0.002, np.array([0.068 + 5 * off]))[:, 0]
    expected = [34 * (step // 34) // 10 for step in range(400)]
    np.testing.assert_array_equal(read, expected)


def test_a_name_that_is_not_there_is_told_with_those_that_are() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown joint 'k'.*known:.*j"):
        _changed("coulomb_friction", "k", 1.0)
    with pytest.raises(UnknownNameError, match="unknown body"):
        _changed("payload", "hnd", 1.0, 0.0, 0.0, 0.0)


def test_a_known_name_cannot_be_taken_again() -> None:
    with pytest.raises(RlcoError, match="'backlash' exists"):
        register(EFFECTS["backlash"])


def test_an_own_effect_that_no_search_could_begin_with_is_refused() -> None:
    own = replace(EFFECTS["cogging"], name="own_cogging")
    with pytest.raises(RlcoError, match="leave uncommon=True out, and give its"):
        register(own)
    assert "own_cogging" not in EFFECTS


def _along(applied: AppliedEffect, position: float, velocity: float) -> list[Array]:
    """Return the friction and the torque that an effect's laws give, a list of each."""
    where = [np.array([x]) for x in (position, velocity, 0.0, 0.0)]
    return [
        np.array([law_along(laws, row, *where)[0] for row in range(len(laws.rows))])
        for laws in step_forces(_spec().compile(), [applied])
    ]


def test_cogging_has_a_wave_and_one_of_half_its_length() -> None:
    values = {"amplitude": 2.0, "count": 10.0, "phase": 0.5}
    second = {"second_sine": 0.5, "second_cosine": -0.25}
    _, torque = _along(AppliedEffect("cogging", "j", values | second), 0.3, 0.0)
    # 2 sin(3.5) + 0.5 sin(7) - 0.25 cos(7)
    assert torque == pytest.approx([-0.7015665 + 0.3284933 - 0.1884756], abs=1e-6)


def test_a_hardening_spring_pulls_with_the_cube_of_the_angle() -> None:
    spring = AppliedEffect("hardening_spring", "j", {"hardening": 6.0, "rest": 0.2})
    assert _along(spring, 0.7, 0.0)[1] == pytest.approx([-6.0 * 0.125])
    assert _along(spring, -0.3, 0.0)[1] == pytest.approx([6.0 * 0.125])


@pytest.mark.parametrize(("velocity", "resists"), [(0.5, 5.0), (-0.5, 2.0)])
def test_friction_by_direction_resists_by_what_it_says(
    velocity: float, resists: float
) -> None:
    given = {"forward": 5.0, "backward": 2.0}
    own = AppliedEffect("directional_friction", "j", given)
    friction, torque = _along(own, 0.0, velocity)
    # Against the motion: the friction, less what pushes along with it.
    assert friction[0] - np.sign(velocity) * torque[0] == pytest.approx(resists)


@pytest.mark.parametrize(
    ("motor", "most"),
    [
        # 80 N m move the joint at a quarter of a radian a second against this.
        ('<motor joint="j" ctrlrange="-80 80"/>', 320.0),
        ('<motor joint="j" ctrlrange="-8 8" gear="-5"/>', 160.0),
        ('<position joint="j" kp="40" forcerange="-30 15" gear="2"/>', 240.0),
        # No limit of torque is stated, or one that matters less than what is there.
        ('<position joint="j" kp="40" ctrlrange="-80 80"/>', 20.0),
        ('<motor joint="j"/>', 20.0),
        ('<motor joint="j" ctrlrange="-1 1"/>', 20.0),
    ],
)
def test_damping_is_searched_up_to_what_holds_a_motor(motor: str, most: float) -> None:
    xml = f"""<mujoco><worldbody><body><joint name="j" axis="0 0 1" damping="0.1"/>
    <geom size=".1" mass="1"/></body></worldbody><actuator>{motor}</actuator></mujoco>
    """
    model = mujoco.MjModel.from_xml_string(xml)
    (damping,) = EFFECTS["viscous_damping"].parameters(model, "j")
    assert damping.high == pytest.approx(most)


def test_parameters_at_a_slide_have_the_units_of_one() -> None:
    xml = """<mujoco><worldbody><body name="cart"><joint name="{0}" type="{0}"
    damping="2"/><geom size=".1" mass="1"/></body></worldbody><actuator>
    <position name="a" joint="{0}" kp="40" kv="2" forcerange="-9 9"/></actuator>
    </mujoco>"""
    hinge, slide = (
        mujoco.MjModel.from_xml_string(xml.format(kind)) for kind in ("hinge", "slide")
    )
    units = {
        "coulomb_friction": ("N m", "N"),
        "viscous_damping": ("N m s/rad", "N s/m"),
        "armature": ("kg m^2", "kg"),
        "joint_offset": ("rad", "m"),
        "velocity_limit": ("rad/s", "m/s"),
        "torque_limit": ("N m", "N"),
        "joint_compliance": ("rad/(N m)", "m/N"),
        "backlash": ("rad", "m"),
    }
    for name, (turning, sliding) in units.items():
        assert EFFECTS[name].parameters(hinge, "hinge")[0].unit == turning
        assert EFFECTS[name].parameters(slide, "slide")[0].unit == sliding
    gain = EFFECTS["actuator_gain"].parameters(slide, "slide")[0].present
    assert gain is not None
    assert gain.unit == "N/m"
    # A body of that name is no slide.
    (mass, *place) = EFFECTS["payload"].parameters(slide, "cart")
    assert [one.unit for one in (mass, *place)] == ["kg", "m", "m", "m"]
