"""The plant of the hidden cases, by hand and against the library's own effects."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import gap_cases
import mujoco
import numpy as np
import pytest
from gap_arms import Array, make_arm
from gap_baselines import hidden_of, left, read_case
from gap_motions import MOTIONS, commands
from gap_plant import Hidden, make_plant
from gap_recording import _arrivals, goals, record
from gap_sizes import IN_LIBRARY, draw, usual

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.logs.log import Log, Recording
from rlco.gap.model import load_model
from rlco.physics.effects import AppliedEffect

ARM3, SERVO = make_arm("arm3"), make_arm("servo")
SHORT = replace(MOTIONS["excite"], episodes=3, frames=150)
# Parts of an effect's own size by which the two may differ: rounded rotations of
# gravity, a filter's exact and its first-order step, forces of this step or the last.
TOLERANCE = {"gravity_tilt": 0.01, "actuator_lag": 0.05, "drive_loss": 0.07}


def nobody() -> np.random.Generator:
    return np.random.default_rng(0)


def one(name: str, target: str | None, **numbers: float) -> Hidden:
    return Hidden(name, target, numbers)


def sent(arm_seed: int = 3) -> Array:
    return commands(ARM3, SHORT, np.random.default_rng(arm_seed))


def test_a_plant_without_effects_is_plain_mujoco() -> None:
    rows = sent()
    model = mujoco.MjModel.from_xml_string(ARM3.xml)
    data = mujoco.MjData(model)
    data.qpos[:] = rows[0]
    expected = []
    for row in rows:
        expected.append(data.qpos.copy())
        data.ctrl[:] = row
        mujoco.mj_step(model, data, nstep=10)
    told = record(make_plant(ARM3.xml, ()), rows, 50, nobody()).position
    np.testing.assert_allclose(told, expected, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", IN_LIBRARY)
def test_plant_and_library_agree_on_each_effect(name: str, tmp_path: Path) -> None:
    # Two implementations of one physical definition, which share no code.
    rows = sent()
    plain = record(make_plant(ARM3.xml, ()), rows, 50, nobody())
    used = usual(ARM3, plain.torque, plain.velocity)
    changed = 0.0
    for seed in range(6):
        random = np.random.default_rng(seed)
        effect = draw(name, ARM3, used, 1.0, random)
        told = record(make_plant(ARM3.xml, (effect,)), rows, 50, random).position
        changed = float(np.sqrt(np.mean((told - plain.position) ** 2)))
        if changed > 2e-4:
            break
    (tmp_path / "model.xml").write_text(ARM3.xml)
    time = np.arange(len(rows)) / 50
    velocity = np.gradient(told, time, axis=0)
    velocity[0] = 0.0
    recording = Recording("0", time, told, velocity=velocity, command=rows)
    log = Log((recording,), ARM3.joints, ARM3.joints)
    problem = ArmRollouts(
        load_model(tmp_path / "model.xml").spec, log, np.ones(3), threads=1
    )
    applied = AppliedEffect(effect.name, effect.target, effect.parameters)
    apart = problem.residuals([Hypothesis((applied,))])[0]
    assert changed > 2e-4
    assert np.sqrt(np.mean(apart**2)) < TOLERANCE.get(name, 1e-3) * changed


def test_constant_torque_moves_a_servo_by_torque_over_stiffness() -> None:
    rows = np.full((200, 1), np.pi / 2)  # hanging: gravity's torque is zero
    plant = make_plant(SERVO.xml, [one("torque_bias", "joint1", torque=0.11)])
    place = record(plant, rows, 50, nobody()).position[-1, 0]
    # 0.11 N m against kp = 11 N m/rad and gravity's own 0.28 * 9.81 * 0.11 N m/rad.
    expected = np.pi / 2 + 0.11 / (11.0 + 0.28 * 9.81 * 0.11)
    assert place == pytest.approx(expected, abs=1e-5)


def test_payload_adds_its_mass_times_its_lever_arm() -> None:
    held = one("payload", "link1", mass=0.5, x=0.2, y=0.0, z=0.0)
    model = make_plant(SERVO.xml, [held]).model
    bare = make_plant(SERVO.xml, ()).model
    torques = []
    for each in (bare, model):
        data = mujoco.MjData(each)
        mujoco.mj_forward(each, data)
        torques.append(data.qfrc_bias[0])
    assert torques[1] - torques[0] == pytest.approx(-0.5 * 9.81 * 0.2)
    whole, data = np.zeros((1, 1)), mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, whole, data.qM)
    plain, start = np.zeros((1, 1)), mujoco.MjData(bare)
    mujoco.mj_forward(bare, start)
    mujoco.mj_fullM(bare, plain, start.qM)
    ball = 0.4 * 0.5 * 0.02**2
    assert whole[0, 0] - plain[0, 0] == pytest.approx(0.5 * 0.2**2 + ball)


def test_commands_on_their_way_by_hand() -> None:
    rows = np.array([[0.0], [1.0], [1.0], [0.0]])  # 50 Hz: ten steps each

    def way(name: str, target: str | None, **numbers: float) -> Array:
        plant = make_plant(SERVO.xml, [one(name, target, **numbers)])
        return goals(plant, rows, 50, nobody())[:, 0]

    late = way("command_delay", None, delay=0.006)
    assert [late[12], late[13]] == [0.0, 1.0]
    held = way("control_rate", None, period=0.03)
    # Read at 0, 30 and 60 ms: commands number 0, 1 and 3.
    assert [held[14], held[15], held[29], held[30]] == [0.0, 1.0, 1.0, 0.0]
    play = way("backlash", "joint1", width=0.2)
    assert [play[5], play[15], play[35]] == [0.0, 0.9, pytest.approx(0.1)]
    slow = way("velocity_limit", "joint1", limit=5.0)
    assert slow[10] == pytest.approx(0.01)
    assert slow[29] == pytest.approx(0.2)
    lag = way("actuator_lag", "joint1", time_constant=0.02)
    assert lag[19] == pytest.approx(1 - np.exp(-1.0))  # ten steps are 20 ms


def test_messages_that_arrive_late_at_random() -> None:
    late = one("random_delay", None, mean=0.02, spread=0.01)
    # So far apart that none waits for another.
    sent_at = 10.0 * np.arange(20_000)
    times = _arrivals(sent_at, late, nobody()) - sent_at
    assert times.min() > 0
    # The mean's standard error is 0.01 / sqrt(20000) = 7e-5, the other's about that.
    assert times.mean() == pytest.approx(0.02, abs=4e-4)
    assert times.std() == pytest.approx(0.01, abs=4e-4)
    # A gamma distribution's skewness is twice its spread over its mean.
    skewness = np.mean((times - times.mean()) ** 3) / times.std() ** 3
    assert skewness == pytest.approx(1.0, abs=0.15)


def test_a_message_waits_for_those_before_it() -> None:
    late = one("random_delay", None, mean=0.03, spread=0.03)
    sent_at = 0.005 * np.arange(500)
    arrived = _arrivals(sent_at, late, nobody())
    own = sent_at + nobody().gamma(1.0, 0.03, 500)
    # Some are overtaken, and wait for the latest of those before them.
    waits = arrived > own
    assert 0.2 < waits.mean() < 0.9
    assert (np.diff(arrived) >= 0).all()
    assert np.isin(arrived[waits], own).all()
    # One message carries all joints: their goals change at once.
    rows = np.linspace(0.0, 1.0, 500)[:, None] * np.array([1.0, 2.0, -3.0])
    goal = goals(make_plant(ARM3.xml, [late]), rows, 200, nobody())
    np.testing.assert_allclose(goal[:, 1:], goal[:, :1] * [2.0, -3.0], atol=1e-12)
    assert (np.diff(goal[:, 0]) >= -1e-12).all()


def test_a_spread_of_nearly_nothing_is_a_delay() -> None:
    rows = np.array([[0.0], [1.0], [1.0], [0.0]])
    late = one("random_delay", None, mean=0.006, spread=1e-6)
    goal = goals(make_plant(SERVO.xml, [late]), rows, 50, nobody())[:, 0]
    assert [goal[12], goal[13]] == [0.0, pytest.approx(1.0, abs=0.1)]


def test_encoder_offset_of_a_vertical_joint_cannot_be_seen() -> None:
    rows = sent()
    plain = record(make_plant(ARM3.xml, ()), rows, 50, nobody()).position
    for joint, least, most in (("joint1", 0.0, 1e-9), ("joint2", 2e-4, 1e-2)):
        plant = make_plant(ARM3.xml, [one("joint_offset", joint, offset=0.05)])
        apart = record(plant, rows, 50, nobody()).position - plain
        assert least <= np.sqrt(np.mean(apart**2)) <= most


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(MOTIONS, "excite", SHORT)


@pytest.mark.usefixtures("short")
def test_a_case_is_what_its_seed_says(tmp_path: Path) -> None:
    wanted = ("viscous_damping",)
    case = gap_cases.Case("x", "single", "servo", "excite", wanted, 1.0, 4)
    other = replace(case, seed=case.seed + 1)
    for folder, each in (("a", case), ("b", case), ("c", other)):
        gap_cases.make_case(each, tmp_path / folder)
    a, b, c = (read_case(tmp_path / folder).positions for folder in "abc")
    assert all((x == y).all() for x, y in zip(a, b, strict=True))
    assert not (a[0] == c[0]).all()


@pytest.mark.usefixtures("short")
def test_the_truth_leaves_nothing_but_noise(tmp_path: Path) -> None:
    wanted = ("coulomb_friction", "command_delay")
    case = gap_cases.Case("x", "pair", "servo", "excite", wanted, 1.0, 12)
    truth = gap_cases.make_case(case, tmp_path)
    logged = read_case(tmp_path)
    assert json.loads((tmp_path / "truth.json").read_text()) == truth
    assert left(logged, hidden_of(truth["effects"]), [2]) == pytest.approx(
        truth["noise"], rel=0.1
    )
    assert left(logged, (), [2]) > 5 * truth["noise"]


@pytest.mark.usefixtures("short")
def test_one_beside_one_outside_says_where_each_acts(tmp_path: Path) -> None:
    wanted = ("coulomb_friction", "slow_drift")
    for arm, together in (("servo", True), ("panda", False)):
        case = gap_cases.Case("x", "beside", arm, "excite", wanted, 1.0, 4)
        truth = gap_cases.make_case(case, tmp_path / arm)
        targets = [effect["target"] for effect in truth["effects"]]
        assert [e.get("outside", False) for e in truth["effects"]] == [False, True]
        assert truth["same_joint"] is (targets[0] == targets[1]) is together


def test_groups_added_later_leave_the_earlier_cases_as_they_were() -> None:
    # Finished results name them: their arms, effects and seeds must not change.
    rows = "\n".join(map(repr, gap_cases.plan(11000)[:299]))
    digest = "2ae607ea8f2b6bac665bba55458fd14c5b358b07929e98bb0659e7e26031eca2"
    assert hashlib.sha256(rows.encode()).hexdigest() == digest


def test_jitter_is_a_scatter_of_every_number() -> None:
    bare = make_plant(ARM3.xml, ()).model
    off = make_plant(ARM3.xml, (), jitter=0.03, seed=5).model
    fields = ("body_mass", "dof_damping", "dof_armature", "body_inertia")
    for field in fields:
        ratio = np.ravel(getattr(off, field))[-3:] / np.ravel(getattr(bare, field))[-3:]
        assert (ratio != 1).all()
        assert (np.abs(ratio - 1) < 0.15).all()
    # A servo's two stiffnesses stay one: no command, no pull.
    np.testing.assert_array_equal(
        off.actuator_gainprm[:, 0], -off.actuator_biasprm[:, 1]
    )
