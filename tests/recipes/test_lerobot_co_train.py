"""Stage II on a LeRobot checkpoint: what it refuses, and that it can be resumed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
from recipe_cases import refused, start
from safetensors.torch import load_file

from rlco.policies.tiny.smolvla import write_tiny_smolvla

RECIPE = "lerobot_co_train"


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_tiny_smolvla(tmp_path_factory.mktemp("tiny"))


def test_a_resumed_run_equals_an_uninterrupted_one(tiny: Path, tmp_path: Path) -> None:
    options = ["config=debug", f"policy={tiny}", "real_coeff=0", "eval_episodes=0"]
    options += ["horizon=8", "lr=1e-3"]
    whole, part = tmp_path / "whole", tmp_path / "part"
    start(RECIPE, *options, "iterations=2", f"out={whole}")
    start(RECIPE, *options, "iterations=1", f"out={part}")
    start(RECIPE, f"resume={part}", "iterations=2")
    metrics = [(path / "metrics.csv").read_bytes() for path in (whole, part)]
    assert metrics[0] == metrics[1]
    weights = [
        load_file(path / "lerobot/checkpoints/last/pretrained_model/model.safetensors")
        for path in (whole, part)
    ]
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])
    start_weights = load_file(tiny / "model.safetensors")
    assert any(not torch.equal(v, weights[0][k]) for k, v in start_weights.items())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["policy=nowhere", "real_coeff=0"], "has no config.json"),
        (["policy={tiny}"], "real_coeff=0.2 needs real_demos=FOLDER"),
        (["policy={tiny}", "real_coeff=0", "task=push_cub"], "unknown task"),
        (["policy={tiny}", "real_coeff=0", "camera=observation.images.wrist"], "front"),
        (["policy={tiny}", "real_demos=nowhere"], "nowhere"),
    ],
)
def test_wrong_input_ends_with_one_sentence(
    tiny: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    message: str,
) -> None:
    given = [option.format(tiny=tiny) for option in options]
    out = tmp_path / "out"
    assert message in refused(capsys, RECIPE, *given, f"out={out}")
    assert not out.exists()


def test_gradient_checkpointing_is_refused_before_a_run_is_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from rlco.policies.tiny.pi05 import write_tiny_pi05

    folder = write_tiny_pi05(tmp_path / "pi05")
    file = folder / "config.json"
    raw = json.loads(file.read_text()) | {"gradient_checkpointing": True}
    file.write_text(json.dumps(raw))
    out = tmp_path / "out"
    told = refused(capsys, RECIPE, f"policy={folder}", "real_coeff=0", f"out={out}")
    assert "gradient_checkpointing=false" in told
    assert not out.exists()
