"""Encoders that stay as they are: images are read once, and acted on anew."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from policy_cases import demonstrations, observations, tiny
from tensordict import TensorDict, TensorDictBase
from torchrl.objectives import ClipPPOLoss

from rlco.errors import ConfigError
from rlco.keys import IMAGE, IMAGE_FEATURES
from rlco.losses import CoTrainingLoss, ImitationLoss, log_probs
from rlco.policies import ImageEncoder, load_policy, save_policy
from rlco.policies.nets.dense_images import DenseImages

KINDS = pytest.mark.parametrize("kind", ["gaussian", "token", "flow"])
ENCODERS = pytest.mark.parametrize("encoder", ["conv", "dense"])
DENSE: dict[str, Any] = {"kind": "dense", "size": (64, 64)}


@pytest.fixture(autouse=True)
def _seed() -> None:
    torch.manual_seed(0)


def images(*batch: int) -> torch.Tensor:
    return torch.randint(0, 256, (*batch, 3, 64, 64), dtype=torch.uint8)


def played(policy: Any, rows: int) -> TensorDictBase:
    with torch.no_grad():
        td: TensorDictBase = policy(observations(rows).set(IMAGE, images(rows)))
    return td


@pytest.mark.parametrize("size", [(64, 64), (128, 128), (96, 200)])
def test_a_dense_encoder_has_about_eight_cells_a_side(size: tuple[int, int]) -> None:
    maps = DenseImages(size).maps[:-1](torch.zeros(1, 3, *size))
    assert maps.shape[1] == 64
    assert all(
        7 <= cells * (32 * (min(size) // 32)) / side <= 10
        for cells, side in zip(maps.shape[2:], size, strict=True)
    )


def test_dense_features_of_an_image_depend_on_no_other_image() -> None:
    encoder = ImageEncoder("dense", (64, 64))
    both = images(2)
    alone = torch.cat([encoder(one[None]) for one in both])
    torch.testing.assert_close(encoder(both), alone, atol=1e-5, rtol=1e-5)
    assert encoder(both).shape == (2, encoder.features)


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
@KINDS
@ENCODERS
def test_the_first_ratio_is_one_from_stored_features(
    kind: str, encoder: str, dtype: torch.dtype
) -> None:
    policy = tiny(kind, image={**DENSE, "kind": encoder}).to(dtype)
    policy.fix_images()
    batch = played(policy, 24).select(*policy.replay_keys)
    assert IMAGE not in batch
    batch["vla_action", "log_probs"] = log_probs(policy, batch, rows=8)
    batch["advantage"] = torch.randn(24, 1)
    loss = ClipPPOLoss(policy, None, entropy_bonus=False, critic_coeff=None)
    out = loss(batch[torch.randperm(24)[:8]])
    assert float(out["max_ratio"].detach()) == pytest.approx(1.0, abs=1e-5)


@KINDS
def test_a_fixed_encoder_stays_and_the_rest_learns(kind: str) -> None:
    policy = tiny(kind, image=DENSE)
    policy.fix_images()
    before = {name: value.clone() for name, value in policy.state_dict().items()}
    rollout = played(policy, 6).select(*policy.replay_keys)
    rollout["vla_action", "log_probs"] = log_probs(policy, rollout)
    rollout["advantage"] = torch.randn(6, 1)
    real = demonstrations(policy, 4)
    real[IMAGE_FEATURES] = policy.encoder.image(images(4))
    ppo = ClipPPOLoss(policy, None, entropy_bonus=False, critic_coeff=None)
    loss = CoTrainingLoss(ppo, ImitationLoss(policy), real_coeff=0.2)
    optimizer = torch.optim.AdamW(loss.parameters(), 1e-2)
    out = loss(TensorDict({"sim": rollout, "real": real}))
    (out["loss_objective"] + out["loss_bc_real"]).backward()
    optimizer.step()
    moved = {k for k, v in policy.state_dict().items() if not torch.equal(v, before[k])}
    assert moved
    assert not any(name.startswith("encoder.image") for name in moved)


@KINDS
def test_stored_features_give_what_images_give(kind: str) -> None:
    policy = tiny(kind, image=DENSE)
    td = played(policy, 5)
    expected = policy.encoder(td)
    policy.fix_images()
    td[IMAGE_FEATURES] = policy.encoder.image_features(td)
    assert torch.equal(policy.encoder(td.exclude(IMAGE)), expected)


@KINDS
def test_an_action_never_comes_from_the_image_before(kind: str) -> None:
    policy = tiny(kind, image=DENSE)
    policy.fix_images()
    td = played(policy, 3)
    earlier = td[IMAGE_FEATURES].clone()
    td[IMAGE] = images(3)  # the next step of the same environments
    with torch.no_grad():
        policy(td)
        assert torch.equal(td[IMAGE_FEATURES], policy.encoder.image(td[IMAGE]))
    assert not torch.equal(td[IMAGE_FEATURES], earlier)


def test_features_that_lie_about_are_read_by_fixed_encoders_alone() -> None:
    policy = tiny("gaussian", image=DENSE)
    td = played(policy, 3)
    expected = policy.encoder(td)
    td[IMAGE_FEATURES] = torch.zeros(3, 128)
    assert torch.equal(policy.encoder(td), expected)


def test_features_of_several_cameras_are_kept_apart() -> None:
    cameras = ["agentview", "robot0_eye_in_hand"]
    policy = tiny("gaussian", image={**DENSE, "cameras": cameras})
    td = observations(3)
    for name in cameras:
        td[*IMAGE, name] = images(3)
    expected = policy.encoder(td)
    policy.fix_images()
    with torch.no_grad():
        policy(td)
    assert td[IMAGE_FEATURES].shape == (3, 256)
    assert torch.equal(policy.encoder(td.exclude(IMAGE)), expected)


def test_a_fixed_policy_is_saved_as_any_other(tmp_path: Any) -> None:
    policy = tiny("gaussian", image=DENSE)
    td = observations(2).set(IMAGE, images(2))
    expected = policy.encoder(td)
    policy.fix_images()
    save_policy(policy, tmp_path)
    loaded, _ = load_policy(tmp_path)
    assert not loaded.images_fixed
    assert torch.equal(loaded.encoder(td), expected)


def test_a_policy_without_images_has_none_to_fix() -> None:
    with pytest.raises(ConfigError, match="reads no images"):
        tiny("gaussian").fix_images()
