"""OpenVLA as an actor: tokens drawn and evaluated alike, gradients, imitation."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy import stats
from tensordict import TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type
from vla_cases import INSTRUCTIONS, folder, rows, slopes

from rlco.errors import CheckpointError, ConfigError, DataError
from rlco.losses import log_probs
from rlco.policies.vla.openvla.load import load_openvla
from rlco.policies.vla.openvla.policy import OpenVLAPolicy


def actor(
    dtype: torch.dtype = torch.float32, *, action_size: int = 7, **options: Any
) -> OpenVLAPolicy:
    path = folder("openvla", action_size=action_size)
    given = {"instructions": INSTRUCTIONS, "tokenizer": path} | options
    model = load_openvla(path, dtype=dtype)
    # Random weights hardly tell tokens apart.
    with torch.no_grad():
        model.language_model.lm_head.weight.mul_(20)
    return OpenVLAPolicy(model, action_size=action_size, **given)


def rollout(policy: OpenVLAPolicy, count: int = 4) -> TensorDictBase:
    torch.manual_seed(0)
    return policy(rows(count).exclude("vla_action"))


def log_prob(policy: OpenVLAPolicy, td: TensorDictBase) -> torch.Tensor:
    return policy.get_dist(td).log_prob(td["vla_action", "sample"])


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("temperature", [1.0, 1.6])
@pytest.mark.parametrize("level", ["chunk", "token"])
def test_the_first_ratio_is_one(
    dtype: torch.dtype, temperature: float, level: Any
) -> None:
    policy = actor(dtype, temperature=temperature, log_prob_level=level)
    td = rollout(policy, 6)
    old = log_probs(policy, td, rows=3)
    mixed = torch.tensor([5, 0, 2])
    new = log_prob(policy, td[mixed])
    assert float((new - old[mixed]).exp().sub(1).abs().max()) < 1e-5


@pytest.mark.parametrize("temperature", [1.0, 1.6])
def test_drawing_and_evaluating_agree(temperature: float) -> None:
    policy = actor(temperature=temperature, log_prob_level="token")
    td = rollout(policy, 16)
    written = td["vla_action", "log_probs"]
    assert written.shape == (16, 1, 7)
    assert float(written.exp().std()) > 1e-3  # the tokens do differ
    torch.testing.assert_close(log_prob(policy, td), written, atol=1e-4, rtol=1e-4)


@pytest.mark.slow
def test_samples_are_as_frequent_as_their_probability_says() -> None:
    policy = actor(action_size=1)
    one = rows(1, chunk=1, action_size=1)
    image = one["observation", "image"]
    one["observation", "image"] = image[..., :28, :28]
    td = one.exclude("vla_action").expand(10_000).contiguous()
    torch.manual_seed(0)
    drawn = torch.cat([policy(part)["vla_action", "sample"] for part in td.split(500)])
    every = one.expand(256).contiguous()
    every["vla_action", "sample"] = torch.arange(256).view(256, 1, 1)
    with torch.no_grad():
        probability = log_prob(policy, every).exp().double().numpy()
    assert probability.sum() == pytest.approx(1.0, abs=1e-5)
    # Rare tokens are pooled, for the chi-squared test to hold.
    order = np.argsort(probability)
    pool = np.cumsum(probability[order] * 10_000) // 10
    expected = np.bincount(pool.astype(int), probability[order] * 10_000)
    counts = np.bincount(drawn.flatten().numpy(), minlength=256)[order]
    seen = np.bincount(pool.astype(int), counts, minlength=len(expected))
    kept = expected > 0
    scale = seen[kept].sum() / expected[kept].sum()
    assert stats.chisquare(seen[kept], expected[kept] * scale).pvalue > 1e-3


def test_padding_between_image_and_text_changes_nothing() -> None:
    # Alone, the short instruction is not padded.
    long = "push the blue cube onto the red mark in the middle of the plate"
    short = INSTRUCTIONS[1]
    together = actor(instructions=(long, short), log_prob_level="token")
    alone = actor(instructions=(short,), log_prob_level="token")
    assert together.token_mask[1].sum() == alone.token_mask[0].sum()
    assert not together.token_mask[1].all()
    td = rollout(together, 4)
    td["instruction_id"] = torch.ones(4, dtype=torch.int64)
    other = td.clone()
    other["instruction_id"] = torch.zeros(4, dtype=torch.int64)
    torch.testing.assert_close(
        log_prob(together, td), log_prob(alone, other), atol=1e-5, rtol=1e-5
    )


def test_numbers_are_predicted_from_those_before_them_alone() -> None:
    policy = actor(log_prob_level="token")
    td = rollout(policy, 2)
    before = log_prob(policy, td)
    changed = td.clone()
    changed["vla_action", "sample"][:, :, 3] = (
        td["vla_action", "sample"][:, :, 3] + 9
    ) % 256
    after = log_prob(policy, changed)
    torch.testing.assert_close(after[..., :3], before[..., :3])
    assert not torch.allclose(after[..., 4:], before[..., 4:], atol=1e-5)


def test_gradients_are_those_of_finite_differences() -> None:
    policy = actor()
    td = rollout(policy, 2)
    slope, measured = slopes(policy, lambda: log_prob(policy, td).double().sum())
    assert slope == pytest.approx(measured, rel=1e-3)


def test_imitation_is_the_cross_entropy_of_the_demonstrated_tokens() -> None:
    policy, td = actor(log_prob_level="token"), rows(3, chunk=1)
    chunk = td["vla_action", "chunk"] * 0.5  # inside the statistics
    td["vla_action", "chunk"] = chunk
    edges = np.linspace(-1, 1, 256)
    normal = np.concatenate([chunk[..., :6] / 0.5, chunk[..., 6:]], -1)
    tokens = 256 - np.digitize(np.clip(normal, -1, 1), edges)
    by_hand = td.clone()
    by_hand["vla_action", "sample"] = torch.from_numpy(tokens)
    expected = -log_prob(policy, by_hand).mean(-1)
    torch.testing.assert_close(policy.imitation_loss(td), expected)


def test_the_most_likely_action_is_in_raw_units() -> None:
    policy = actor(action_limit=None)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        td = rollout(policy, 3)
    tokens = td["vla_action", "sample"].numpy()
    edges = np.linspace(-1, 1, 256)
    centres = (edges[:-1] + edges[1:]) / 2
    normal = centres[np.clip(256 - tokens - 1, 0, 254)]
    normal[..., :6] *= 0.5  # quantiles -0.5 and 0.5; the gripper is not normalised
    np.testing.assert_allclose(td["action"], normal, atol=1e-6)


def test_the_summary_predicts_the_first_token() -> None:
    policy = actor(log_prob_level="token")
    td = rollout(policy, 3)
    summary = td["vla_prefix", "summary"]
    logits = policy.model.action_logits(summary).log_softmax(-1)
    first = td["vla_action", "sample"][:, 0, 0]
    chosen = logits.gather(-1, first.unsqueeze(-1)).squeeze(-1)
    torch.testing.assert_close(chosen, td["vla_action", "log_probs"][:, 0, 0])


# -- What is refused ---------------------------------------------------------------


def test_statistics_of_another_robot_are_refused() -> None:
    path = folder("openvla", action_size=7)
    model = load_openvla(path, dtype=torch.float32)
    given = {"instructions": INSTRUCTIONS, "tokenizer": path}
    with pytest.raises(CheckpointError, match=r"7 action dimensions.*are 6"):
        OpenVLAPolicy(model, action_size=6, **given)


def test_missing_statistics_are_named() -> None:
    with pytest.raises(CheckpointError, match=r"'bridge'.*it has: tiny"):
        actor(unnorm_key="bridge")


def test_own_quantiles_take_their_place() -> None:
    quantiles = ([-2.0] * 7, [2.0] * 7)
    policy = actor(unnorm_key=None, action_quantiles=quantiles, action_limit=None)
    raw = policy.tokenizer.decode(torch.zeros(1, 7, dtype=torch.int64))
    torch.testing.assert_close(raw, torch.full((1, 7), 2 * 254 / 255))


def test_a_missing_tokenizer_names_the_option(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="tokenizer=FOLDER"):
        actor(tokenizer=tmp_path)


def test_chunks_of_several_steps_are_refused() -> None:
    with pytest.raises(DataError, match="load the data with chunk=1"):
        actor().imitation_loss(rows(2))


@pytest.mark.parametrize("temperature", [0.0, -1.0])
def test_a_temperature_must_be_positive(temperature: float) -> None:
    with pytest.raises(ConfigError, match="temperature"):
        actor(temperature=temperature)


def test_a_regression_head_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "oft"
    shutil.copytree(folder("openvla", action_size=7), path)
    (path / "action_head--50000_checkpoint.pt").touch()
    with pytest.raises(CheckpointError, match="regression head"):
        load_openvla(path)
