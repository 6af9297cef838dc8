"""A policy with a domain flag: what it reads, how it is guided, what its file keeps."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import torch
from policy_cases import demonstrations, observations, tiny
from tensordict import TensorDict, TensorDictBase
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rlco.data import SimRealReplayBuffer
from rlco.errors import ConfigError, DataError
from rlco.keys import ACTION, CHUNK, DOMAIN, LOG_PROB, SAMPLE, STATE
from rlco.losses import CoTrainingLoss, ImitationLoss
from rlco.policies import GaussianPolicy, load_policy, save_policy

KINDS = ("gaussian", "token", "flow")


@pytest.fixture(autouse=True)
def _seed() -> None:
    torch.manual_seed(0)


def linear(guidance: float) -> GaussianPolicy:
    """Return a policy whose mean is 2 state + 3 flag + 0.5."""
    policy = GaussianPolicy(1, chunk=1, action_size=1, hidden=(), guidance=guidance)
    with torch.no_grad():
        policy.network.head.weight.copy_(torch.tensor([[2.0, 3.0]]))
        policy.network.head.bias.fill_(0.5)
    return policy


def states(*values: float, flags: list[float] | None = None) -> TensorDictBase:
    rows = TensorDict({"observation": {"state": torch.tensor(values)[:, None]}})
    rows.batch_size = [len(values)]
    if flags is not None:
        rows[DOMAIN] = torch.tensor(flags)[:, None]
    return rows


def acted(policy: Any, rows: TensorDictBase) -> TensorDictBase:
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
        found: TensorDictBase = policy(rows.clone())
    return found


@pytest.mark.parametrize(
    ("guidance", "flags", "means"),
    [
        (0.0, None, [2.5, -1.5]),
        (1.0, None, [5.5, 1.5]),
        (1.5, None, [7.0, 3.0]),
        (1.0, [-1.0, 0.0], [-0.5, -1.5]),
        (1.5, [-1.0, 0.0], [-2.0, -1.5]),
    ],
)
def test_the_mean_is_guided_away_from_that_without_a_flag(
    guidance: float, flags: list[float] | None, means: list[float]
) -> None:
    policy, rows = linear(guidance), states(1.0, -1.0, flags=flags)
    found = acted(policy, rows)
    assert found[SAMPLE].flatten().tolist() == pytest.approx(means)
    # 0.2 wide, at the mean itself.
    peak = -math.log(0.2) - 0.5 * math.log(2 * math.pi)
    assert found[LOG_PROB].tolist() == pytest.approx([peak, peak])


@pytest.mark.parametrize("guidance", [0.0, 1.0, 2.5])
def test_imitation_trains_the_output_under_each_rows_own_flag(guidance: float) -> None:
    rows = states(1.0, 1.0, 1.0, flags=[1.0, -1.0, 0.0])
    rows[CHUNK] = torch.zeros(3, 1, 1)
    policy = linear(guidance)
    loss = policy.imitation_loss(rows).flatten().tolist()
    assert loss == pytest.approx([5.5**2, 0.5**2, 2.5**2])
    robot = policy.imitation_loss(rows.exclude(DOMAIN)).flatten().tolist()
    assert robot == pytest.approx([5.5**2] * 3)


def test_one_step_of_a_flow_follows_the_guided_velocity() -> None:
    policy = tiny("flow", steps=1, guidance=1.0)
    rows = observations(5)
    ends = {}
    for weight in (0.0, 1.0, 1.5):
        policy.set_guidance(weight)
        ends[weight] = acted(policy, rows)[SAMPLE][:, -1]
    assert not torch.allclose(ends[0.0], ends[1.0], atol=1e-2)
    torch.testing.assert_close(ends[1.5], ends[0.0] + 1.5 * (ends[1.0] - ends[0.0]))


def test_the_logits_of_a_token_are_guided() -> None:
    policy = tiny("token", chunk=1, action_size=1, guidance=1.0)
    rows = observations(1).expand(6).clone()
    rows[SAMPLE] = torch.arange(6).view(6, 1, 1)
    found = {}
    for weight in (0.0, 1.0, 1.5):
        policy.set_guidance(weight)
        found[weight] = policy.get_dist(rows).log_prob(rows[SAMPLE])
    assert not torch.allclose(found[0.0], found[1.0], atol=1e-2)
    # A softmax does not see what the normalised logits have lost, a constant.
    expected = (found[0.0] + 1.5 * (found[1.0] - found[0.0])).log_softmax(0)
    torch.testing.assert_close(found[1.5], expected)


@pytest.mark.parametrize("kind", KINDS)
def test_a_guided_sample_is_evaluated_as_it_was_drawn(kind: str) -> None:
    policy = tiny(kind, guidance=1.5)
    rows = policy(observations(7))
    again = policy.get_dist(rows).log_prob(rows[SAMPLE])
    torch.testing.assert_close(again, rows[LOG_PROB], rtol=1e-4, atol=1e-4)
    policy.set_guidance(1.0)
    other = policy.get_dist(rows).log_prob(rows[SAMPLE])
    assert not torch.allclose(other, rows[LOG_PROB], atol=1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_a_batch_without_a_flag_is_from_the_robot(kind: str) -> None:
    policy, rows = tiny(kind, guidance=1.5), observations(4)
    flagged = {
        flag: acted(policy, rows.clone().set(DOMAIN, torch.full((4, 1), flag)))
        for flag in (1.0, -1.0)
    }
    plain = acted(policy, rows)
    assert torch.equal(plain[ACTION], flagged[1.0][ACTION])
    assert not torch.equal(plain[SAMPLE], flagged[-1.0][SAMPLE])


@pytest.mark.parametrize("kind", KINDS)
def test_a_policy_without_guidance_reads_no_flag_and_records_none(kind: str) -> None:
    policy, rows = tiny(kind), demonstrations(tiny(kind), 4)
    assert "guidance" not in policy.arguments
    assert policy.feature_size == policy.encoder.size
    flagged = rows.clone().set(DOMAIN, torch.full((4, 1), -1.0))
    assert torch.equal(acted(policy, rows)[ACTION], acted(policy, flagged)[ACTION])
    losses = []
    for batch in (rows, flagged):
        torch.manual_seed(1)
        losses.append(policy.imitation_loss(batch))
    assert torch.equal(*losses)


@pytest.mark.parametrize("kind", KINDS)
def test_a_loaded_policy_is_guided_as_the_saved_one(kind: str, tmp_path: Path) -> None:
    policy, rows = tiny(kind, guidance=1.5), observations(4)
    policy.set_guidance(0.5)
    save_policy(policy, tmp_path)
    loaded, _ = load_policy(tmp_path)
    assert loaded.guidance == 0.5
    assert torch.equal(acted(loaded, rows)[ACTION], acted(policy, rows)[ACTION])
    loaded.set_guidance(1.5)
    assert not torch.equal(acted(loaded, rows)[SAMPLE], acted(policy, rows)[SAMPLE])


def test_two_domains_that_contradict_each_other_are_both_learned() -> None:
    """Simulated actions are 0.6, real ones -0.2, at the same observations."""

    def domain(action: float) -> TensorDictReplayBuffer:
        rows = states(*torch.rand(64).tolist())
        rows[CHUNK] = torch.full((64, 1, 1), action)
        buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(64))
        buffer.extend(rows)
        return buffer

    policy = GaussianPolicy(1, chunk=1, action_size=1, hidden=(16,), guidance=1.0)
    loss = CoTrainingLoss(
        ImitationLoss(policy), ImitationLoss(policy), sim_coeff=0.5, real_coeff=0.5
    )
    buffer = SimRealReplayBuffer(
        domain(0.6), domain(-0.2), sim_ratio=0.5, batch_size=64, domain_flag=0.2
    )
    optimizer = torch.optim.Adam(loss.parameters(), lr=2e-2)
    for _ in range(200):
        optimizer.zero_grad()
        sum(loss(buffer.sample()).values()).backward()
        optimizer.step()
    found = acted(policy, states(0.3, 0.3, 0.3, flags=[-1.0, 0.0, 1.0]))[SAMPLE]
    assert found.flatten().tolist() == pytest.approx([0.6, 0.2, -0.2], abs=0.08)
    # Without the flag it is between the two; guided further, beyond the robot's.
    policy.set_guidance(1.5)
    (beyond,) = acted(policy, states(0.3))[SAMPLE].flatten().tolist()
    assert beyond == pytest.approx(-0.4, abs=0.12)


def test_what_cannot_be_guided_is_refused() -> None:
    with pytest.raises(ConfigError, match="reads none; train one with sft domain_flag"):
        tiny("gaussian").set_guidance(1.5)
    with pytest.raises(ConfigError, match="guidance=nan must be finite"):
        tiny("gaussian", guidance=math.nan)
    rows = states(1.0, 2.0)
    rows[DOMAIN] = torch.ones(2)
    with pytest.raises(
        DataError, match=r"'domain' has shape \(2,\).* of shape \(2, 1\)"
    ):
        linear(1.0)(rows)
    assert STATE in linear(1.0).in_keys
    assert DOMAIN not in linear(1.0).in_keys  # no environment has to give it
