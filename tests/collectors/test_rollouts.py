"""Rollouts: GAE by hand, normalised advantages, and episodes named by iteration."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import nn
from torchrl.objectives import ClipPPOLoss

from rlco import keys
from rlco.collectors import RolloutCollector
from rlco.envs import TabletopEnv, make_env
from rlco.losses import log_probs
from rlco.policies import GaussianPolicy, ValueNetwork

GAMMA, LMBDA = 0.5, 0.8
SIZES: dict[str, Any] = {
    "environment_state_size": 12,
    "num_instructions": 3,
    "hidden": (16,),
}


class ValueIsFirstNumber(nn.Module):
    """A critic whose value is the first number of the state."""

    def __init__(self) -> None:
        super().__init__()
        # GAE's name for them; lists, which it appends to.
        self.in_keys, self.out_keys = [keys.STATE], [keys.STATE_VALUE]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.set(keys.STATE_VALUE, tensordict.get(keys.STATE)[..., :1])


def make_collector(
    critic: nn.Module | None = None, **options: Any
) -> tuple[RolloutCollector, TabletopEnv, GaussianPolicy]:
    torch.manual_seed(0)
    options = {"num_envs": 2, "chunk": 4, "horizon": 12, "seed": 5, **options}
    env = make_env("push_cube", **options)
    policy = GaussianPolicy(7, chunk=options["chunk"], **SIZES)
    critic = critic or ValueNetwork(7, **SIZES)
    collector = RolloutCollector(env, policy, critic, gamma=GAMMA, lmbda=LMBDA)
    return collector, env, policy


def tiny_rollout(
    values: list[float], last: float, rewards: list[float], ends: dict[str, list[int]]
) -> TensorDict:
    """Return one environment's rollout, shape (1, T), its values in the state."""
    count = len(values)
    following = [*values[1:], last]

    def column(numbers: list[float]) -> torch.Tensor:
        return torch.tensor(numbers).reshape(1, count, 1)

    flags = {}
    for name in (keys.TERMINATED, keys.TRUNCATED):
        flag = torch.zeros(1, count, 1, dtype=torch.bool)
        flag[0, ends.get(name, [])] = True
        flags[name] = flag
    following_td = {
        keys.OBSERVATION: {"state": column(following)},
        keys.REWARD: column(rewards),
        keys.DONE: flags[keys.TERMINATED] | flags[keys.TRUNCATED],
        **flags,
    }
    rollout = {keys.OBSERVATION: {"state": column(values)}, "next": following_td}
    return TensorDict(rollout, [1, count])


@pytest.mark.parametrize(
    ("end", "expected"),
    [
        # gamma = 0.5, lambda = 0.8, so A_t = delta_t + 0.4 A_{t+1}.
        # Truncated: the last step bootstraps from the value 4 of what followed it.
        # delta_2 = 3 + 0.5 * 4 - 1 = 4;  delta_1 = 2 + 0.5 * 1 - 2 = 0.5;
        # delta_0 = 1 + 0.5 * 2 - 0 = 2.
        # A_2 = 4;  A_1 = 0.5 + 0.4 * 4 = 2.1;  A_0 = 2 + 0.4 * 2.1 = 2.84.
        (keys.TRUNCATED, [2.84, 2.1, 4.0]),
        # Terminated: nothing follows. delta_2 = 3 - 1 = 2;
        # A_1 = 0.5 + 0.4 * 2 = 1.3;  A_0 = 2 + 0.4 * 1.3 = 2.52.
        (keys.TERMINATED, [2.52, 1.3, 2.0]),
    ],
)
def test_advantages_worked_out_by_hand(end: str, expected: list[float]) -> None:
    collector, _, _ = make_collector(ValueIsFirstNumber())
    rollout = tiny_rollout([0.0, 2.0, 1.0], 4.0, [1.0, 2.0, 3.0], {end: [2]})
    out = collector._gae(rollout)
    torch.testing.assert_close(out[keys.ADVANTAGE].flatten(), torch.tensor(expected))
    # The target of the value is the advantage plus the value.
    target = torch.tensor(expected) + torch.tensor([0.0, 2.0, 1.0])
    torch.testing.assert_close(out[keys.VALUE_TARGET].flatten(), target)
    collector.close()


@pytest.mark.parametrize(
    ("end", "first"), [(keys.TRUNCATED, 1.0 + 0.5 * 4.0), (keys.TERMINATED, 1.0)]
)
def test_an_end_inside_a_rollout_cuts_the_sum_and_only_truncation_bootstraps(
    end: str, first: float
) -> None:
    # One decision, value 0, reward 1, its next state worth 4; then another episode.
    collector, _, _ = make_collector(ValueIsFirstNumber())
    rollout = tiny_rollout([0.0, 7.0], 0.0, [1.0, 100.0], {end: [0, 1]})
    rollout["next", keys.OBSERVATION, "state"][0, 0] = 4.0
    out = collector._gae(rollout)
    assert out[keys.ADVANTAGE][0, 0].item() == pytest.approx(first)
    collector.close()


def test_advantages_of_a_rollout_agree_with_a_recursion_and_are_normalised() -> None:
    collector, _, _ = make_collector(ValueIsFirstNumber(), num_envs=3)
    rollout = collector.collect(0)
    assert rollout.batch_size == (3, 3)
    assert collector.frames == 3 * 12
    value = rollout[keys.STATE][..., 0]
    following = rollout["next", *keys.STATE][..., 0]
    delta = rollout["next", keys.REWARD][..., 0] + GAMMA * following - value
    raw = torch.zeros(3, 3)
    running = torch.zeros(3)
    for t in (2, 1, 0):
        running = delta[:, t] + GAMMA * LMBDA * running
        raw[:, t] = running
    expected = (raw - raw.mean()) / (raw.std() + 1e-5)
    got = rollout[keys.ADVANTAGE].squeeze(-1)
    torch.testing.assert_close(got, expected, atol=1e-5, rtol=1e-5)
    assert got.mean().abs() < 1e-5
    assert got.std().item() == pytest.approx(1.0, abs=1e-3)
    # Targets stay in the reward's own units.
    torch.testing.assert_close(
        rollout[keys.VALUE_TARGET].squeeze(-1), raw + value, atol=1e-5, rtol=1e-5
    )
    assert not rollout[keys.ADVANTAGE].requires_grad
    assert rollout["next", keys.TRUNCATED].squeeze(-1).tolist() == [[0, 0, 1]] * 3
    collector.close()


def test_iteration_k_plays_the_kth_episodes_whatever_was_played_before() -> None:
    collector, _, _ = make_collector()

    def starts(iteration: int) -> torch.Tensor:
        return collector.collect(iteration)[keys.ENVIRONMENT_STATE][:, 0]

    one, two = starts(1), starts(2)
    assert not torch.equal(one, two)
    starts(7)
    assert torch.equal(starts(2), two)
    fresh, _, _ = make_collector()  # a resumed run: nothing was played before
    assert torch.equal(fresh.collect(2)[keys.ENVIRONMENT_STATE][:, 0], two)
    collector.close()
    fresh.close()


def test_a_rollout_is_the_same_again_from_the_same_random_state() -> None:
    collector, _, _ = make_collector()
    torch.manual_seed(3)
    first = collector.collect(4)[keys.SAMPLE].clone()
    collector.collect(5)
    torch.manual_seed(3)
    assert torch.equal(collector.collect(4)[keys.SAMPLE], first)
    collector.close()


def test_the_first_ratio_after_a_rollout_is_one() -> None:
    collector, _, policy = make_collector()
    flat = collector.collect(1).reshape(-1)
    flat.set(keys.LOG_PROB, log_probs(policy, flat, rows=4))
    critic = ValueNetwork(7, **SIZES)
    loss = ClipPPOLoss(policy, critic, entropy_bonus=False)
    for part in flat.split(4):
        assert loss(part)["max_ratio"].item() == pytest.approx(1.0, abs=1e-5)
    collector.close()
