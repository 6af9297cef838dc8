"""Effects in environments: the same in both backends, and gone without a trace."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from effect_cases import (
    EFFECTS,
    MANY,
    SERVO_ONLY,
    TASK,
    Array,
    Pair,
    effect,
    hold,
    in_the_air,
    play,
    rise,
    start_of,
)

from rlco.envs import make_env
from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.corrected_model import given_effects
from rlco.physics.effects.effects_file import write_effects
from rlco.physics.native.robosuite_batch import RobosuiteBatch
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.robosuite.effect_sim import CommandPath
from rlco.physics.robosuite.envs import RobosuiteEnvs
from rlco.physics.robosuite.tabletop import Tabletop
from rlco.physics.robosuite.tasks import make_plain
from rlco.physics.spec.domain import LOCKED, SIM, STAND_IN, Domain, with_effects

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", EFFECTS)
def test_both_backends_apply_an_effect_alike(name: str) -> None:
    pair = Pair([EFFECTS[name]], SIM)
    pair.start(3)
    rng = np.random.default_rng(3)
    apart = [pair.step(in_the_air(rng, step)) for step in range(12)]
    assert max(apart) <= 1e-9


@pytest.mark.parametrize("domain", [SIM, STAND_IN, LOCKED], ids=lambda d: d.name)
def test_both_backends_apply_many_effects_alike(domain: Domain) -> None:
    pair = Pair(MANY, domain)
    for seed in (1, 2):
        pair.start(seed)
        rng = np.random.default_rng(seed)
        apart = [pair.step(in_the_air(rng, step)) for step in range(12)]
        assert max(apart) <= 1e-9
        reported = self_reported(pair)
        np.testing.assert_allclose(reported[0], reported[1], atol=1e-8)


def self_reported(pair: Pair) -> tuple[Array, Array]:
    """What both backends say of tool and joints."""
    ours, theirs = pair.native.reported_state().at(0), pair.env.reported_state()
    both = [
        np.concatenate([s.tool_position, s.tool_rotation.ravel(), s.joint_position])
        for s in (ours, theirs)
    ]
    return both[0], both[1]


# -- Gone without a trace ------------------------------------------------------


def same_models(one: mujoco.MjModel, other: mujoco.MjModel) -> bool:
    buffers = []
    for model in (one, other):
        buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
        mujoco.mj_saveModel(model, None, buffer)
        buffers.append(buffer)
    return np.array_equal(*buffers)


def test_without_effects_the_model_is_what_it_was_to_the_last_bit() -> None:
    before = play(None, rise())
    other = play(MANY, rise())
    after = play([], rise())
    assert same_models(before.model, after.model)
    assert not same_models(before.model, other.model)
    np.testing.assert_array_equal(before.data[0].qpos, after.data[0].qpos)
    assert np.abs(before.data[0].qpos - other.data[0].qpos).max() > 1e-3


@pytest.mark.parametrize(
    "nothing",
    [
        effect("viscous_damping", "joint4", damping=0.0),
        effect("actuator_gain", "joint4", factor=1.0),
        effect("payload", "right_hand", mass=0.0, x=0.0, y=0.0, z=0.1),
        effect("encoder_scale", "joint4", factor=1.0),
        effect("command_delay", delay=0.0),
    ],
    ids=lambda e: e.name,
)
def test_an_effect_of_no_size_changes_nothing(nothing: AppliedEffect) -> None:
    plain, same = play(None, rise(4)), play([nothing], rise(4))
    assert same_models(plain.model, same.model)
    np.testing.assert_array_equal(plain.data[0].qpos, same.data[0].qpos)


def test_a_copy_keeps_its_friction_to_itself() -> None:
    effects = [EFFECTS["stribeck_friction"], EFFECTS["drive_loss"]]
    many = NativeStepper(TASK, SIM, num_envs=3, threads=2, effects=effects)
    many.reset([start_of(i) for i in range(3)])
    many.step(np.stack([rise(6), -rise(6), hold(6)]))
    for number, actions in enumerate((rise(6), -rise(6), hold(6))):
        alone = play(effects, actions, seed=number)
        np.testing.assert_array_equal(many.data[number].qpos, alone.data[0].qpos)
    # An episode does not remember the one before.
    many.reset([start_of(i) for i in range(3)])
    many.step(np.stack([rise(6), -rise(6), hold(6)]))
    np.testing.assert_array_equal(many.data[2].qpos, alone.data[0].qpos)


# -- Files, other tasks, and what cannot be ------------------------------------


def test_a_file_gives_what_its_list_gives(tmp_path: Path) -> None:
    path = tmp_path / "effects.yaml"
    renamed = effect("viscous_damping", "shoulder", damping=30.0)
    write_effects(path, [renamed], names={"shoulder": "robot0_joint2"})
    actions = rise(4)
    listed = play([EFFECTS["viscous_damping"]], actions)
    filed = play(str(path), actions)
    np.testing.assert_array_equal(listed.data[0].qpos, filed.data[0].qpos)


@pytest.mark.thorough
def test_robosuites_own_tasks_take_effects_in_both_backends() -> None:
    names = ("load_friction", "payload", "command_delay", "control_rate", "drive_loss")
    effects = given_effects([EFFECTS[name] for name in names])
    theirs = RobosuiteEnvs(lambda: make_plain("Lift", effects=effects), num_envs=1)
    batch = RobosuiteBatch(
        make_plain("Lift", effects=effects), num_envs=1, threads=1, exact=True
    )
    plain = RobosuiteBatch(make_plain("Lift"), num_envs=1, threads=1, exact=True)
    assert isinstance(theirs.envs[0].robots[0].control, CommandPath)
    for backend in (theirs, batch, plain):
        backend.reset([5])
    rng = np.random.default_rng(5)
    for step in range(10):
        action = in_the_air(rng, step)[None, None]
        for backend in (theirs, batch, plain):
            backend.step(action)
        apart = np.abs(theirs.data[0].qpos - batch.data[0].qpos).max()
        assert apart <= 1e-9
    assert np.abs(plain.data[0].qpos - batch.data[0].qpos).max() > 1e-3


def test_effects_are_refused_where_robosuite_steps_in_one_piece() -> None:
    effects = given_effects([EFFECTS["drive_loss"]])
    with pytest.raises(RlcoError, match="effects need lite_physics=True"):
        make_plain("Lift", lite_physics=False, effects=effects)


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ([effect("viscous_dampin", "joint1", damping=1.0)], "did you mean 'viscous_d"),
        ([effect("viscous_damping", "joint9", damping=1.0)], "unknown target of an ef"),
        ([effect("viscous_damping", "joint1", friction=1.0)], "parameters are damping"),
        ([effect("viscous_damping", "joint1", damping=np.nan)], "damping is nan"),
        ([effect("command_delay", "joint1", delay=0.1)], "acts on the whole robot"),
        ([effect("object_mass", "table", factor=2.0)], "it can act on red_cube_main"),
        ([SERVO_ONLY["velocity_limit"]], "'velocity_limit' at 'joint4' cannot be appl"),
        ([SERVO_ONLY["backlash"]], "its joints have no goals of their own"),
        ([SERVO_ONLY["joint_compliance"]], "its actuator is a motor"),
        ({"viscous_damping": 1.0}, "give the path of an effects.yaml, or a list"),
        (["viscous_damping"], "give the path of an effects.yaml, or a list"),
        ("no/effects.yaml", "'no/effects.yaml' is missing"),
        ([effect("armature", "joint1", armature=-1e6)], "model with -999995, less"),
        ([effect("viscous_damping", "joint1", damping=-99.0)], "less than none"),
    ],
)
@pytest.mark.parametrize("backend", ["native", "robosuite"])
def test_what_cannot_be_applied_is_refused_in_one_sentence(
    effects: Any, message: str, backend: Any
) -> None:
    with pytest.raises(RlcoError, match=message) as caught:
        make_env("push_cube", effects=effects, backend=backend)
    assert "\n" not in str(caught.value)


def test_robosuites_observations_tell_the_truth_so_encoders_may_not_err() -> None:
    with pytest.raises(RlcoError, match=r"joint_offset.*'robot0_joint4'.*true joints"):
        make_env("robosuite:Lift", effects=[EFFECTS["joint_offset"]])


def test_a_name_that_could_be_several_is_refused() -> None:
    given = given_effects([effect("coulomb_friction", "joint", frictionloss=1.0)])
    with pytest.raises(UnknownNameError, match="unknown target"):
        Tabletop(TASK, with_effects(SIM, given))
