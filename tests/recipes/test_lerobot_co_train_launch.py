"""Stage II on a LeRobot checkpoint in two processes that learn together."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from rank_cases import Found, in_two_ranks, next_group
from recipe_cases import refused, start
from safetensors.torch import load_file

from rlco.data import DemoWriter
from rlco.physics.spec.names import ACTION_NAMES, STATE_NAMES
from rlco.physics.tasks.make_task import make_task
from rlco.policies.tiny.smolvla import write_tiny_smolvla
from rlco.runs.metrics import read_metrics

pytestmark = pytest.mark.slow

RECIPE = "lerobot_co_train"
WEIGHTS = "lerobot/checkpoints/last/pretrained_model/model.safetensors"


def write_demos(folder: Path) -> Path:
    """Write two short demonstrations with the images that the checkpoint reads."""
    rng = np.random.default_rng(0)
    with DemoWriter(
        folder,
        fps=20,
        state_names=STATE_NAMES,
        action_names=ACTION_NAMES,
        camera="front",
        image_size=(64, 64),
    ) as writer:
        for _ in range(2):
            for _ in range(6):
                writer.add_frame(
                    state=rng.uniform(-1, 1, 7).astype(np.float32),
                    action=rng.uniform(-1, 1, 7).astype(np.float32),
                    image=rng.integers(256, size=(3, 64, 64)).astype(np.uint8),
                    task=make_task("push_cube").instructions[0],
                )
            writer.save_episode()
    return folder


def learn(given: list[str], folder: Path) -> dict[str, Any]:
    """Train in two ranks; train anew, and go on with that in two ranks again."""
    start(RECIPE, *given, "iterations=2", f"out={folder / 'whole'}")
    next_group()
    start(RECIPE, *given, "iterations=1", f"out={folder / 'part'}")
    next_group()
    start(RECIPE, f"resume={folder / 'part'}", "iterations=2")
    return {}


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("inputs")
    demos = write_demos(folder / "demos")
    tiny = write_tiny_smolvla(folder / "tiny")
    return [
        *("config=debug", f"policy={tiny}", f"real_demos={demos}"),
        *("trained=lora", "lora_rank=2", "horizon=8", "lr=1e-3", "eval_episodes=0"),
    ]


@pytest.fixture(scope="module")
def learned(
    given: list[str], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Found, Path]:
    folder = tmp_path_factory.mktemp("learned")
    options = [*given, "launch=torchrun"]
    return in_two_ranks(learn, folder, options, folder, groups=3), folder


@pytest.mark.thorough
def test_two_ranks_write_one_run_of_the_frames_of_both(
    learned: tuple[Found, Path], given: list[str], tmp_path: Path
) -> None:
    _, folder = learned
    runs = sorted(path.name for path in folder.iterdir() if path.is_dir())
    assert runs == ["part", "whole"]
    rows = read_metrics(folder / "whole" / "metrics.csv")
    start(RECIPE, *given, "iterations=1", f"out={tmp_path / 'alone'}")
    alone = read_metrics(tmp_path / "alone" / "metrics.csv")
    assert [row["frames"] for row in rows[:2]] == [row["frames"] for row in alone]
    assert rows[1]["first_ratio"] == pytest.approx(1, abs=1e-5)
    assert rows[1]["loss_bc_real"] > 0


@pytest.mark.thorough
def test_ranks_resume_to_what_they_would_have_come_to(
    learned: tuple[Found, Path], given: list[str]
) -> None:
    _, folder = learned
    whole, part = folder / "whole", folder / "part"
    assert (whole / "metrics.csv").read_bytes() == (part / "metrics.csv").read_bytes()
    weights = [load_file(run / WEIGHTS) for run in (whole, part)]
    before = load_file(Path(given[1].partition("=")[2]) / "model.safetensors")
    assert all(torch.equal(weights[0][k], weights[1][k]) for k in before)
    assert any(not torch.equal(value, weights[0][k]) for k, value in before.items())


def test_what_torchrun_did_not_start_is_refused_before_the_weights_are_read(
    given: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    said = refused(capsys, RECIPE, *given, "launch=torchrun", f"out={out}")
    assert "torchrun --nproc-per-node=2 recipes/lerobot_co_train.py" in said
    assert "launch" in refused(capsys, RECIPE, *given, "launch=ray", f"out={out}")
    assert not out.exists()
