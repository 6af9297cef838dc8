"""Episodes that draw a parameter set each, in both backends."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from effect_cases import EFFECTS, MANY, TASK, effect, in_the_air, start_of
from tensordict import TensorDict

from rlco.envs import make_env
from rlco.errors import RlcoError
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.robosuite.tabletop import Tabletop
from rlco.physics.spec.domain import Domain, write_domain
from rlco.physics.spec.sample import Sample
from rlco.physics.spec.sensors import Sensors

# Every kind of change: a law's friction, encoders, commands, motors, a body, gravity.
SETS = Sample(
    (
        (0, "static"),
        (1, "mass"),
        (1, "z"),
        (2, "offset"),
        (3, "delay"),
        (4, "period"),
        (5, "time_constant"),
        (6, "loss"),
        (7, "pitch"),
        (8, "damping"),
        (9, "frictionloss"),
    ),
    (
        (9.0, 1.5, 0.1, 0.05, 0.13, 0.12, 0.02, 0.01, 0.15, 30.0, 6.0),
        (4.0, 0.8, 0.05, -0.04, 0.05, 0.07, 0.04, 0.02, -0.1, 3.0, 1.0),
        (1.0, 2.5, 0.2, 0.02, 0.27, 0.2, 0.01, 0.005, 0.05, 9.0, 0.0),
    ),
)
ALL = (
    *MANY,
    EFFECTS["gravity_tilt"],
    EFFECTS["viscous_damping"],
    EFFECTS["coulomb_friction"],
)
DRAWN = Domain("drawn", ALL, sample=SETS)


def alone(row: int) -> Domain:
    """Return the domain that has one parameter set in every episode."""
    return Domain("alone", SETS.drawn(row, ALL))


def commands(seed: int, steps: int = 8) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.stack([in_the_air(rng, step) for step in range(steps)])


def played(stepper: NativeStepper, rows: list[int] | None, seed: int) -> np.ndarray:
    """Return the states after each step of an episode in each world, (N, T, nq)."""
    count = stepper.num_envs
    starts = [start_of(seed + number) for number in range(count)]
    stepper.reset(starts, drawn=rows)
    actions = np.stack([commands(seed + number) for number in range(count)])
    stepper.step(actions)
    return np.stack([data.qpos.copy() for data in stepper.data])


@pytest.mark.slow
def test_each_world_is_that_of_its_own_parameter_set() -> None:
    drawn = [
        NativeStepper(TASK, DRAWN, num_envs=3, threads=threads) for threads in (1, 2)
    ]
    # The same rows in another order, so that no world keeps what it had before.
    single = {
        row: NativeStepper(TASK, alone(row), num_envs=3, threads=1) for row in (0, 1)
    }
    for seed, rows in ((1, [2, 0, 1]), (4, [1, 1, 0]), (7, [0, 1, 2])):
        one, two = (played(stepper, rows, seed) for stepper in drawn)
        np.testing.assert_array_equal(one, two)
        reported = drawn[0].reported_state().joint_position
        for row, stepper in single.items():
            wanted = played(stepper, None, seed)
            seen = stepper.reported_state().joint_position
            for number in np.flatnonzero(np.array(rows) == row):
                np.testing.assert_array_equal(one[number], wanted[number])
                np.testing.assert_array_equal(reported[number], seen[number])


@pytest.mark.slow
def test_robosuite_draws_what_the_native_stepper_draws() -> None:
    env = Tabletop(TASK, DRAWN)
    native = NativeStepper(TASK, DRAWN, num_envs=1, threads=1, exact=True)
    for seed, row in ((1, 2), (2, 0), (3, 1), (4, 2)):
        env.start(start_of(seed), row)
        native.reset([start_of(seed)], drawn=[row])
        for action in commands(seed):
            env.step(action)
            native.step(action[None, None])
        apart = env.sim.data._data.qpos - native.data[0].qpos
        assert np.abs(apart).max() <= 1e-9


def rollout(**options: Any) -> np.ndarray:
    """Return the states of two episodes in each of three environments."""
    env = make_env("push_cube", num_envs=3, chunk=4, seed=5, horizon=12, **options)
    rows = []
    for _ in range(2):
        rows.append(env.reset()["observation", "state"].numpy())
        for seed in range(3):
            action = torch.from_numpy(commands(seed, 4)).float().expand(3, -1, -1)
            td = env.step(TensorDict({"action": action}, [3]))
            rows.append(td["next", "observation", "state"].numpy())
    return np.stack(rows)


@pytest.mark.slow
def test_an_environment_draws_from_its_file_by_its_seed(tmp_path: Path) -> None:
    path = tmp_path / "found.yaml"
    write_domain(path, DRAWN)
    one = rollout(domain=path, sample="posterior", threads=1)
    two = rollout(domain=path, sample="posterior", threads=2)
    np.testing.assert_array_equal(one, two)
    # Without the option an episode has the effects' own numbers, sample or not.
    plain = rollout(domain=path)
    write_domain(path, replace(DRAWN, sample=None))
    np.testing.assert_array_equal(plain, rollout(domain=path))
    assert np.abs(one - plain).max() > 1e-2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("backend", "look"), [("native", "random"), ("robosuite", "stand_in")]
)
def test_what_an_episode_draws_changes_nothing_that_is_seen(
    backend: Any, look: str
) -> None:
    # One set, the effects' own numbers: images are those of no draw, to the last bit.
    domain = Domain(
        "moved",
        (effect("viscous_damping", "joint2", damping=1.0),),
        Sensors(camera_yaw=0.2),
        sample=Sample(((0, "damping"),), ((1.0,),)),
    )
    seen = []
    for sample in (None, "posterior"):
        env = make_env(
            "push_cube",
            domain=domain,
            sample=sample,
            look=look,
            backend=backend,
            image_size=(24, 24),
            renderer="raster",
            seed=3,
        )
        images = [env.reset()["observation", "image"] for _ in range(2)]
        seen.append(torch.stack(images))
    assert torch.equal(*seen)


@pytest.mark.slow
def test_robosuites_own_tasks_draw_alike_in_both_backends() -> None:
    effects = (EFFECTS["payload"], EFFECTS["command_delay"], EFFECTS["load_friction"])
    sets = ((1.5, 0.13, 0.1), (0.2, 0.03, 0.3), (0.8, 0.2, 0.0))
    sample = Sample(((0, "mass"), (1, "delay"), (2, "ratio")), sets)
    found = []
    for own in ({"backend": "robosuite"}, {"exact": True}):
        env = make_env(
            "robosuite:Lift",
            domain=Domain("d", effects, sample=sample),
            sample="posterior",
            num_envs=2,
            chunk=4,
            seed=1,
            **own,
        )
        drawn = [env.parameter_set(index) for index in range(4)]
        assert drawn[0] != drawn[1]
        for _ in range(2):
            env.reset()
            action = torch.from_numpy(commands(0, 4)).float().expand(2, -1, -1)
            td = env.step(TensorDict({"action": action}, [2]))
            found.append(td["next", "observation", "state"].numpy())
    np.testing.assert_allclose(found[0], found[2], atol=1e-6)
    np.testing.assert_allclose(found[1], found[3], atol=1e-6)
    assert np.abs(found[0][0] - found[0][1]).max() > 1e-3


def test_episodes_draw_independently_of_how_many_worlds_there_are() -> None:
    light = Domain(
        "light",
        (effect("viscous_damping", "joint2", damping=1.0),),
        sample=Sample(((0, "damping"),), tuple((float(k),) for k in range(8))),
    )
    env = make_env("push_cube", domain=light, sample="posterior", num_envs=2, seed=3)
    few = [env.parameter_set(index) for index in range(64)]
    assert set(few) == set(range(8))
    env.reset()
    joint = env.stepper.model.joint("robot0_joint2").dofadr[0]
    plain = make_env("push_cube").stepper.model.dof_damping[joint]
    for number in range(2):
        damping = env.stepper.model_of(number).dof_damping[joint]
        assert damping == plain + few[number]


def test_an_episodes_look_says_nothing_of_its_parameter_set() -> None:
    light = Domain(
        "light",
        (effect("viscous_damping", "joint2", damping=1.0),),
        sample=Sample(((0, "damping"),), tuple((float(k),) for k in range(8))),
    )
    env = make_env(
        "push_cube",
        domain=light,
        sample="posterior",
        look="random",
        image_size=(16, 16),
        renderer="raster",
        num_envs=64,
        seed=3,
    )
    env.reset()
    floor = env.stepper.model.material("floorplane").id
    models = map(env.stepper.model_of, range(64))
    textures = [tuple(model.mat_texid[floor]) for model in models]
    assert len(set(textures)) == 4
    # 64 independent pairs of 8 sets and 4 textures: about 28 of the 32 are there.
    drawn = [env.parameter_set(index) for index in range(64)]
    assert len(set(zip(drawn, textures, strict=True))) > 20


def test_worlds_that_draw_are_not_randomised_besides() -> None:
    stepper = NativeStepper(TASK, DRAWN, num_envs=1, threads=1)
    with pytest.raises(RlcoError, match="cannot be randomised besides"):
        stepper.randomise([0], {"body_mass": stepper.model.body_mass})


def test_a_domain_without_a_sample_has_nothing_to_draw_from() -> None:
    with pytest.raises(RlcoError, match="domain 'stand_in' has none"):
        make_env("push_cube", domain="stand_in", sample="posterior")


def test_a_set_that_an_effect_cannot_have_is_refused_at_once() -> None:
    sample = Sample(((0, "mass"),), ((1.0,), (float("nan"),)))
    with pytest.raises(RlcoError, match="mass is nan"):
        NativeStepper(
            TASK, Domain("d", (EFFECTS["payload"],), sample=sample), num_envs=1
        )
