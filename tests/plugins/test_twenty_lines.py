"""The README's and the documentation's way in and out, run on a tiny checkpoint."""

from __future__ import annotations

import importlib.util
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch
from safetensors.torch import load_file
from vla_files import record, tiny_with_statistics

from rlco.data import load_demos
from rlco.errors import NoSignalError
from rlco.physics.tasks.make_task import make_task
from rlco.policies.vla.lerobot.checkpoint import load_lerobot
from rlco.policies.vla.lerobot.policy import LeRobotPolicy
from rlco.training import MasterWeightAdamW

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "docs" / "co_train_lerobot.py"


def load_script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("co_train_lerobot", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script, with shorter episodes."""
    module = load_script()
    monkeypatch.setattr(module, "make_env", partial(module.make_env, horizon=8))
    return module


def test_a_checkpoint_is_loaded_co_trained_and_saved_back(
    script: ModuleType, tmp_path: Path
) -> None:
    source = tiny_with_statistics(tmp_path / "tiny")
    demos = record(tmp_path / "demos")
    saved = script.co_train(source, demos, tmp_path / "out", iterations=1, num_envs=2)
    before, after = (load_file(path / "model.safetensors") for path in (source, saved))
    assert before.keys() == after.keys()
    moved = {name for name in before if not torch.equal(before[name], after[name])}
    assert any(".lm_expert." in name for name in moved)
    assert not any(".vlm." in name for name in moved)


def test_the_policy_learns_slowly_and_what_is_new_beside_it_fast(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []

    class Seen(MasterWeightAdamW):
        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            made.append(self)

    monkeypatch.setattr(script, "MasterWeightAdamW", Seen)
    source = tiny_with_statistics(tmp_path / "tiny")
    demos = record(tmp_path / "demos")
    script.co_train(source, demos, tmp_path / "out", iterations=1, num_envs=2)
    (optimizer,) = made
    rates = [group["lr"] for group in optimizer.param_groups]
    assert rates == [4e-6, 2e-4]
    moved = [
        {tuple(p.shape) for p in group["params"] if p in optimizer.state}
        for group in optimizer.param_groups
    ]
    # The critic's first layer reads a summary, the noise's last one makes 32 numbers.
    assert {(512, 48), (32, 64)} <= moved[1]
    assert not {(512, 48), (32, 64)} & moved[0]


def test_no_success_at_all_is_said_before_training(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sparse = partial(script.make_env, reward="sparse")
    monkeypatch.setattr(script, "make_env", sparse)
    source = tiny_with_statistics(tmp_path / "tiny")
    demos = record(tmp_path / "demos")
    with pytest.raises(NoSignalError):
        script.co_train(source, demos, tmp_path / "out", iterations=1, num_envs=2)
    assert not (tmp_path / "out").exists()


def test_stage_one_imitates_both_kinds_of_data(tmp_path: Path) -> None:
    source = tiny_with_statistics(tmp_path / "tiny")
    demos = record(tmp_path / "sim"), record(tmp_path / "real")
    saved = load_script().imitate(source, *demos, tmp_path / "out", updates=30)
    texts = make_task("push_cube").instructions

    def error(folder: Path) -> float:
        policy = LeRobotPolicy(load_lerobot(folder), instructions=texts)
        frames = load_demos(demos[0], chunk=policy.chunk, instructions=texts)[:]
        torch.manual_seed(0)
        with torch.no_grad():
            losses = [policy.imitation_loss(frames).mean() for _ in range(8)]
        return float(torch.stack(losses).mean())

    assert error(saved) < 0.95 * error(source)


def test_the_documentation_shows_what_is_run() -> None:
    shown = (ROOT / "docs" / "vla.md").read_text("utf-8")
    imitate, co_train = SCRIPT.read_text("utf-8").split("def ")[1:]
    assert imitate.strip() in shown
    assert co_train in shown


def test_the_readme_shows_what_is_run() -> None:
    readme = (ROOT / "README.md").read_text("utf-8")
    (shown,) = [b for b in readme.split("```python\n") if b.startswith("checkpoint =")]
    code = SCRIPT.read_text("utf-8").split("def co_train", 1)[1].splitlines()[2:]
    run = [line.removeprefix("    ").removeprefix("return ") for line in code]
    assert shown.split("```", 1)[0].splitlines() == run
