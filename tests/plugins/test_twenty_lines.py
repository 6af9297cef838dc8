"""The README's and the documentation's way in and out, run on a tiny checkpoint."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import torch
from safetensors.torch import load_file
from vla_files import record, tiny_with_statistics

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "docs" / "co_train_lerobot.py"


def load_script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("co_train_lerobot", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_checkpoint_is_loaded_co_trained_and_saved_back(tmp_path: Path) -> None:
    source = tiny_with_statistics(tmp_path / "tiny")
    demos = record(tmp_path / "demos")
    saved = load_script().co_train(
        source, demos, tmp_path / "out", iterations=1, num_envs=2
    )
    before, after = (load_file(path / "model.safetensors") for path in (source, saved))
    assert before.keys() == after.keys()
    moved = {name for name in before if not torch.equal(before[name], after[name])}
    assert any(".lm_expert." in name for name in moved)
    assert not any(".vlm." in name for name in moved)


def test_the_documentation_shows_what_is_run() -> None:
    shown = (ROOT / "docs" / "vla.md").read_text("utf-8")
    body = SCRIPT.read_text("utf-8").split("def co_train", 1)[1]
    assert body in shown


def test_the_readme_shows_what_is_run() -> None:
    readme = (ROOT / "README.md").read_text("utf-8")
    (shown,) = [b for b in readme.split("```python\n") if b.startswith("checkpoint =")]
    code = SCRIPT.read_text("utf-8").split("def co_train", 1)[1].splitlines()[2:]
    run = [line.removeprefix("    ").removeprefix("return ") for line in code]
    assert shown.split("```", 1)[0].splitlines() == run
