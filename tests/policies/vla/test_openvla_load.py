"""OpenVLA's published names, against a second implementation of their networks."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file
from torch.nn import functional
from vla_cases import folder, rows

from rlco.errors import CheckpointError, NonFiniteError, UnknownNameError
from rlco.policies.vla.lora import add_lora
from rlco.policies.vla.openvla.config import (
    VISION,
    OpenVLAConfig,
    action_range,
    read_config,
)
from rlco.policies.vla.openvla.load import load_openvla, save_openvla
from rlco.policies.vla.openvla.model import OpenVLA
from rlco.policies.vla.openvla.weight_names import is_unused, to_native, vision_table

Weights = dict[str, torch.Tensor]


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    path = tmp_path / "openvla"
    shutil.copytree(folder("openvla", action_size=7), path)
    return path


def rewrite(path: Path, change: Callable[[Weights], object]) -> None:
    weights = load_file(path / "model.safetensors")
    change(weights)
    save_file(weights, path / "model.safetensors")


def timm_patches(weights: Weights, prefix: str, pixels: torch.Tensor) -> torch.Tensor:
    """Compute timm's vision transformer from its weights, to the second-last block."""
    w = {k.removeprefix(f"{prefix}."): v for k, v in weights.items()}
    x = functional.conv2d(
        pixels, w["patch_embed.proj.weight"], w["patch_embed.proj.bias"], stride=14
    )
    x = x.flatten(2).transpose(1, 2) + w["pos_embed"]
    extra = 0
    if "cls_token" in w:
        first = torch.cat([w["cls_token"], w["reg_token"]], 1)
        extra = first.shape[1]
        x = torch.cat([first.expand(len(x), -1, -1), x], 1)

    def normed(x: torch.Tensor, name: str) -> torch.Tensor:
        size = (x.shape[-1],)
        weight, bias = w[f"{name}.weight"], w[f"{name}.bias"]
        return functional.layer_norm(x, size, weight, bias, 1e-6)

    def linear(x: torch.Tensor, name: str) -> torch.Tensor:
        return functional.linear(x, w[f"{name}.weight"], w[f"{name}.bias"])

    for block in ("blocks.0", "blocks.1"):
        one = torch.ones(())
        qkv = linear(normed(x, f"{block}.norm1"), f"{block}.attn.qkv")
        q, k, v = qkv.unflatten(-1, (3, 2, -1)).permute(2, 0, 3, 1, 4)
        mixed = functional.scaled_dot_product_attention(q, k, v)
        mixed = linear(mixed.transpose(1, 2).flatten(2), f"{block}.attn.proj")
        x = x + mixed * w.get(f"{block}.ls1.scale_factor", one)
        inner = linear(normed(x, f"{block}.norm2"), f"{block}.mlp.fc1")
        inner = linear(functional.gelu(inner), f"{block}.mlp.fc2")
        x = x + inner * w.get(f"{block}.ls2.scale_factor", one)
    return x[:, extra:]


def test_published_weights_mean_in_transformers_what_they_mean_in_timm() -> None:
    path = folder("openvla", action_size=7)
    weights = load_file(path / "model.safetensors")
    # Scales of 1 would hide a wrong place.
    for name, value in weights.items():
        if name.endswith(("scale_factor", "norm1.weight", "cls_token")):
            value.add_(torch.randn(value.shape, generator=torch.Generator()) * 0.3)
    model = load_openvla(path, dtype=torch.float32)
    native = {}
    for name, entry in vision_table(model.config).items():
        native |= to_native(entry, weights[name])
    model.load_state_dict(native, strict=False)
    images = rows(2)["observation", "image"]
    pixels = images.float() / 255
    pixels = functional.interpolate(
        pixels, (28, 28), mode="bicubic", antialias=True, align_corners=False
    ).clamp(0, 1)
    views = [
        (pixels - m[:, None, None]) / s[:, None, None]
        for m, s in zip(model.means, model.stds, strict=True)
    ]
    features = torch.cat(
        [
            timm_patches(weights, "vision_backbone.featurizer", views[0]),
            timm_patches(weights, "vision_backbone.fused_featurizer", views[1]),
        ],
        -1,
    )
    for layer in ("fc1", "fc2", "fc3"):
        weight, bias = (weights[f"projector.{layer}.{k}"] for k in ("weight", "bias"))
        features = functional.linear(features, weight, bias)
        features = functional.gelu(features) if layer != "fc3" else features
    with torch.no_grad():
        ours = model.see(images)
    torch.testing.assert_close(ours, features, atol=1e-5, rtol=1e-4)


def test_openvla_7b_has_as_many_weights_as_are_published() -> None:
    config = OpenVLAConfig(
        dinov2=VISION["vit_large_patch14_reg4_dinov2.lvd142m"],
        siglip=VISION["vit_so400m_patch14_siglip_224"],
        image_size=224,
        text={"vocab_size": 32064, "pad_token_id": 32000},
        vocabulary=32000,
    )
    table = vision_table(config)
    # 23 of DINOv2's 24 blocks with 14 weights each, and 5 outside them; 26 of
    # SigLIP's 27 with 12 each, and 3; 6 of the projector.
    assert len(table) == 23 * 14 + 5 + 26 * 12 + 3 + 6
    with torch.device("meta"):
        model = OpenVLA(config)
    ours = set(model.state_dict()) - {"dinov2.embeddings.mask_token"}
    named = {name for entry in table.values() for name in entry.native}
    assert {n for n in ours if not n.startswith("language_model.")} == named
    assert "language_model.model.layers.31.mlp.down_proj.weight" in ours
    count = sum(p.numel() for p in model.parameters())
    assert count == pytest.approx(7.5e9, rel=0.01)
    assert is_unused("vision_backbone.featurizer.blocks.23.attn.qkv.weight", config)
    assert not is_unused(
        "vision_backbone.featurizer.blocks.22.ls1.scale_factor", config
    )
    assert is_unused("vision_backbone.fused_featurizer.attn_pool.latent", config)


def test_a_saved_model_loads_equal_and_keeps_what_was_not_used(tmp_path: Path) -> None:
    base = folder("openvla", action_size=7)
    model = load_openvla(base, dtype=torch.float32)
    add_lora(model, [model], rank=2)
    torch.manual_seed(0)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(torch.randn_like(parameter) * 0.2)
    quantiles = {"q01": [-3.0] * 7, "q99": [3.0] * 7}
    saved = tmp_path / "saved"
    save_openvla(model, saved, base=base, norm_stats={"mine": {"action": quantiles}})
    again = load_openvla(saved, dtype=torch.float32)
    td = rows(2)
    inputs = td["observation", "image"], torch.arange(8).expand(2, 8)
    inputs = (*inputs, torch.ones(2, 8, dtype=torch.bool), torch.full((2, 3), 600))
    with torch.no_grad():
        expected, found = (each.states(*inputs) for each in (model, again))
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)
    original = load_openvla(base, dtype=torch.float32).states(*inputs)
    assert not torch.allclose(original, expected, atol=1e-2)
    assert again.config.norm_stats.keys() == {"tiny", "mine"}
    before = load_file(base / "model.safetensors")
    after = load_file(saved / "model.safetensors")
    assert before.keys() == after.keys()
    unused = "vision_backbone.fused_featurizer.attn_pool.latent"
    assert torch.equal(before[unused], after[unused])
    assert (saved / "tokenizer.json").is_file()


def test_weights_spread_over_several_files_are_one_model(copied: Path) -> None:
    whole = load_openvla(copied, dtype=torch.float32)
    weights = load_file(copied / "model.safetensors")
    (copied / "model.safetensors").unlink()
    names = sorted(weights)
    for i, part in enumerate((names[::2], names[1::2])):
        file = copied / f"model-0000{i + 1}-of-00002.safetensors"
        save_file({name: weights[name] for name in part}, file)
    split = load_openvla(copied, dtype=torch.float32)
    assert all(
        map(torch.equal, whole.state_dict().values(), split.state_dict().values())
    )


def change_shape(weights: Weights) -> None:
    weights["projector.fc1.bias"] = weights["projector.fc1.bias"][:-1].clone()


def spoil(weights: Weights) -> None:
    weights["projector.fc1.bias"][:2] = torch.nan


def test_a_model_that_is_not_finite_is_not_saved(tmp_path: Path) -> None:
    base = folder("openvla", action_size=7)
    model = load_openvla(base)
    model.projector[0].bias.data[3] = torch.inf
    with pytest.raises(NonFiniteError, match=r"projector\.0\.bias is infinite"):
        save_openvla(model, tmp_path / "saved", base=base)
    assert not (tmp_path / "saved").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda w: w.pop("vision_backbone.featurizer.blocks.1.attn.qkv.bias"),
            r"dinov2.encoder.layer.1.attention.attention.query.bias is missing",
        ),
        (
            lambda w: w.pop("language_model.model.layers.0.mlp.up_proj.weight"),
            r"language_model.model.layers.0.mlp.up_proj.weight is missing",
        ),
        (lambda w: w.update(value_head=torch.zeros(1)), "value_head is not expected"),
        (spoil, r"projector.fc1.bias is nan \(2 of 320 "),
        (change_shape, r"projector.fc1.bias has shape \(319,\), expected \(320,\)"),
    ],
)
def test_a_load_that_leaves_a_weight_unset_fails(
    copied: Path, change: Callable[[Weights], object], message: str
) -> None:
    rewrite(copied, change)
    with pytest.raises(CheckpointError, match=message):
        load_openvla(copied)


@pytest.mark.parametrize(
    ("key", "value", "error", "message"),
    [
        ("model_type", "llava", CheckpointError, "'llava', not 'openvla'"),
        ("image_sizes", [28, 14], CheckpointError, r"sizes \[28, 14\]"),
        ("image_sizes", 28, CheckpointError, "'image_sizes' of file .* is 28"),
        ("image_sizes", [[28], [28]], CheckpointError, "not a list of whole numbers"),
        ("model_type", ["openvla"], CheckpointError, "not 'openvla'"),
        ("rlco_vision", 5, CheckpointError, "'rlco_vision' of file .* is 5"),
        ("rlco_vision", [{}, {}], CheckpointError, "lacks 'hidden_size'"),
        ("rlco_vision", [1, 2], CheckpointError, "entry 1 of 'rlco_vision'"),
        ("text_config", [], CheckpointError, "'text_config' of file .* is"),
        ("text_config", {}, CheckpointError, "'text_config' .* lacks 'vocab_size'"),
        ("pad_token_id", "0", CheckpointError, "'pad_token_id' .* not a whole number"),
        ("n_action_bins", None, CheckpointError, "'n_action_bins' .* is None"),
        ("norm_stats", [1], CheckpointError, "'norm_stats' .* not names with values"),
    ],
)
def test_another_model_is_refused(
    copied: Path, key: str, value: object, error: type[Exception], message: str
) -> None:
    file = copied / "config.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {key: value}))
    with pytest.raises(error, match=message):
        read_config(copied)


@pytest.mark.parametrize("text", ["[]", "5", "[" * 100_000, "{", "\xff"])
def test_a_configuration_that_is_none_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "config.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(CheckpointError, match=r"config\.json"):
        read_config(tmp_path)


@pytest.mark.parametrize(
    "change",
    [{"hidden_size": "x"}, {"num_attention_heads": 0}, {"hidden_act": "none"}],
)
def test_sizes_that_make_no_model_are_refused(
    copied: Path, change: dict[str, object]
) -> None:
    file = copied / "config.json"
    raw = json.loads(file.read_text())
    raw["text_config"] |= change
    file.write_text(json.dumps(raw))
    with pytest.raises(CheckpointError, match="make no model that rlco can build"):
        load_openvla(copied)


@pytest.mark.parametrize("ids", [None, 5, [["vit"], ["vit"]]])
def test_image_encoders_that_are_no_names(copied: Path, ids: object) -> None:
    file = copied / "config.json"
    raw = json.loads(file.read_text()) | {"rlco_vision": None, "timm_model_ids": ids}
    file.write_text(json.dumps(raw))
    with pytest.raises(CheckpointError, match="'timm_model_ids' of file"):
        read_config(copied)


@pytest.mark.parametrize(
    "stats",
    [
        5,
        {},
        {"action": {"q01": [0.0]}},
        {"action": {"q01": ["a"], "q99": [1.0]}},
        {"action": {"q01": 0.0, "q99": [1.0]}},
        {"action": {"q01": [0.0], "q99": [1.0], "mask": [True, True]}},
        {"action": {"q01": [0.0], "q99": [1.0], "mask": True}},
    ],
)
def test_statistics_that_are_none_are_refused(stats: object) -> None:
    with pytest.raises(CheckpointError, match="statistics of 'push'"):
        action_range({"push": stats}, None, action_size=1)


def test_other_image_encoders_are_named(copied: Path) -> None:
    file = copied / "config.json"
    raw = json.loads(file.read_text())
    del raw["rlco_vision"]
    raw["timm_model_ids"][1] = "vit_large_patch14_clip_224.openai"
    file.write_text(json.dumps(raw))
    with pytest.raises(UnknownNameError, match="unknown image encoder"):
        read_config(copied)


def test_a_folder_without_weights_says_so(copied: Path) -> None:
    (copied / "model.safetensors").unlink()
    with pytest.raises(CheckpointError, match=r"no \*\.safetensors"):
        load_openvla(copied)
