"""A LeRobot checkpoint in, co-trained, and out again, through stock commands."""

from __future__ import annotations

import csv
import importlib
import json
import logging
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from lerobot.scripts import lerobot_eval, lerobot_train
from lerobot_policy_rlco.export import export_policy
from safetensors.torch import load_file
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type
from vla_files import record, tiny_with_statistics

from rlco.physics.tasks.gymnasium_env import TaskEnv
from rlco.physics.tasks.make_task import make_task
from rlco.policies import make_policy, save_policy, task_sizes
from rlco.reporting.paired_results import read_evaluation
from rlco.run import run_recipe

pytestmark = pytest.mark.slow

RECIPES = Path(__file__).parents[2] / "recipes"


@pytest.fixture(autouse=True)
def offline(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No network; LeRobot's commands leave the loggers as they were."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    root = logging.getLogger()
    handlers, level = list(root.handlers), root.level
    yield
    root.handlers[:], root.level = handlers, level


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_with_statistics(tmp_path_factory.mktemp("tiny"))


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("data") / "real")


@pytest.fixture(scope="module")
def trained(tiny: Path, real: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Co-train for two rollouts; return LeRobot's folder of the last."""
    out = tmp_path_factory.mktemp("run") / "co_train"
    sys.path.insert(0, str(RECIPES))
    recipe: Any = importlib.import_module("lerobot_co_train")
    arguments = ["config=debug", f"policy={tiny}", f"real_demos={real}", "lr=1e-3"]
    run_recipe(recipe.main, recipe.Config, [*arguments, f"out={out}"])
    last = out / "lerobot" / "checkpoints" / "last"
    return last.resolve() / "pretrained_model"  # resuming moves the link


def command(monkeypatch: pytest.MonkeyPatch, module: Any, *arguments: str) -> None:
    """Run one of LeRobot's commands in this process."""
    monkeypatch.setattr(sys, "argv", [module.__name__, *arguments])
    module.main()


def test_the_type_the_names_and_the_statistics_stay(tiny: Path, trained: Path) -> None:
    before, after = (
        json.loads((path / "config.json").read_text()) for path in (tiny, trained)
    )
    assert after["type"] == before["type"] == "smolvla"
    for file in sorted(tiny.glob("*processor*.safetensors")):
        old, new = load_file(file), load_file(trained / file.name)
        assert old.keys() == new.keys()
        assert all(torch.equal(old[name], new[name]) for name in old)
    old, new = (load_file(path / "model.safetensors") for path in (tiny, trained))
    assert old.keys() == new.keys()
    moved = {name for name in old if not torch.equal(old[name], new[name])}
    assert moved
    assert not any(".vlm." in name or "state_proj" in name for name in moved)
    beside = {file.name for file in (trained.parent / "rlco_state").iterdir()}
    assert beside == {"critic.safetensors", "noise.safetensors"}


def test_it_is_told_how_hard_the_anchor_pulls(trained: Path) -> None:
    run = trained.parents[3]
    with (run / "metrics.csv").open() as file:
        told = [row for row in csv.DictReader(file) if row["first_ratio"]]
    assert len(told) == 2
    for row in told:
        ratio = float(row["grad_norm_real"]) / float(row["grad_norm_sim"])
        assert float(row["grad_norm_ratio"]) == pytest.approx(ratio)
        assert ratio > 0
        assert -1 <= float(row["grad_cosine"]) <= 1


def test_stock_lerobot_eval_runs_it(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command(
        monkeypatch,
        lerobot_eval,
        f"--policy.path={trained}",
        "--env.type=rlco",
        "--env.task=push_cube",
        "--env.camera=front",
        "--env.image_size=64",
        "--env.horizon=6",
        "--eval.n_episodes=2",
        "--eval.batch_size=2",
        "--eval.use_async_envs=false",
        f"--output_dir={tmp_path}",
    )
    told = json.loads((tmp_path / "eval_info.json").read_text())
    assert told["overall"]["n_episodes"] == 2
    assert len(told["overall"]["video_paths"]) == 2
    # Its file compares with itself, and its episodes are counted.
    (row,) = read_evaluation(tmp_path).rows
    (task,) = told["per_task"]
    assert row["outcomes"] == [int(x) for x in task["metrics"]["successes"]]
    assert row["episodes"] == 2


def test_stock_lerobot_eval_runs_a_small_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = make_task("push_cube")
    torch.manual_seed(0)
    policy = make_policy("gaussian", chunk=4, hidden=(8,), **task_sizes(task))
    for parameter in policy.parameters():
        torch.nn.init.normal_(parameter, 0.0, 0.3)
    save_policy(policy, tmp_path / "ours", extra=task.description())
    path = export_policy(tmp_path / "ours", tmp_path / "theirs", executed=2)
    command(
        monkeypatch,
        lerobot_eval,
        f"--policy.path={path}",
        "--env.type=rlco",
        "--env.task=push_cube",
        "--env.horizon=4",
        "--eval.n_episodes=1",
        "--eval.batch_size=1",
        "--eval.use_async_envs=false",
        "--seed=5",
        f"--output_dir={tmp_path / 'told'}",
    )
    told = json.loads((tmp_path / "told" / "eval_info.json").read_text())
    # What the policy earns in the task itself, two steps of each chunk of four.
    episode = TaskEnv(task, horizon=4)
    observation, info = episode.reset(seed=5)
    earned = 0.0
    for _ in range(2):
        seen = {"state": "agent_pos", "environment_state": "environment_state"}
        td = TensorDict(
            {
                "observation": {
                    ours: torch.as_tensor(observation[theirs]).float().unsqueeze(0)
                    for ours, theirs in seen.items()
                },
                "instruction_id": torch.tensor([info["instruction_id"]]),
            },
            [1],
        )
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            chunk = policy(td)["action"][0].numpy()
        for action in chunk[:2]:
            observation, reward, _, _, info = episode.step(action)
            earned += float(reward)
    assert told["overall"]["avg_sum_reward"] == pytest.approx(earned, rel=1e-5)
    assert earned != 0


def test_stock_lerobot_train_resumes_it(
    trained: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    command(
        monkeypatch,
        lerobot_train,
        f"--config_path={trained / 'train_config.json'}",
        "--resume=true",
        "--steps=4",
        "--batch_size=4",
        "--num_workers=0",
        "--save_freq=2",
        "--wandb.enable=false",
        "--policy.push_to_hub=false",
    )
    before, after = trained.parent, trained.parents[1] / "000004"
    step = json.loads((after / "training_state" / "training_step.json").read_text())
    assert step["step"] == 4
    # Its optimiser went on with our moments: as many steps behind them as both did.
    ours, theirs = (
        load_file(path / "training_state" / "optimizer_state.safetensors")
        for path in (before, after)
    )
    counts = {name for name in ours if name.endswith("/step")}
    assert counts
    assert all(float(theirs[n]) == float(ours[n]) + 2 for n in counts)
