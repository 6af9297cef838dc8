"""What the first edition wrote is read, and means what it did; see README.md."""

from __future__ import annotations

import importlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rlco.data import load_demos
from rlco.envs import make_env
from rlco.physics.effects import AppliedEffect
from rlco.policies import load_policy
from rlco.policies.vla.lerobot.checkpoint import load_lerobot
from rlco.policies.vla.lerobot.export import load_beside
from rlco.reporting.report import write_report
from rlco.runs.metrics import read_metrics

pytestmark = pytest.mark.slow

HERE = Path(__file__).parent
RECIPES = HERE.parents[1] / "recipes"
EXPECTED: dict[str, Any] = json.loads((HERE / "expected.json").read_text())
STATE = torch.tensor(EXPECTED["observation"]["state"])
PIXELS = (torch.arange(3 * 64 * 64) % 251).reshape(1, 3, 64, 64)


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """Return a copy: its runs name their inputs by paths relative to it."""
    path = tmp_path / "first_edition"
    shutil.copytree(HERE, path, ignore=shutil.ignore_patterns("*.py", "__pycache__"))
    return path


def assert_as_written(actions: torch.Tensor, name: str, *, atol: float = 1e-6) -> None:
    written = torch.tensor(EXPECTED["actions"][name])
    assert written.abs().max() > 0.01
    torch.testing.assert_close(actions, written, atol=atol, rtol=1e-6)


@pytest.mark.parametrize("name", ["gaussian", "token", "flow", "gaussian_image"])
def test_a_policy_acts_as_it_did(name: str) -> None:
    policy, extra = load_policy(HERE / "policies" / name)
    given = {k: torch.tensor(v) for k, v in EXPECTED["observation"].items()}
    row = TensorDict(
        {
            "observation": {
                "state": given["state"],
                "environment_state": given["environment_state"],
                "image": PIXELS.to(torch.uint8),
            },
            "instruction_id": given["instruction_id"],
        },
        [1],
    )
    torch.manual_seed(0)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        assert_as_written(policy(row)["action"], name)
    assert extra["task"] == "push_cube"


@pytest.mark.thorough
@pytest.mark.parametrize(("recipe", "step"), [("sft", 10), ("rl_co", 3)])
def test_a_run_that_was_killed_is_resumed_to_its_end(
    recipe: str, step: int, copied: Path
) -> None:
    run = copied / "runs" / recipe
    before = read_metrics(run / "metrics.csv")
    assert before[-1]["step"] == step
    subprocess.run(
        [sys.executable, str(RECIPES / f"{recipe}.py"), f"resume=runs/{recipe}"],
        cwd=copied,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        check=True,
    )
    # As the run that was never stopped.
    whole = read_metrics(copied / "whole" / f"{recipe}.csv")
    resumed = read_metrics(run / "metrics.csv")
    assert len(resumed) == len(whole) > step
    # There are more columns now; what was written stays.
    for row, written in zip(resumed, before, strict=False):
        assert {name: row[name] for name in written} == written
    for row, expected in zip(resumed, whole, strict=True):
        known = {name: row[name] for name in expected}
        assert known == pytest.approx(expected, rel=1e-3, abs=1e-4)
    policy, _ = load_policy(run / "policy")
    assert policy.chunk == 4
    assert json.loads((run / "run.json").read_text())["status"] == "finished"


def state_with(effects: Any) -> torch.Tensor:
    """Return the tool's state after half a second of moving to and fro."""
    env = make_env("push_cube", effects=effects, seed=0)
    td = env.reset()
    for step in range(10):
        action = torch.tensor([0.5, -0.3, 0.2, 0.1, 0.0, -0.2, 1.0])
        td["action"] = (action * (-1) ** (step // 5)).expand(1, 1, 7)
        td = env.step(td)["next"]
    state: torch.Tensor = td["observation", "state"]
    return state


def test_effects_do_what_they_did() -> None:
    rows: list[tuple[str, str | None, dict[str, float]]] = [
        ("stribeck_friction", "joint2", {"static": 9.0, "speed": 0.2}),
        ("viscous_damping", "joint4", {"damping": 30.0}),
        ("command_delay", None, {"delay": 0.13}),
        ("actuator_lag", "joint2", {"time_constant": 0.02}),
        ("joint_offset", "joint4", {"offset": 0.05}),  # called elbow in the file
        ("payload", "right_hand", {"mass": 1.5, "x": 0.0, "y": 0.02, "z": 0.1}),
        ("contact_friction", None, {"friction": 0.2}),
    ]
    found = state_with(HERE / "effects.yaml")
    assert torch.equal(found, state_with([AppliedEffect(*row) for row in rows]))
    written = torch.tensor(EXPECTED["state_with_effects"])
    # Without one of them it would be another by more than 1e-5, but for the cube's
    # friction: nothing touches the cube.
    torch.testing.assert_close(found, written, atol=1e-6, rtol=1e-6)


def test_results_are_reported(copied: Path) -> None:
    text = write_report(copied / "runs" / "finished").read_text()
    assert "sft solves push_cube in 25 % of episodes in stand_in" in text
    for counted in ("0 of 16", "4 of 16"):
        assert counted in text


def test_demonstrations_are_read() -> None:
    frames = {"sim": 102, "stand_in": 136}
    for name, count in frames.items():
        assert len(load_demos(HERE / "demos" / name, chunk=4).frames()) == count


def test_an_exported_policy_acts_under_lerobot_as_it_did() -> None:
    importlib.import_module("lerobot_policy_rlco")  # it registers its type

    path = HERE / "exports" / "rlco"
    config = PreTrainedConfig.from_pretrained(path)
    policy = get_policy_class("rlco").from_pretrained(path, config=config)
    pre, post = make_pre_post_processors(config, pretrained_path=str(path))
    given = EXPECTED["observation"]
    batch = {
        "observation.state": STATE,
        "observation.environment_state": torch.tensor(given["environment_state"]),
        "task": [config.instructions[given["instruction_id"][0]]],
    }
    # The folder is that of the policy that the recipe trained.
    assert_as_written(post(policy.predict_action_chunk(pre(batch))), "gaussian")


def test_a_checkpoint_of_lerobots_acts_as_it_did() -> None:
    folder = HERE / "exports" / "smolvla"
    path = folder / "pretrained_model"
    checkpoint = load_lerobot(
        path, action_size=7, state_size=7, tokenizer=folder / "vlm"
    )
    batch = checkpoint.preprocessor(
        {
            "observation.state": STATE,
            "observation.images.front": PIXELS.float() / 255,
            "task": ["push the cube"],
        }
    )
    noise = torch.linspace(-1, 1, 32).reshape(1, 4, 8)
    actions = checkpoint.model.policy.predict_action_chunk(batch, noise=noise)
    assert_as_written(checkpoint.postprocessor(actions), "smolvla", atol=1e-5)
    assert checkpoint.training is not None
    assert load_beside(path, "noise")
