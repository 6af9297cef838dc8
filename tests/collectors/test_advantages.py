"""Advantages without a critic: groups that start alike, and rollouts without signal."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase

from rlco import keys
from rlco.collectors import RolloutCollector, check_signal, group_advantages
from rlco.collectors.advantages import normalize
from rlco.envs import make_env
from rlco.errors import ConfigError, NoSignalError, RlcoError
from rlco.physics.tasks.make_task import make_task
from rlco.policies import GaussianPolicy, ValueNetwork, task_sizes


def episodes(rewards: list[list[float]], **flags: Any) -> TensorDictBase:
    """Return a rollout of these rewards, (N, T)."""
    reward = torch.tensor(rewards, dtype=torch.float32).unsqueeze(-1)
    false = torch.zeros_like(reward, dtype=torch.bool)
    content = {keys.REWARD: reward, keys.DIVERGED: false, keys.SUCCESS: false.clone()}
    return TensorDict({"next": content | flags}, reward.shape[:2])


def make_collector(num_envs: int, group_size: int) -> RolloutCollector:
    torch.manual_seed(0)
    env = make_env("push_cube", num_envs=num_envs, chunk=4, horizon=8, seed=5)
    policy = GaussianPolicy(chunk=4, **task_sizes(make_task("push_cube")))
    return RolloutCollector(env, policy, advantage="mc", group_size=group_size)


def test_each_return_is_compared_within_its_group_by_hand() -> None:
    # Returns 1, 2, 6 (mean 3, deviation sqrt 7) and 5, 5, 5, which tell nothing.
    rollout = episodes([[1, 0], [0, 2], [4, 2], [5, 0], [0, 5], [2, 3]])
    found = group_advantages(rollout, 3).squeeze(-1)
    expected = torch.tensor([-2.0, -1.0, 3.0, 0.0, 0.0, 0.0]) / 7**0.5
    torch.testing.assert_close(found, expected.unsqueeze(-1).expand(6, 2))


def test_an_episode_that_diverged_teaches_nothing_and_is_nothing_to_beat() -> None:
    diverged = torch.zeros(6, 2, 1, dtype=torch.bool)
    diverged[1, 1] = diverged[3, 0] = diverged[5, 1] = True
    rollout = episodes(
        [[1, 0], [90, 9], [0, 2], [5, 5], [3, 4], [0, 0]], **{keys.DIVERGED: diverged}
    )
    found = group_advantages(rollout, 3).squeeze(-1)
    # Returns 1 and 2 are left of the first group: mean 1.5, deviation sqrt 0.5. Of the
    # second one episode is left, which compares with nothing.
    expected = torch.tensor([-0.5, 0.0, 0.5, 0.0, 0.0, 0.0]) / 0.5**0.5
    torch.testing.assert_close(found, expected.unsqueeze(-1).expand(6, 2))


def test_a_group_starts_alike_and_every_iteration_elsewhere() -> None:
    collector = make_collector(num_envs=6, group_size=3)
    first, second = collector.collect(1), collector.collect(2)
    starts = torch.cat(
        [rollout[keys.ENVIRONMENT_STATE][:, 0] for rollout in (first, second)]
    )
    for group in starts.split(3):
        assert torch.equal(group, group[:1].expand(3, -1))
    assert len(starts.unique(dim=0)) == 4
    # They part by what the policy draws.
    assert len(first["action"].unique(dim=0)) == 6
    collector.close()


def test_a_rollout_carries_group_advantages_and_nothing_of_a_critic() -> None:
    collector = make_collector(num_envs=4, group_size=2)
    rollout = collector.collect(0)
    returns = rollout["next", keys.REWARD].sum((1, 2))
    for group, found in zip(
        returns.split(2), rollout[keys.ADVANTAGE].split(2), strict=True
    ):
        expected = (group - group.mean()) / group.std()
        torch.testing.assert_close(found, expected[:, None, None].expand(2, 2, 1))
    assert keys.VALUE_TARGET not in rollout
    collector.close()


def test_groups_must_fill_the_batch_and_be_groups() -> None:
    with pytest.raises(RlcoError, match="group_size=4 does not divide num_envs=6"):
        make_collector(num_envs=6, group_size=4)
    with pytest.raises(ConfigError, match="group_size=1 leaves nothing to compare"):
        make_collector(num_envs=6, group_size=1)
    with pytest.raises(ConfigError, match="'gae' needs a critic"):
        RolloutCollector(make_env("push_cube"), None, advantage="gae")
    with pytest.raises(ConfigError, match="unknown advantage 'grpo'; known: gae, mc"):
        RolloutCollector(make_env("push_cube"), None, advantage="grpo")


def test_zero_success_under_a_sparse_reward_is_told() -> None:
    rollout = episodes([[0.0, 0.0]] * 3)
    # A critic's noise makes advantages of nothing.
    rollout[keys.ADVANTAGE] = torch.randn(3, 2, 1)
    with pytest.raises(NoSignalError, match=r"0 of 3 episodes were solved.*Stage I"):
        check_signal(rollout)


def test_groups_that_all_do_equally_well_are_told() -> None:
    rollout = episodes([[0.0, 1.0], [1.0, 0.0]])
    rollout["next", keys.SUCCESS].fill_(True)
    rollout[keys.ADVANTAGE] = group_advantages(rollout, 2)
    with pytest.raises(NoSignalError, match=r"2 of 2 episodes .* evaluate it"):
        check_signal(rollout)


def test_one_episode_that_differs_is_enough() -> None:
    rollout = episodes([[0.0, 0.0], [0.0, 1.0]])
    rollout[keys.ADVANTAGE] = group_advantages(rollout, 2)
    check_signal(rollout)


def test_one_decision_alone_is_no_signal_and_no_nan() -> None:
    torch.manual_seed(0)
    env = make_env("push_cube", num_envs=1, chunk=4, horizon=4, seed=5)
    sizes = task_sizes(make_task("push_cube"))
    policy, critic = GaussianPolicy(chunk=4, **sizes), ValueNetwork(**sizes)
    rollout = RolloutCollector(env, policy, critic).collect(0)
    assert rollout[keys.ADVANTAGE].tolist() == [[[0.0]]]
    with pytest.raises(NoSignalError):
        check_signal(rollout)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("sound", [0, 1])
def test_where_hardly_a_decision_is_sound_advantages_are_zero(sound: int) -> None:
    broken = torch.arange(6).view(2, 3, 1) >= sound
    assert not normalize(torch.randn(2, 3, 1), broken).any()
