"""A domain's file wherever an environment is made, and effects of one's own in it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from effect_cases import EFFECTS, effect
from lerobot.envs.factory import make_env as make_lerobot_env
from lerobot_env_rlco import RlcoEnv
from tensordict import TensorDict

from rlco.envs import make_env
from rlco.errors import RlcoError
from rlco.evaluation import evaluation_env
from rlco.physics import effects
from rlco.physics.effects import AppliedEffect, load_code
from rlco.physics.effects.effects_file import write_effects
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.robosuite.stepper import RobosuiteStepper
from rlco.physics.spec.domain import Domain, write_domain
from rlco.physics.spec.sensors import Sensors
from rlco.physics.tasks.gymnasium_env import TaskEnv
from rlco.physics.tasks.named_task import check_domains
from rlco.physics.tasks.plain_robosuite import make_robosuite
from rlco.physics.tasks.push_cube import TASK

SLOW = (EFFECTS["viscous_damping"], EFFECTS["joint_offset"])
LOW = Sensors(object_noise=0.0, tool_offset=0.02)
CODE = """
import numpy as np
from rlco.physics.effects import Effect, Parameter, register

def stiffen(spec, target, values):
    spec.joint(target).stiffness = values[0] * np.eye(3)[0]

register(Effect(
    name="rubber_joint", summary="", signature="", confused_with=(),
    targets=lambda model: tuple(model.joint(i).name for i in range(model.njnt)),
    parameters=lambda model, target: (Parameter("size", "", 0, 9, 0, (1,)),),
    on_spec=stiffen,
))
"""


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """Return the file of a domain with effects and sensors."""
    path = tmp_path / "robot.yaml"
    write_domain(path, Domain("robot", SLOW, LOW))
    return path


@pytest.fixture
def code(tmp_path: Path) -> Iterator[Path]:
    """Return a file that registers an effect, which is forgotten at the end."""
    path = tmp_path / "rubber.py"
    path.write_text(CODE)
    yield path
    effects.EFFECTS.pop("rubber_joint", None)


def rubber(tmp_path: Path) -> Path:
    """Return a domain's file with the effect of one's own, once it is registered."""
    path = tmp_path / "rubbery.yaml"
    write_effects(path, [AppliedEffect("rubber_joint", "joint4", {"size": 20.0})])
    return path


def reported(**options: Any) -> np.ndarray:
    """Return the robot's states over some decisions, with the same commands for all."""
    env = make_env("push_cube", chunk=2, seed=4, **options)
    commands = np.random.default_rng(0).uniform(-0.3, 0.3, (5, 1, 2, 7))
    rows = [env.reset()["observation", "state"].numpy()]
    for command in commands:
        given = env.action_spec.encode(torch.from_numpy(command))
        td = env.step(TensorDict({"action": given}, [1]))
        rows.append(td["next", "observation", "state"].numpy())
    return np.stack(rows)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["native", "robosuite"])
def test_make_env_in_a_file_is_sim_with_its_effects(
    tmp_path: Path, backend: Any
) -> None:
    path = tmp_path / "effects.yaml"
    write_effects(path, SLOW)
    found = reported(domain=str(path), backend=backend)
    listed = reported(effects=list(SLOW), backend=backend)
    np.testing.assert_array_equal(found, listed)
    assert np.abs(found - reported(backend=backend)).max() > 1e-2


def test_effects_are_added_to_what_the_file_has(robot: Path) -> None:
    env = make_env(
        "push_cube", domain=robot, effects=[effect("command_delay", delay=0.1)]
    )
    names = [one.name for one in env.domain.effects]
    assert names == ["viscous_damping", "joint_offset", "command_delay"]
    assert env.domain.sensors == LOW
    assert env.stepper.worlds.control.acting.whole == 2


def test_both_steppers_take_a_path(robot: Path) -> None:
    for kind in (NativeStepper, RobosuiteStepper):
        stepper = kind(TASK, robot, num_envs=1)
        assert stepper.domain == Domain("robot", SLOW, LOW)
        joint = stepper.model.joint("robot0_joint2").dofadr[0]
        assert stepper.model.dof_damping[joint] > 29.0


def test_robosuites_plain_environment_takes_a_path(robot: Path) -> None:
    env = make_robosuite("push_cube", domain=robot)
    told, true = env.reported_state(), env.scene_state()
    assert told.joint_position[3] - true.joint_position[3] == pytest.approx(0.05)


def test_gymnasium_reports_what_make_env_reports(robot: Path) -> None:
    env = gymnasium.make("rlco/PushCube-v0", domain=str(robot))
    seen, _ = env.reset(seed=7)
    ours = make_env("push_cube", domain=robot, seed=7)
    first = ours.reset()
    np.testing.assert_array_equal(
        seen["agent_pos"], first["observation", "state"][0].numpy()
    )
    seen, *_ = env.step(np.zeros(7, np.float32))
    after = ours.step(first.set("action", ours.action_spec.zero()))
    np.testing.assert_array_equal(
        seen["agent_pos"], after["next", "observation", "state"][0].numpy()
    )


def test_lerobots_environment_takes_a_path_and_own_effects(
    tmp_path: Path, code: Path
) -> None:
    path = rubber(tmp_path)
    config = RlcoEnv(horizon=3, domain=str(path), effects_code=str(code))
    (copies,) = make_lerobot_env(config, n_envs=1)["rlco"].values()
    stepper = copies.envs[0].unwrapped.stepper
    joint = stepper.model.joint("robot0_joint4").id
    assert stepper.model.jnt_stiffness[joint] == 20.0
    copies.close()
    with pytest.raises(RlcoError, match="is missing"):
        RlcoEnv(domain="nowhere.yaml")


def test_an_evaluations_environment_takes_a_path(robot: Path) -> None:
    env = evaluation_env("push_cube", robot, chunk=4, episodes=2)
    assert env.domain.name == "robot"


@pytest.mark.slow
@pytest.mark.parametrize("make", [make_env, make_robosuite, TaskEnv])
def test_effects_of_ones_own_come_with_their_code(
    tmp_path: Path, code: Path, make: Any
) -> None:
    path = rubber(tmp_path)
    with pytest.raises(RlcoError, match="unknown effect 'rubber_joint'"):
        make("push_cube", domain=path)
    make("push_cube", domain=path, effects_code=code)
    make("push_cube", domain=path, effects_code=str(code))  # a second time


def test_code_is_run_again_where_its_effects_are_gone(code: Path) -> None:
    load_code(code)
    load_code(code)
    del effects.EFFECTS["rubber_joint"]
    load_code(code)
    assert "rubber_joint" in effects.EFFECTS
    load_code(None)


def test_code_that_is_none_is_refused(tmp_path: Path) -> None:
    empty = tmp_path / "empty.py"
    empty.write_text("")
    for path, message in (
        (tmp_path / "no.py", "is not a file"),
        (empty, "registers no"),
    ):
        with pytest.raises(RlcoError, match=message):
            load_code(path)


def test_robosuites_own_tasks_take_a_file_of_effects_alone(
    tmp_path: Path, robot: Path
) -> None:
    path = tmp_path / "effects.yaml"
    write_effects(path, [EFFECTS["viscous_damping"]])
    env = make_env("robosuite:Lift", domain=path)
    joint = env.backend.model.joint("robot0_joint2").dofadr[0]
    assert env.backend.model.dof_damping[joint] > 29.0
    for domain in ("stand_in", robot):
        with pytest.raises(RlcoError, match="is not supported for 'robosuite:Lift'"):
            make_env("robosuite:Lift", domain=domain)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["native", "robosuite"])
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            effect("coulomb_friction", "joint9", frictionloss=1.0),
            "unknown target of an",
        ),
        (effect("viscous_damping", "joint1", friction=1.0), "parameters are damping"),
        (effect("backlash", "joint4", width=0.02), "its joints have no goals"),
        (effect("scene_mass", factor=-1.0), "give a number above 0"),
    ],
)
def test_what_a_task_cannot_have_is_refused_in_one_sentence(
    tmp_path: Path, backend: Any, wrong: AppliedEffect, message: str
) -> None:
    path = tmp_path / "effects.yaml"
    write_effects(path, [wrong])
    for run in (
        lambda: make_env("push_cube", domain=path, backend=backend),
        lambda: TaskEnv("push_cube", domain=path, backend=backend),
        lambda: check_domains("push_cube", ["sim", str(path)]),
    ):
        with pytest.raises(RlcoError, match=message) as caught:
            run()
        assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_domains_are_checked_by_name_and_file(tmp_path: Path, robot: Path) -> None:
    found = check_domains("push_cube", ["stand_in", str(robot)])
    assert [domain.name for domain in found] == ["stand_in", "robot"]
    other = tmp_path / "other"
    other.mkdir()
    write_effects(other / "robot.yaml", SLOW)
    with pytest.raises(RlcoError, match="would be filed under 'robot'"):
        check_domains("push_cube", [robot, other / "robot.yaml"])
    with pytest.raises(RlcoError, match="domain='robot' is not supported for"):
        check_domains("robosuite:Lift", [robot])
    write_effects(other / "shifted.yaml", [EFFECTS["joint_offset"]])
    with pytest.raises(RlcoError, match="true joints"):
        check_domains("robosuite:Lift", [other / "shifted.yaml"])
