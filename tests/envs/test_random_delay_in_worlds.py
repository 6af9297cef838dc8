"""Commands that arrive late at random, in environments and in both backends."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from effect_cases import (
    EFFECTS,
    TASK,
    Array,
    Pair,
    effect,
    height,
    hold,
    in_the_air,
    rise,
    start_of,
)
from tensordict import TensorDict

from rlco.envs import make_env
from rlco.errors import RlcoError
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.command import drawn_delay
from rlco.physics.effects.corrected_model import given_effects
from rlco.physics.native.robosuite_batch import RobosuiteBatch
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.robosuite.envs import RobosuiteEnvs
from rlco.physics.robosuite.global_random import seed_all
from rlco.physics.robosuite.tabletop import Tabletop
from rlco.physics.robosuite.tasks import make_plain
from rlco.physics.spec.domain import SIM, Domain, with_effects, write_domain
from rlco.physics.spec.sample import Sample

LATE = effect("random_delay", mean=0.08, spread=0.04)
SUBSTEPS = 25  # physics steps of 2 ms in a control step of 50 ms


def commands(seed: int, steps: int = 12) -> Array:
    rng = np.random.default_rng(seed)
    return np.stack([in_the_air(rng, step) for step in range(steps)])


def stepper_of(effects: list[AppliedEffect], **options: Any) -> NativeStepper:
    options = {"num_envs": 1, "threads": 1, **options}
    return NativeStepper(TASK, SIM, effects=effects, **options)


def played(stepper: NativeStepper, seed: int, actions: Array | None = None) -> Array:
    """Return the last positions of an episode with this seed of its delays, (nq,)."""
    stepper.reset([replace(start_of(3), seed=seed)])
    stepper.step((commands(3) if actions is None else actions)[None])
    qpos: Array = stepper.data[0].qpos.copy()
    return qpos


# -- Against a fixed delay ----------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("delay", "period"), [(0.13, 0.0), (0.1, 0.12), (0.004, 0.03), (0.13, 0.12)]
)
def test_without_spread_it_is_a_fixed_delay_to_the_last_bit(
    delay: float, period: float
) -> None:
    read = [effect("control_rate", period=period)]
    fixed, same, drawn = (
        played(stepper_of([*read, late]), seed=5)
        for late in (
            effect("command_delay", delay=delay),
            effect("random_delay", mean=delay, spread=0.0),
            # All delays round to the same step, and go through the queue.
            effect("random_delay", mean=delay, spread=1e-7),
        )
    )
    np.testing.assert_array_equal(fixed, same)
    np.testing.assert_array_equal(fixed, drawn)


@pytest.mark.slow
def test_robosuite_too_has_a_fixed_delay_without_spread() -> None:
    found = []
    for late in (
        effect("command_delay", delay=0.13),
        effect("random_delay", mean=0.13, spread=0.0),
        effect("random_delay", mean=0.13, spread=1e-7),
    ):
        env = Tabletop(TASK, with_effects(SIM, [EFFECTS["control_rate"], late]))
        env.start(start_of(3))
        for action in commands(3):
            env.step(action)
        found.append(env.sim.data._data.qpos.copy())
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])


# -- When commands arrive -----------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_moves_before_the_first_command_arrives(seed: int) -> None:
    stepper = stepper_of([LATE])
    acting = stepper.worlds.control.acting
    # Zeros were sent before the first command, which may not overtake them.
    due = max(
        number * SUBSTEPS + drawn_delay(acting.random, seed, number)
        for number in range(-acting.room, 1)
    )
    unmoved = due // SUBSTEPS  # control steps

    def risen(steps: int) -> float:
        moved = played(stepper, seed, rise(steps)), height(stepper)
        still = played(stepper, seed, hold(steps)), height(stepper)
        assert (moved[1] == still[1]) == np.array_equal(moved[0], still[0])
        return moved[1] - still[1]

    assert unmoved == 0 or risen(unmoved) == 0.0
    assert risen(unmoved + 1) > 0.0


@pytest.mark.slow
def test_the_seed_and_nothing_else_draws_the_delays() -> None:
    stepper = stepper_of([LATE])
    first, other, again = (played(stepper, seed) for seed in (1, 2, 1))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-4
    one, two = (stepper_of([LATE], num_envs=5, threads=threads) for threads in (1, 2))
    for many in (one, two):
        many.reset([replace(start_of(3), seed=seed) for seed in range(5)])
        many.step(np.stack([commands(3)] * 5))
    for number in range(5):
        qpos = one.data[number].qpos
        np.testing.assert_array_equal(qpos, two.data[number].qpos)
    np.testing.assert_array_equal(one.data[1].qpos, first)


@pytest.mark.slow
def test_worlds_with_longer_delays_leave_commands_of_others_on_their_way() -> None:
    rows = ((0.05, 0.02), (0.3, 0.2), (0.02, 0.0))
    own = effect("random_delay", mean=0.05, spread=0.02)
    sample = Sample(((0, "mean"), (0, "spread")), rows)
    stepper = NativeStepper(
        TASK, Domain("drawn", (own,), sample=sample), num_envs=3, threads=1
    )
    starts = [replace(start_of(3), seed=seed) for seed in range(3)]
    stepper.reset(starts, drawn=[0, 0, 2])
    # The second world starts again, with room for more commands, amid the others.
    stepper.step(np.stack([commands(3)[:4]] * 3))
    stepper.reset(starts[1:2], np.array([1]), drawn=[1])
    stepper.step(np.stack([commands(3)[4:]] * 3))
    found = [data.qpos.copy() for data in stepper.data]
    for number, row in ((0, 0), (2, 2)):
        late = effect("random_delay", mean=rows[row][0], spread=rows[row][1])
        np.testing.assert_array_equal(found[number], played(stepper_of([late]), number))
    late = effect("random_delay", mean=0.3, spread=0.2)
    alone = played(stepper_of([late]), 1, commands(3)[4:])
    np.testing.assert_array_equal(found[1], alone)


# -- Both backends ------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("more", [(), (EFFECTS["control_rate"],)], ids=["", "rate"])
def test_both_backends_draw_the_same_delays(more: tuple[AppliedEffect, ...]) -> None:
    pair = Pair([LATE, effect("command_delay", delay=0.03), *more], SIM)
    for seed in (11, 12):
        start = replace(start_of(seed), seed=seed)
        pair.env.start(start)
        pair.native.reset([start])
        apart = [pair.step(action) for action in commands(seed, 20)]
        assert max(apart) <= 1e-9


def rollout(task: str, domain: Any = LATE, **options: Any) -> Array:
    """Return the states of two episodes in each of two environments."""
    effects = {"effects": [domain]} if isinstance(domain, AppliedEffect) else {}
    effects = effects or {"domain": domain, "sample": "posterior"}
    options = {"num_envs": 2, "chunk": 4, "seed": 1, **effects, **options}
    env = make_env(task, **options)
    rows = []
    for _ in range(2):
        env.reset()
        action = torch.from_numpy(commands(0, 4)).float().expand(2, -1, -1)
        td = env.step(TensorDict({"action": action}, [2]))
        rows.append(td["next", "observation", "state"].numpy())
    return np.stack(rows)


@pytest.mark.slow
@pytest.mark.parametrize("task", ["push_cube", "robosuite:Lift"])
def test_an_environments_seed_draws_the_delays_in_both_backends(task: str) -> None:
    native = rollout(task, exact=True, threads=1)
    np.testing.assert_allclose(native, rollout(task, backend="robosuite"), atol=1e-6)
    np.testing.assert_array_equal(native, rollout(task, exact=True, threads=2))
    without_spread = effect("random_delay", mean=0.08, spread=0.0)
    same = rollout(task, without_spread, exact=True, threads=1)
    assert np.abs(native - same).max() > 1e-4


@pytest.mark.slow
def test_an_episode_may_draw_the_spread_of_its_delays(tmp_path: Path) -> None:
    path = tmp_path / "found.yaml"
    sample = Sample(((0, "spread"),), ((0.0,), (0.02,), (0.06,)))
    write_domain(path, Domain("late", (LATE,), sample=sample))
    native = rollout("push_cube", path, exact=True)
    theirs = rollout("push_cube", path, backend="robosuite")
    np.testing.assert_allclose(native, theirs, atol=1e-6)


@pytest.mark.slow
def test_robosuites_reset_draws_its_delays_from_numpys_seed() -> None:
    effects = given_effects([LATE])
    theirs = RobosuiteEnvs(lambda: make_plain("Lift", effects=effects), num_envs=1)
    batch = RobosuiteBatch(
        make_plain("Lift", effects=effects), num_envs=1, threads=1, exact=True
    )
    plain = RobosuiteBatch(make_plain("Lift"), num_envs=1, threads=1, exact=True)
    seeds = []
    for seed in (5, 6):
        starts = [one.reset([seed])["robot0_joint_pos"] for one in (batch, plain)]
        # Where an episode starts does not depend on whether it has delays to draw.
        np.testing.assert_array_equal(*starts)
        theirs.reset([seed])
        seeds.append(int(batch.worlds.memory.seed[0]))
        for action in commands(seed):
            for backend in (theirs, batch):
                backend.step(action[None, None])
        assert np.abs(theirs.data[0].qpos - batch.data[0].qpos).max() <= 1e-9
    assert seeds[0] != seeds[1]
    # An environment that is stepped without rlco's batches has the same ones.
    env = theirs.envs[0]
    seed_all(6)
    env.reset()
    assert env.sim.seed == seeds[1]


# -- Seeds of episodes, and what cannot be ------------------------------------------


def test_an_initial_state_has_a_seed_that_shifts_no_other_draw() -> None:
    plain, seeded = np.random.default_rng([4, 2]), np.random.default_rng([4, 2])
    start, later = TASK.sample(plain, None), TASK.initial_state(seeded)
    np.testing.assert_array_equal(later.object_pose, start.object_pose)
    assert seeded.random() == plain.random()
    assert later.seed == TASK.initial_state(np.random.default_rng([4, 2])).seed
    others = [TASK.initial_state(np.random.default_rng([4, k])).seed for k in range(50)]
    assert len(set(others)) == 50
    # A task that always starts alike has other delays in each episode, too.
    still = replace(TASK, sample=lambda rng, variation: start)
    seeds = {still.initial_state(np.random.default_rng([4, k])).seed for k in range(50)}
    assert len(seeds) == 50


def test_what_contradicts_random_delays_is_refused_in_one_sentence() -> None:
    with pytest.raises(RlcoError, match="whose mean is 0; give a mean above 0, or no"):
        make_env("push_cube", effects=[effect("random_delay", mean=0.0, spread=0.02)])
    stepper = stepper_of([LATE])
    with pytest.raises(RlcoError, match="random_delay draws one for each command"):
        stepper.randomise(
            [0], {"dof_damping": 0.0 * stepper.model.dof_damping}, command_delay=1
        )
    # Nothing has changed then.
    assert stepper.model_of(0) is stepper.model
