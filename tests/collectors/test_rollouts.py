"""Rollouts: GAE by hand, normalised advantages, and episodes named by iteration."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import nn
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import StepCounter, Transform
from torchrl.objectives import ClipPPOLoss

from rlco import keys
from rlco.collectors import RolloutCollector
from rlco.envs import TabletopEnv, make_env
from rlco.errors import ConfigError, NonFiniteError
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


class TellsTheTime(ValueIsFirstNumber):
    """A critic whose value is the share of the episode that is left."""

    def __init__(self) -> None:
        super().__init__()
        self.in_keys = [keys.STATE, keys.TIME_LEFT]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.set(keys.STATE_VALUE, tensordict.get(keys.TIME_LEFT))


def test_a_critic_that_knows_the_end_bootstraps_from_nothing_beyond_it() -> None:
    collector, _, _ = make_collector(TellsTheTime())
    rollout = collector.collect(0)
    third = 1 / 3
    left = rollout[keys.STATE_VALUE][0].flatten()
    torch.testing.assert_close(left, torch.tensor([1.0, 2 * third, third]))
    # gamma = 0.5, lambda = 0.8: targets are r_0 + 0.5 (0.2 V_1 + 0.8 target_1), ...,
    # and the last one is the last reward alone: nothing follows.
    reward = rollout["next", keys.REWARD][..., 0]
    last = reward[:, 2]
    middle = reward[:, 1] + 0.5 * (0.2 * third + 0.8 * last)
    first = reward[:, 0] + 0.5 * (0.2 * 2 * third + 0.8 * middle)
    torch.testing.assert_close(
        rollout[keys.VALUE_TARGET][..., 0], torch.stack([first, middle, last], -1)
    )
    collector.close()


@pytest.mark.slow
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


# -- What is not finite --------------------------------------------------------------


class Broken(TabletopEnv):
    """An environment whose reward or observation is not finite at some decision."""

    fault = ""
    at = 0

    def _advance(self, actions: Any, steps: Any) -> Any:
        reward, diverged = super()._advance(actions, steps)
        if self.fault == keys.REWARD and self._elapsed[0] == 4 * self.at:
            reward[1] = float("nan")
        return reward, diverged

    def _seen(self) -> dict[str, torch.Tensor]:
        seen = super()._seen()
        if self.fault in seen and self._elapsed[0] == 4 * self.at:
            seen[self.fault][1, 3] = float("inf")
        return seen


def broken_collector(fault: str, at: int) -> RolloutCollector:
    collector, env, _ = make_collector()
    env.__class__ = Broken
    env.fault, env.at = fault, at
    return collector


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "at", "words"),
    [
        ("reward", 1, "'reward' is NaN or infinite in 1 of 2 .* after decision 1 of"),
        ("reward", 2, "'reward' is NaN or infinite in 1 of 2 .* after decision 2 of"),
        ("state", 0, "'state'.* is NaN or infinite in 1 of 2 .* as it starts of"),
        # The policy makes NaN of it, and would be blamed a decision later.
        ("state", 1, "'state'.* is NaN or infinite in 1 of 2 .* after decision 0 of"),
        ("environment_state", 3, "'environment_state'.* after decision 2 of"),
    ],
)
def test_what_an_environment_gives_is_checked_as_it_is_played(
    fault: str, at: int, words: str
) -> None:
    collector = broken_collector(fault, at)
    with pytest.raises(NonFiniteError, match=f"{words} rollout 7") as caught:
        collector.collect(7)
    assert "first in environment 1," in str(caught.value)
    assert "the environment or a transform of it gives it" in str(caught.value)
    collector.close()


class Diverging(TabletopEnv):
    """An environment that diverges after decision 0, beside one whose reward is NaN."""

    def _advance(self, actions: Any, steps: Any) -> Any:
        reward, diverged = super()._advance(actions, steps)
        diverged[0] |= self._elapsed[1] == 0
        if self._elapsed[1] == 8:
            reward[1] = float("nan")
        return reward, diverged


def test_decisions_are_counted_from_the_rollouts_start_whatever_diverges() -> None:
    collector, env, _ = make_collector()
    env.__class__ = Diverging
    with pytest.raises(NonFiniteError, match="environment 1, after decision 2 of"):
        collector.collect(0)
    collector.close()


class Pay(Transform):
    """Makes the first environment's reward the same in every decision."""

    def __init__(self, reward: float) -> None:
        super().__init__()
        self.reward = reward

    def _step(self, tensordict: TensorDictBase, next_tensordict: Any) -> Any:
        del tensordict
        next_tensordict[keys.REWARD][0] = self.reward
        return next_tensordict


def test_a_transform_around_the_environment_is_checked_too() -> None:
    env = make_env("push_cube", num_envs=2, chunk=4, horizon=12)
    policy, critic = GaussianPolicy(7, chunk=4, **SIZES), ValueNetwork(7, **SIZES)
    paid = TransformedEnv(env, Pay(float("inf")))
    collector = RolloutCollector(paid, policy, critic)
    with pytest.raises(
        NonFiniteError, match="first in environment 0, after decision 0"
    ):
        collector.collect(0)
    collector.close()


def test_what_nobody_reads_may_be_anything() -> None:
    _, env, _ = make_collector()
    env.__class__ = Broken
    env.fault, env.at = "environment_state", 1
    sizes = SIZES | {"environment_state_size": 0}
    policy, critic = GaussianPolicy(7, chunk=4, **sizes), ValueNetwork(7, **sizes)
    collector = RolloutCollector(env, policy, critic)
    assert collector.collect(0)[keys.ADVANTAGE].isfinite().all()
    collector.close()


class Unsure(GaussianPolicy):
    """A policy that loses the log-probability of its second environment."""

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        out = super().forward(tensordict)
        out[keys.LOG_PROB][1] = float("nan")
        return out


class Lost(ValueIsFirstNumber):
    """A critic that has no value for the last state of the first environment."""

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        out = super().forward(tensordict)
        value = out[keys.STATE_VALUE].clone()
        value.view(-1, 1)[-4:] *= torch.nan
        return out.set(keys.STATE_VALUE, value)


@pytest.mark.parametrize(
    ("policy", "critic", "words"),
    [
        (Unsure, ValueIsFirstNumber, "'log_probs'.* in 3 of 6 .* lower lr"),
        # Its advantages are all NaN by then.
        (GaussianPolicy, Lost, "'state_value'.* lower critic_lr"),
    ],
)
def test_what_policy_and_critic_make_is_checked_too(
    policy: type[GaussianPolicy], critic: type[ValueIsFirstNumber], words: str
) -> None:
    env = make_env("push_cube", num_envs=2, chunk=4, horizon=12)
    collector = RolloutCollector(env, policy(7, chunk=4, **SIZES), critic())
    with pytest.raises(NonFiniteError, match=words):
        collector.collect(0)
    collector.close()


def test_returns_that_overflow_are_not_the_critics_fault() -> None:
    env = make_env("push_cube", num_envs=2, chunk=4, horizon=12)
    paid = TransformedEnv(env, Pay(3e38))  # of which float32 holds no sum
    policy = GaussianPolicy(7, chunk=4, **SIZES)
    options: dict[str, Any] = {"advantage": "mc", "group_size": 2}
    collector = RolloutCollector(paid, policy, **options)
    with pytest.raises(NonFiniteError, match="scale the reward down"):
        collector.collect(0)
    collector.close()


def test_an_environment_of_another_kind_is_refused() -> None:
    from torchrl.testing.mocking_classes import ContinuousActionVecMockEnv

    env = ContinuousActionVecMockEnv()
    with pytest.raises(ConfigError, match=r"MockEnv has no 'start_at'.*GAE"):
        RolloutCollector(env, GaussianPolicy(7, chunk=1))


@pytest.mark.slow
def test_transforms_of_ones_own_on_such_an_environment_are_taken() -> None:
    env = make_env("push_cube", num_envs=2, chunk=4, horizon=8)
    counted = TransformedEnv(env, StepCounter())
    sizes = {"environment_state_size": 12, "num_instructions": 3, "hidden": (8,)}
    policy = GaussianPolicy(7, chunk=4, **sizes)
    rollout = RolloutCollector(counted, policy, ValueNetwork(7, **sizes)).collect(0)
    assert rollout["step_count"].squeeze(-1).tolist() == [[0, 1], [0, 1]]
