"""What images become: places, alike at every call, in every kind of policy."""

from __future__ import annotations

import os
import pickle
import zipfile
from pathlib import Path
from typing import Any

import pytest
import torch
from policy_cases import demonstrations, observations, tiny
from tensordict import TensorDict, TensorDictBase
from torchrl.objectives import ClipPPOLoss
from torchvision.models import mobilenet_v2

from rlco.errors import (
    CheckpointError,
    ConfigError,
    DataError,
    RlcoError,
    UnknownNameError,
)
from rlco.keys import IMAGE, IMAGE_FEATURES, INSTRUCTION_ID
from rlco.losses import CoTrainingLoss, ImitationLoss, gradient_agreement, log_probs
from rlco.policies import ImageEncoder, ValueNetwork, load_policy, save_policy
from rlco.policies.nets.image_encoder import SpatialSoftmax

CONV: dict[str, Any] = {"kind": "conv", "size": (64, 64)}
KINDS = pytest.mark.parametrize("kind", ["gaussian", "token", "flow"])


@pytest.fixture(autouse=True)
def _seed() -> None:
    torch.manual_seed(0)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A file of MobileNetV2's weights, as torchvision's are but drawn at random."""
    torch.manual_seed(7)
    network = mobilenet_v2()
    for name, value in network.state_dict().items():
        if name.endswith("running_var"):
            value.uniform_(0.5, 2.0)
        elif name.endswith("running_mean"):
            value.normal_(0.0, 0.1)
    path = tmp_path_factory.mktemp("weights") / "mobilenet.pth"
    torch.save(network.state_dict(), path)
    return str(path)


def seen(td: TensorDictBase, size: tuple[int, int] = (64, 64)) -> TensorDictBase:
    shape = (*td.batch_size, 3, *size)
    return td.set(IMAGE, torch.randint(0, 256, shape, dtype=torch.uint8))


def image(row: int, column: int) -> torch.Tensor:
    """A grey image with one red square of 6 x 6 pixels about a place."""
    out = torch.full((3, 64, 64), 120, dtype=torch.uint8)
    square = (slice(row - 3, row + 3), slice(column - 3, column + 3))
    out[:, *square] = torch.tensor([230, 20, 20], dtype=torch.uint8)[:, None, None]
    return out


def test_a_spot_is_found_where_it_is() -> None:
    maps = torch.zeros(2, 1, 5, 9)
    maps[0, 0, 0, 8] = maps[1, 0, 2, 2] = 40.0  # above right; middle, left of it
    expected = torch.tensor([[1.0, -1.0, 40.0], [-0.5, 0.0, 40.0]])
    torch.testing.assert_close(SpatialSoftmax()(maps), expected)


@pytest.mark.slow
def test_the_small_encoder_learns_places_within_a_pixel() -> None:
    encoder = ImageEncoder("conv", (64, 64))
    head = torch.nn.Linear(encoder.features, 2)
    places = torch.randint(8, 56, (160, 2))
    images = torch.stack([image(*place) for place in places.tolist()])
    wanted = places.float() / 32 - 1
    parameters = [*encoder.parameters(), *head.parameters()]
    optimizer = torch.optim.Adam(parameters, 3e-3)
    for _ in range(60):
        rows = torch.randperm(128)[:32]
        loss = (head(encoder(images[rows])) - wanted[rows]).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    with torch.no_grad():
        error = (head(encoder(images[128:])) - wanted[128:]).abs()
    # 0.1 is 3.2 pixels; the mean place would be wrong by 12.
    assert float(error.mean()) < 0.1


@pytest.mark.parametrize("size", [(64, 64), (96, 128), (224, 224)])
def test_every_size_has_the_same_features_and_few_parameters(
    size: tuple[int, int],
) -> None:
    encoder = ImageEncoder("conv", size)
    out = encoder(torch.zeros(2, 1, 3, *size, dtype=torch.uint8))
    assert out.shape == (2, 1, encoder.features)
    assert sum(p.numel() for p in encoder.parameters()) < 40_000


@KINDS
def test_gradients_of_both_terms_reach_the_convolutions(kind: str) -> None:
    policy = tiny(kind, image=CONV)
    td = seen(demonstrations(policy, 4))
    with torch.no_grad():
        acted = policy(td.clone())
    for term in (
        policy.imitation_loss(td).mean(),
        policy.get_dist(acted).log_prob(acted["vla_action", "sample"]).mean(),
    ):
        policy.zero_grad()
        term.backward()
        for name, parameter in policy.encoder.image.named_parameters():
            assert parameter.grad is not None, name
            assert float(parameter.grad.abs().sum()) > 0, name


@KINDS
@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_the_first_ratio_is_one_with_pictures(kind: str, dtype: torch.dtype) -> None:
    policy = tiny(kind, image=CONV).to(dtype)
    with torch.no_grad():
        td = policy(seen(observations(24)))
    # The rollout keeps what `replay_keys` names, and nothing else.
    batch = td.select(*policy.replay_keys)
    batch["vla_action", "log_probs"] = log_probs(policy, batch, rows=8)
    batch["advantage"] = torch.randn(24, 1)
    loss = ClipPPOLoss(policy, None, entropy_bonus=False, critic_coeff=None)
    out = loss(batch[torch.randperm(24)[:8]])
    assert float(out["max_ratio"].detach()) == pytest.approx(1.0, abs=1e-5)


@KINDS
def test_what_a_picture_shows_changes_what_is_done(kind: str) -> None:
    policy = tiny(kind, image=CONV)
    assert IMAGE in policy.in_keys
    assert IMAGE in policy.replay_keys
    assert policy.image_size == (64, 64)
    td = demonstrations(policy, 2)[:1].expand(2).clone()
    td[IMAGE] = torch.stack([image(20, 20), image(44, 50)])
    first, second = policy.encoder(td)
    assert not torch.allclose(first, second, atol=1e-4)


def test_what_is_seen_stands_in_the_place_of_the_instruction() -> None:
    """As poses do: state 3, seen 96, seen for instruction 0 and for 1, one-hot 2."""
    policy = tiny("gaussian", image=CONV)
    td = seen(observations(1)).set(INSTRUCTION_ID, torch.tensor([1]))
    (out,) = policy.encoder(td).detach()
    features = policy.encoder.image.features
    one, none, again, which = out[3:].split([features, features, features, 2])
    assert torch.equal(one, again)
    assert not none.any()
    assert which.tolist() == [0.0, 1.0]


@KINDS
def test_a_loaded_policy_sees_alike(tmp_path: Path, kind: str, weights: str) -> None:
    mobile = {"kind": "mobilenet", "size": (64, 64), "weights": weights}
    for name, image in (("conv", CONV), ("mobilenet", mobile)):
        policy = tiny(kind, image=image)
        save_policy(policy, tmp_path / name)
        assert str(weights) not in (tmp_path / name / "policy.json").read_text()
        loaded, _ = load_policy(tmp_path / name)
        assert loaded.arguments == policy.arguments
        td = seen(observations(3))
        assert torch.equal(loaded.encoder(td), policy.encoder(td))


def test_a_policy_without_pictures_is_described_as_ever() -> None:
    policy = tiny("gaussian")
    assert "image" not in policy.arguments
    assert policy.image_size is None
    assert IMAGE not in policy.in_keys


def test_mobilenet_gives_torchvisions_maps_also_while_training(weights: str) -> None:
    encoder = ImageEncoder("mobilenet", (64, 96), weights=weights).train()
    theirs = mobilenet_v2()
    theirs.load_state_dict(torch.load(weights, weights_only=True))
    theirs.eval()
    images = torch.rand(2, 3, 64, 96)
    mean = torch.tensor([0.485, 0.456, 0.406]).view(3, 1, 1)
    std = torch.tensor([0.229, 0.224, 0.225]).view(3, 1, 1)
    with torch.no_grad():
        ours = encoder.network(images)
        normalised = (images - mean) / std
        for one, stop in zip(ours, (7, 14), strict=True):
            expected = theirs.features[:stop](normalised)
            torch.testing.assert_close(one, expected, atol=1e-5, rtol=1e-5)
        again = encoder.network(images)
    assert all(torch.equal(a, b) for a, b in zip(ours, again, strict=True))


@pytest.mark.parametrize("frozen", [True, False])
def test_mobilenet_is_trained_only_where_asked(weights: str, frozen: bool) -> None:
    image = {"kind": "mobilenet", "size": (64, 64), "weights": weights}
    policy = tiny("gaussian", image={**image, "frozen": frozen})
    before = {k: v.clone() for k, v in policy.encoder.image.state_dict().items()}
    ppo = ClipPPOLoss(policy, None, entropy_bonus=False, critic_coeff=None)
    loss = CoTrainingLoss(ppo, ImitationLoss(policy), real_coeff=0.2)
    with torch.no_grad():
        td = policy(seen(observations(4)))
    td["advantage"] = torch.randn(4, 1)
    both = TensorDict({"sim": td, "real": seen(demonstrations(policy, 4))})
    optimizer = torch.optim.AdamW(loss.parameters(), 1e-2)
    assert gradient_agreement(loss, both)["grad_norm_real"] > 0
    out = loss(both)
    assert float(out["max_ratio"].detach()) == pytest.approx(1.0, abs=1e-5)
    (out["loss_objective"] + out["loss_bc_real"]).backward()
    optimizer.step()
    after = policy.encoder.image.state_dict()
    moved = {k for k, v in after.items() if not torch.equal(v, before[k])}
    assert any(k.startswith("points") for k in moved)
    assert any(k.startswith("network") for k in moved) is not frozen
    assert not any("running" in k for k in moved)


def test_mobilenets_maps_are_kept_and_not_recomputed(weights: str) -> None:
    image = {"kind": "mobilenet", "size": (64, 64), "weights": weights}
    policy = tiny("gaussian", image=image)
    policy.fix_images()
    with torch.no_grad():
        td = policy(seen(observations(6)))
    images = td[IMAGE]
    batch = td.select(*policy.replay_keys)
    assert IMAGE not in batch
    torch.testing.assert_close(batch[IMAGE_FEATURES], policy.encoder.image(images))
    calls: list[int] = []
    policy.encoder.image.register_forward_hook(lambda *_: calls.append(1))
    batch["vla_action", "log_probs"] = log_probs(policy, batch)
    batch["advantage"] = torch.randn(6, 1)
    before = {k: v.clone() for k, v in policy.encoder.image.state_dict().items()}
    loss = ClipPPOLoss(policy, None, entropy_bonus=False, critic_coeff=None)
    out = loss(batch)
    assert float(out["max_ratio"].detach()) == pytest.approx(1.0, abs=1e-5)
    optimizer = torch.optim.AdamW(loss.parameters(), 1e-2)
    out["loss_objective"].backward()
    optimizer.step()
    assert not calls
    after = policy.encoder.image.state_dict()
    assert all(torch.equal(value, before[name]) for name, value in after.items())


def test_a_critic_may_see_too() -> None:
    value = ValueNetwork(3, num_instructions=2, image=CONV, hidden=(8,))
    td = value(seen(observations(5)))
    td["state_value"].sum().backward()
    assert td["state_value"].shape == (5, 1)
    assert all(p.grad is not None for p in value.parameters())


@pytest.mark.parametrize(
    ("image", "error", "message"),
    [
        ({"kind": "resnet"}, UnknownNameError, "unknown image 'resnet'.*conv"),
        ({"size": (32, 64)}, ConfigError, r"image_size=\(32, 64\).* 64 to 224"),
        ({"size": (64, 256)}, ConfigError, r"image_size=\(64, 256\)"),
        ({"kind": "mobilenet"}, ConfigError, "image_weights=mobilenet_v2"),
        (
            {"kind": "mobilenet", "weights": "nowhere.pth"},
            CheckpointError,
            "file of weights 'nowhere.pth' is missing.*image_weights=",
        ),
    ],
)
def test_an_encoder_that_cannot_be_is_refused(
    image: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        tiny("gaussian", image=CONV | image)


def test_weights_that_are_not_mobilenets_are_refused(tmp_path: Path) -> None:
    other, broken = tmp_path / "other.pth", tmp_path / "broken.pth"
    spoiled = tmp_path / "spoiled.pth"
    torch.save({"layer": torch.zeros(2)}, other)
    broken.write_bytes(b"no weights at all")
    weights = mobilenet_v2().state_dict()
    weights["classifier.1.bias"][0] = torch.nan
    torch.save(weights, spoiled)
    for path, words in (
        (other, "no weights of MobileNetV2"),
        (broken, "is truncated or damaged"),
        (spoiled, "classifier.1.bias is nan"),
    ):
        with pytest.raises(CheckpointError, match=f"{words}.*image_weights="):
            ImageEncoder("mobilenet", (64, 64), weights=str(path))


def damaged_weights(folder: Path, weights: Path) -> dict[str, str]:
    """Return what is said of files and the like, by their names in a folder."""
    whole = weights.read_bytes()
    header = b'{"a":{"dtype":"F32","shape":[1000000000],"data_offsets":[0,4000000000]}}'
    state = torch.load(weights, weights_only=True)
    bias = state["classifier.1.bias"]
    for name, content in {
        "text.pth": b"root:x:0:0:root:/root:/bin/bash\n",
        "empty.pth": b"",
        "memo.pth": b"h\x00.",  # of which nothing was put there
        "stack.pth": b"\x80\x02R.",
        "code.pth": pickle.dumps(os.getcwd),
        "cut.pth": whole[: len(whole) // 2],
        "empty.safetensors": b"",
        "text.safetensors": b"no weights at all",
        "more.safetensors": len(header).to_bytes(8, "little") + header,
        "endless.safetensors": (2**62).to_bytes(8, "little") + b"{}",
    }.items():
        (folder / name).write_bytes(content)
    for name, content in {
        "keys.pth": {1: bias, "x" * 10_000: None, **state},
        "tensor.pth": bias,
        "shape.pth": {**state, "classifier.1.bias": bias[:3]},
        "integers.pth": {**state, "classifier.1.bias": bias.long()},
        "sparse.pth": {**state, "classifier.1.bias": bias.to_sparse()},
        "meta.pth": {**state, "classifier.1.bias": bias.to("meta")},
    }.items():
        torch.save(content, folder / name)
    with zipfile.ZipFile(folder / "other.pth", "w") as archive:
        archive.writestr("a/readme.txt", "no weights")
    with zipfile.ZipFile(folder / "bomb.pth", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a/data.pkl", bytes(300 * 2**20))
    (folder / "folder.pth").mkdir()
    os.mkfifo(folder / "pipe.pth")
    told = dict.fromkeys((file.name for file in folder.iterdir()), "or damaged")
    others = ("keys", "tensor", "shape", "integers", "sparse", "meta")
    told |= {f"{name}.pth": "holds no weights of MobileNetV2" for name in others}
    return told | {
        "code.pth": "something else than tensors",
        "bomb.pth": "declares 314.6 MB",
        "folder.pth": "cannot be read",
        "pipe.pth": "is no file",
        "/dev/zero": "is no file",
    }


def test_a_damaged_file_of_weights_is_told_in_one_sentence(
    tmp_path: Path, weights: str
) -> None:
    for name, words in damaged_weights(tmp_path, Path(weights)).items():
        with pytest.raises(RlcoError, match=words) as caught:
            ImageEncoder("mobilenet", (64, 64), weights=str(tmp_path / name))
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 500


def test_mobilenet_never_works_with_weights_drawn_at_random(weights: str) -> None:
    images = torch.zeros(1, 3, 64, 64, dtype=torch.uint8)
    bare = ImageEncoder("mobilenet", (64, 64), weights="saved")
    with pytest.raises(CheckpointError, match="has no weights"):
        bare(images)
    whole = ImageEncoder("mobilenet", (64, 64), weights=weights)
    bare.load_state_dict(whole.state_dict())
    assert torch.equal(bare(images), whole(images))
    policy = tiny("gaussian", image=CONV)
    policy.encoder.image = whole
    policy.reset_parameters_recursive()
    with pytest.raises(CheckpointError, match="drawn anew"):
        whole(images)


def test_pictures_of_another_size_or_type_are_refused() -> None:
    policy = tiny("gaussian", image=CONV)
    td = observations(2)
    with pytest.raises(DataError, match=r"\('observation', 'image'\)"):
        policy(td)
    with pytest.raises(DataError, match=r"\(3, 96, 96\).*image_size=\(64, 64\)"):
        policy(seen(td, (96, 96)))
    with pytest.raises(DataError, match=r"float32.*uint8"):
        policy(td.set(IMAGE, torch.zeros(2, 3, 64, 64)))
