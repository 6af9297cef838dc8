"""Evaluations: paired initial states, what is counted, and the time to success."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase

from rlco import keys
from rlco.envs import TabletopEnv, make_env
from rlco.evaluation import (
    EVALUATION_SEED,
    Evaluation,
    evaluate,
    evaluation_env,
    success_rates,
)
from rlco.physics.tasks.make_task import make_task
from rlco.policies import FlowPolicy, task_sizes

pytestmark = pytest.mark.slow


class Expert:
    """The scripted expert as a policy, which also notes where episodes started."""

    def __init__(self, env: TabletopEnv, delay: int = 0) -> None:
        self.env, self.delay = env, delay
        self.decision = 0
        self.starts: list[torch.Tensor] = []

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        decisions = -(-self.env.horizon // self.env.chunk)
        if self.decision % decisions == 0:
            self.starts.append(tensordict[keys.INSTRUCTION_ID].clone())
            goals = self.env.stepper.scene_state().goal_position
            self.starts.append(torch.from_numpy(goals.copy()))
        state = self.env.stepper.scene_state()
        action = self.env.task.expert(state)[:, None].repeat(self.env.chunk, 1)
        if self.decision % decisions < self.delay:
            action[..., :6] = 0.0
        self.decision += 1
        return tensordict.set(keys.ACTION, torch.from_numpy(action).float())


def test_policies_and_domains_are_compared_from_the_same_starts() -> None:
    seen = []
    for domain, delay in (("sim", 0), ("sim", 2), ("stand_in", 0)):
        env = evaluation_env("push_cube", domain, chunk=4, episodes=3, horizon=8)
        policy = Expert(env, delay)
        evaluate(policy, env, 3)
        seen.append(policy.starts)
    for other in seen[1:]:
        for one, two in zip(seen[0], other, strict=True):
            assert torch.equal(one, two)


def test_policies_that_share_an_environment_see_the_same_starts() -> None:
    env = make_env("push_cube", num_envs=2, chunk=4, horizon=8)
    first, second = Expert(env), Expert(env, delay=1)
    for policy in (first, second):
        evaluate(policy, env, 3)
    assert len(first.starts) == len(second.starts) == 4  # two batches, two notes each
    for one, two in zip(first.starts, second.starts, strict=True):
        assert torch.equal(one, two)
    assert not torch.equal(first.starts[1], first.starts[3])


def test_the_first_m_episodes_are_counted_whatever_the_batch() -> None:
    results = []
    for num_envs in (6, 4):  # six at once; four, then two of four
        env = make_env("push_cube", num_envs=num_envs, chunk=2, seed=3, horizon=44)
        results.append(evaluate(Expert(env), env, 6))
    for result in results:
        assert result.success.shape == (6,)
        assert result.seconds.shape == (6,)
    np.testing.assert_array_equal(results[0].success, results[1].success)
    np.testing.assert_array_equal(results[0].seconds, results[1].seconds)
    # Enough time for some, not for all: the order matters.
    assert 0 < results[0].success.sum() < 6


def test_training_never_sees_the_initial_states_of_an_evaluation() -> None:
    env = evaluation_env("push_cube", "sim", chunk=4, episodes=100)
    assert env.batch_size == (64,)
    assert env._seed == EVALUATION_SEED > 1_000_000


class Scripted(TabletopEnv):
    """An environment in which success comes and goes by a given list."""

    solved: Any = ()

    def _solved(self) -> Any:
        decision = -(-int(self._elapsed.max()) // self.chunk)
        return np.array([row[decision] for row in self.solved])


def test_time_to_success_counts_to_where_it_stays_solved() -> None:
    # Five decisions of 4 control steps at 20 Hz: 0.2 s each; first entry: the start.
    env = make_env("push_cube", num_envs=4, chunk=4, horizon=18)
    env.__class__ = Scripted
    env.solved = [
        [0, 0, 1, 1, 1, 1],  # from the second decision on: 0.4 s
        [0, 1, 0, 0, 1, 1],  # solved, undone, solved again by the fourth: 0.8 s
        [0, 1, 1, 1, 1, 0],  # undone at the end: not a success
        [0, 0, 0, 0, 0, 1],  # in the last one, cut short at 18 steps: 0.9 s
    ]
    env.solved = [[bool(v) for v in row] for row in env.solved]
    result = evaluate(Expert(env), env, 4)
    assert result.success.tolist() == [True, True, False, True]
    np.testing.assert_allclose(result.seconds, [0.4, 0.8, np.nan, 0.9])


def test_solved_at_the_end_at_some_time_and_lost_again() -> None:
    env = make_env("push_cube", num_envs=5, chunk=4, horizon=12, seed=7)
    env.__class__ = Scripted
    solved = [
        [0, 0, 0, 1],  # in the last decision alone
        [0, 1, 0, 0],  # lost again
        [0, 1, 0, 1],  # lost, and solved again by the end
        [0, 0, 0, 0],  # never
        [1, 0, 0, 0],  # only before the first decision: nothing that the policy did
    ]
    env.solved = [[bool(v) for v in row] for row in solved]
    result = evaluate(Expert(env), env, 5)
    assert result.success.tolist() == [True, False, True, False, False]
    assert result.ever.tolist() == [True, True, True, False, False]
    assert result.lost.tolist() == [False, True, False, False, False]
    row = result.row("sft", "sim", 0, task="push_cube", policy="gaussian")
    assert row["outcomes"] == [1, 0, 1, 0, 0]
    assert row["ever"] == [1, 1, 1, 0, 0]
    assert (row["successes"], row["ever_successes"], row["lost"]) == (2, 3, 1)
    assert row["states_seed"] == 7
    assert str(result).endswith("of 5 episodes, in 0.6 s; ever 60.0%, lost again 20.0%")


def test_a_row_and_a_line_of_an_evaluation() -> None:
    # 17 of 20: Wilson's interval is [0.64, 0.95].
    success, ever = np.arange(20) < 17, np.arange(20) < 18
    result = Evaluation(success, np.where(success, 2.5, np.nan), ever)
    assert result.rate == pytest.approx(0.85)
    assert result.row("sft", "stand_in", 3, task="push_cube", policy="token") == {
        "method": "sft",
        "task": "push_cube",
        "policy": "token",
        "domain": "stand_in",
        "variation": None,
        "seed": 3,
        "episodes": 20,
        "successes": 17,
        "ever_successes": 18,
        "lost": 1,
        "outcomes": [1] * 17 + [0] * 3,
        "ever": [1] * 18 + [0] * 2,
    }
    line = "85.0% [64.0%, 94.8%] of 20 episodes, in 2.5 s; ever 90.0%, lost again 5.0%"
    assert str(result) == line
    nothing = np.zeros(4, dtype=bool)
    none = Evaluation(nothing, np.full(4, np.nan), nothing)
    line = "0.0% [0.0%, 49.0%] of 4 episodes; ever 0.0%, lost again 0.0%"
    assert str(none) == line


def test_an_evaluation_on_the_way_leaves_the_random_numbers_as_they_were() -> None:
    # FPO draws where it compares losses, whatever it does.
    sizes = task_sizes(make_task("push_cube"))
    policy = FlowPolicy(chunk=4, hidden=(8,), method="fpo", **sizes)
    env = make_env("push_cube", num_envs=1, chunk=4, horizon=4)
    before = torch.get_rng_state()
    success_rates(policy, {"sim": env}, 1)
    assert torch.equal(torch.get_rng_state(), before)
