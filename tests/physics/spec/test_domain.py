"""What each part of a Domain does, measured in the model or in its motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from domain_cases import reporting, scaled
from stepping_cases import starts

from rlco.physics.effects import AppliedEffect
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.robosuite.stepper import RobosuiteStepper
from rlco.physics.robosuite.tabletop import Tabletop
from rlco.physics.spec.domain import LOCKED, SIM, STAND_IN, Domain
from rlco.physics.spec.observation import noise_size, observe
from rlco.physics.spec.robot import PANDA
from rlco.physics.spec.task import Array, SceneState
from rlco.physics.tasks.plain_robosuite import make_robosuite
from rlco.physics.tasks.push_cube import TASK

ARM = tuple(f"robot0_joint{i}" for i in range(1, 8))


def model_of(domain: Domain) -> Any:
    return Tabletop(TASK, domain).sim.model._model


@pytest.fixture(scope="module")
def sim_model() -> Any:
    return model_of(SIM)


def test_sim_leaves_robosuites_gains_alone() -> None:
    arm = make_robosuite("push_cube").robots[0].part_controllers["right"]
    # robosuite's defaults: stiffness 150, critically damped, 5 cm and 0.5 rad a step.
    np.testing.assert_array_equal(arm.kp, 150.0)
    np.testing.assert_allclose(arm.kd, 2.0 * np.sqrt(150.0))
    np.testing.assert_array_equal(arm.output_max, [0.05] * 3 + [0.5] * 3)


def test_stiffness_is_scaled_and_its_damping_follows() -> None:
    arm = Tabletop(TASK, scaled(controller_stiffness=0.8)).robots[0]
    controller = arm.part_controllers["right"]
    np.testing.assert_allclose(controller.kp, 120.0)
    np.testing.assert_allclose(controller.kd, 2.0 * np.sqrt(120.0))


def test_friction_counts_between_cube_and_anything_it_touches(sim_model: Any) -> None:
    for model, expected in (
        (sim_model, 0.6),
        (model_of(scaled(scene_friction=0.5)), 0.3),
    ):
        for name in TASK.objects:
            geom = model.geom(f"{name}_g0")
            assert geom.friction[0] == pytest.approx(expected)
            # MuJoCo takes the friction of the geom with the higher priority.
            assert geom.priority[0] > model.geom("table_collision").priority[0]
        assert model.geom("table_collision").friction[0] == pytest.approx(expected)


def test_mass_is_scaled(sim_model: Any) -> None:
    heavy = model_of(scaled(scene_mass=1.4))
    for name in TASK.objects:
        assert sim_model.body(f"{name}_main").mass[0] == pytest.approx(0.06)
        assert heavy.body(f"{name}_main").mass[0] == pytest.approx(0.084)


def test_the_stand_ins_joints_have_more_friction_and_damping(sim_model: Any) -> None:
    rough = model_of(STAND_IN)
    for field, added in (("dof_frictionloss", 0.3), ("dof_damping", 0.5)):
        difference = getattr(rough, field) - getattr(sim_model, field)
        arm = [rough.joint(name).dofadr[0] for name in ARM]
        # Not in the gripper, nor, as no scene has one here, in a fixture.
        np.testing.assert_allclose(difference[arm], added, atol=1e-12)
        np.testing.assert_array_equal(np.delete(difference, arm), 0.0)


def test_locked_differs_from_the_stand_in_in_every_value_and_in_no_kind() -> None:
    pairs = zip(LOCKED.effects, STAND_IN.effects, strict=True)
    for locked, other in pairs:
        assert (locked.name, locked.target) == (other.name, other.target)
        assert locked.parameters.keys() == other.parameters.keys()
        for name, value in other.parameters.items():
            assert locked.parameters[name] != value
    for name, value in vars(STAND_IN.sensors).items():
        assert getattr(LOCKED.sensors, name) != value
    # Nor is it sim with the sign turned: some of the differences from sim are larger.
    assert abs(LOCKED.sensors.camera_yaw) > abs(STAND_IN.sensors.camera_yaw)
    assert LOCKED.stiffness_scale < STAND_IN.stiffness_scale < SIM.stiffness_scale


def test_the_values_of_locked_stay_as_they_were_fixed() -> None:
    # Tables refer to them; other values need another name.
    factors = (LOCKED.friction_scale, LOCKED.mass_scale, LOCKED.stiffness_scale)
    assert (*factors, LOCKED.fixture_friction_scale) == (1.3, 2.0, 0.7, 0.6)
    added = {e.name: e.parameters for e in LOCKED.model_effects}
    assert added == {
        "coulomb_friction": {"frictionloss": 0.5},
        "viscous_damping": {"damping": 0.8},
        "command_delay": {"delay": 0.1},
    }
    values = (-0.2, (-0.02, 0.03), 0.0045, 0.001, -0.004, -0.001)
    assert tuple(vars(LOCKED.sensors).values()) == values


@pytest.mark.slow
@pytest.mark.parametrize("backend", [NativeStepper, RobosuiteStepper])
@pytest.mark.parametrize("delay", [1, 3])
def test_a_delay_of_k_steps_shifts_the_response_by_exactly_k(
    backend: type[NativeStepper] | type[RobosuiteStepper], delay: int
) -> None:
    rng = np.random.default_rng(delay)
    delayed = AppliedEffect("command_delay", None, {"delay": 0.05 * delay})
    actions = rng.uniform(-1, 1, (1, 6, 7))
    # Until the first command arrives the robot holds its pose, by a zero command.
    shifted = np.concatenate([np.zeros((1, delay, 7)), actions], axis=1)
    late = backend(TASK, Domain("late", (delayed,)), num_envs=1)
    prompt = backend(TASK, SIM, num_envs=1)
    for stepper in (late, prompt):
        # Twice: what was pending in an earlier episode must not leak into this one.
        stepper.reset(starts(1))
        stepper.step(rng.uniform(-1, 1, (1, 2, 7)))
        stepper.reset(starts(1))
    padded = np.concatenate([actions, np.zeros((1, delay, 7))], axis=1)
    moved = late.step(padded).joint_position
    np.testing.assert_array_equal(moved, prompt.step(shifted).joint_position)


# -- What sensors and camera report --------------------------------------------


def scene() -> SceneState:
    """Return a scene with the tool and every object at simple places."""
    objects = np.array([[0.1, 0.0, 0.8], [0.0, 0.2, 0.8], [-0.1, 0.1, 0.8]])
    return SceneState(
        tool_position=PANDA.base + np.array([0.5, 0.1, -0.05]),
        tool_rotation=PANDA.down,
        gripper_opening=np.array(0.04),
        joint_position=np.zeros(7),
        object_position=objects,
        object_quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)),
        joint_opening=np.zeros(0),
        goal_quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)),
        goal_position=objects + np.array([0.15, 0.0, 0.0]),
        instruction_id=np.array(0),
    )


def quiet(domain: Domain) -> tuple[Array, Array]:
    return observe(TASK, domain, scene(), np.zeros(noise_size(TASK)))


def test_a_perfect_report_is_in_the_frame_of_the_robots_base() -> None:
    robot, environment = quiet(reporting())
    # Position from the base, no rotation when pointing straight down, the opening.
    np.testing.assert_allclose(robot, [0.5, 0.1, -0.05, 0, 0, 0, 0.04], atol=1e-12)
    # The base is at x = -0.56: the first cube at 0.1 is 0.66 ahead of it.
    np.testing.assert_allclose(
        environment,
        [0.66, 0.0, 0.56, 0.2, 0.46, 0.1, 0.81, 0.0, 0.71, 0.2, 0.61, 0.1],
    )


def test_the_base_is_where_robosuite_puts_it() -> None:
    env = make_robosuite("push_cube")
    base = env.sim.model._model.body("robot0_base").id
    np.testing.assert_allclose(env.sim.data.body_xpos[base], PANDA.base)


def test_reported_rotation_turns_with_the_tool() -> None:
    # Turned by 0.4 rad about the world's z.
    c, s = np.cos(0.4), np.sin(0.4)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    state = SceneState(**{**vars(scene()), "tool_rotation": turn @ PANDA.down})
    robot, _ = observe(TASK, reporting(), state, np.zeros(noise_size(TASK)))
    np.testing.assert_allclose(robot[3:6], [0.0, 0.0, 0.4], atol=1e-12)


def test_the_camera_frame_turns_about_the_tables_centre_then_shifts() -> None:
    domain = reporting(camera_yaw=np.pi / 2, camera_shift=(0.02, -0.01))
    _, environment = quiet(domain)
    # A quarter turn takes (x, y) to (-y, x); then the shift; then the base's frame.
    # Cubes (0.1, 0), (0, 0.2), (-0.1, 0.1) -> (0, 0.1), (-0.2, 0), (-0.1, -0.1).
    turned = np.array([[0.0, 0.1], [-0.2, 0.0], [-0.1, -0.1]])
    expected = turned + np.array([0.58, -0.01])
    np.testing.assert_allclose(environment[:6].reshape(3, 2), expected, atol=1e-12)


def test_offsets_of_tool_and_gripper() -> None:
    robot, _ = quiet(reporting(tool_offset=0.006, gripper_offset=0.0015))
    np.testing.assert_allclose(robot[:3], [0.5, 0.1, -0.044], atol=1e-12)
    assert robot[6] == pytest.approx(0.0415)


def test_noise_has_the_stated_size_and_touches_nothing_else() -> None:
    domain = reporting(object_noise=0.003, state_noise=0.0005)
    count = 4000
    state = scene().at(np.newaxis)
    many = SceneState(**{k: np.repeat(v, count, 0) for k, v in vars(state).items()})
    noise = np.random.default_rng(0).standard_normal((count, noise_size(TASK)))
    robot, environment = observe(TASK, domain, many, noise)
    # The deviation of 4000 numbers is known to 1 / sqrt(8000) = 1.1 %.
    np.testing.assert_allclose(robot[:, :3].std(0), 0.0005, rtol=0.05)
    np.testing.assert_array_equal(np.ptp(robot[:, 3:], axis=0), 0.0)
    np.testing.assert_allclose(environment.std(0), 0.003, rtol=0.05)
    # Every number has noise of its own.
    correlation = np.corrcoef(np.concatenate([robot[:, :3], environment], 1).T)
    assert np.abs(correlation - np.eye(15)).max() < 0.08


def test_observing_changes_no_scene() -> None:
    state = scene()
    before = {k: v.copy() for k, v in vars(state).items()}
    observe(TASK, STAND_IN, state, np.ones(noise_size(TASK)))
    for name, value in vars(state).items():
        np.testing.assert_array_equal(value, before[name])
