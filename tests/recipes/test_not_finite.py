"""Training that diverges stops where it does, and none of it is saved or loaded."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from recipe_cases import RL_CO, SFT, Assets, refused, start
from safetensors.torch import load_file, save_file

from rlco.envs import TabletopEnv
from rlco.run import Run
from rlco.runs.metrics import read_metrics
from rlco.runs.state_files import load_state

Capture = pytest.CaptureFixture[str]
WEIGHTS = "policy/policy.safetensors"


def status(folder: Path) -> str:
    """Return what run.json says of how the run ended."""
    info: dict[str, Any] = json.loads((folder / "run.json").read_text())
    return str(info["status"])


def stopped(capsys: Capture, recipe: str, folder: Path, *arguments: str) -> list[str]:
    """Run a recipe that must stop by itself; return its lines on stderr."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as caught:
        start(recipe, *arguments, f"out={folder}")
    assert caught.value.code == 2
    assert status(folder) == "failed"
    assert not (folder / WEIGHTS).exists()
    return capsys.readouterr().err.splitlines()


@pytest.mark.parametrize("value", ["inf", ".inf", "nan", "1e999", "-inf"])
def test_a_learning_rate_that_is_no_number_is_refused_before_anything_is_made(
    inputs: dict[str, list[str]], capsys: Capture, tmp_path: Path, value: str
) -> None:
    given = [*inputs["sft"], f"lr={value}", f"out={tmp_path / 'out'}"]
    assert "option lr: " in refused(capsys, "sft", *given)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", ["gaussian", "token", "flow"])
def test_stage_one_stops_at_the_update_whose_loss_is_not_finite(
    inputs: dict[str, list[str]], capsys: Capture, tmp_path: Path, kind: str
) -> None:
    folder = tmp_path / "run"
    given = [*inputs["sft"], "lr=1e36", f"policy={kind}"]
    (line,) = stopped(capsys, "sft", folder, *given)
    assert "loss_bc" in line
    assert " in update 2" in line
    assert "lower lr" in line
    assert not (folder / "checkpoints").exists()


def test_stage_one_stops_after_a_last_update_that_spoils_the_weights(
    assets: Assets, capsys: Capture, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    rest = [option for option in SFT if not option.startswith("updates")]
    demos = [f"sim_demos={assets.sim}", f"real_demos={assets.real}"]
    # So large that a step in float32 is infinite, after a loss that was not.
    large = ["lr=1e36", "weight_decay=1e36"]
    (line,) = stopped(capsys, "sft", folder, *demos, *rest, "updates=1", *large)
    assert "policy.network.trunk.0.weight" in line
    assert "update 1" in line
    assert not (folder / "checkpoints").exists()


def test_stage_two_keeps_the_last_good_checkpoint(
    inputs: dict[str, list[str]], capsys: Capture, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    # The first rollout trains the critic alone.
    lines = stopped(capsys, "rl_co", folder, *inputs["rl_co"], "lr=1e36")
    # Which of the two is computed from huge weights first depends on the processor.
    assert re.search(r"loss_(objective|bc_real) became (nan|inf)", lines[-1])
    assert "update 2 of the rollout" in lines[-1]
    assert "lower lr" in lines[-1]
    assert "step_0000001.safetensors" in lines[-2]
    (kept,) = (folder / "checkpoints").iterdir()
    assert kept.name == "step_0000001.safetensors"
    weights = load_state(kept)["state"]["policy"]
    assert all(bool(weight.isfinite().all()) for weight in weights.values())
    assert [row["step"] for row in read_metrics(folder / "metrics.csv")] == [0, 1]


def test_a_critic_that_diverges_is_named(
    inputs: dict[str, list[str]], capsys: Capture, tmp_path: Path
) -> None:
    given = [*inputs["rl_co"], "critic_lr=1e36"]
    line = stopped(capsys, "rl_co", tmp_path / "run", *given)[-1]
    assert "loss_critic became " in line
    assert "lower critic_lr" in line


def test_a_reward_that_is_nan_stops_the_rollout_that_it_is_in(
    inputs: dict[str, list[str]],
    capsys: Capture,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    advance = TabletopEnv._advance

    def broken(env: TabletopEnv, actions: Any, steps: Any) -> Any:
        reward, diverged = advance(env, actions, steps)
        if env._episode[0] == 3 and env._elapsed[0] == 20:  # episode 2, decision 5
            reward[1] = float("nan")
        return reward, diverged

    monkeypatch.setattr(TabletopEnv, "_advance", broken)
    folder = tmp_path / "run"
    line = stopped(capsys, "rl_co", folder, *inputs["rl_co"])[-1]
    for word in ("'reward'", "1 of 2", "environment 1", "decision 5", "rollout 2"):
        assert word in line, line
    assert "lower" not in line
    assert [row["step"] for row in read_metrics(folder / "metrics.csv")] == [0, 1]


@pytest.mark.parametrize("recipe", ["rl_co", "evaluate"])
def test_a_policy_with_nan_weights_is_refused(
    assets: Assets, capsys: Capture, tmp_path: Path, recipe: str
) -> None:
    policy = tmp_path / "policy"
    shutil.copytree(assets.sft / "policy", policy)
    weights = load_file(policy / "policy.safetensors")
    weights["network.trunk.0.weight"][0, :3] = float("nan")
    save_file(weights, policy / "policy.safetensors")
    given = {"rl_co": ["real_coeff=0", *RL_CO], "evaluate": ["episodes=2"]}
    out = tmp_path / "out"
    line = refused(capsys, recipe, f"policy={policy}", *given[recipe], f"out={out}")
    assert "network.trunk.0.weight" in line
    assert "3 of" in line
    assert not out.exists()


def test_a_checkpoint_with_nan_weights_is_not_resumed(
    inputs: dict[str, list[str]],
    capsys: Capture,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from rlco.runs.state_files import save_state

    folder = tmp_path / "run"

    class CutError(Exception):
        pass

    def cut(run: Run, step: int, row: Any) -> None:
        if step == 3:
            raise CutError

    with monkeypatch.context() as patch:
        patch.setattr(Run, "log_metrics", cut)
        with pytest.raises(CutError):
            start("sft", *inputs["sft"], f"out={folder}")
    last = folder / "checkpoints" / "step_0000002.safetensors"
    saved = load_state(last)
    saved["state"]["optimizer"]["state"][0]["exp_avg"][0] = float("nan")
    save_state(last, saved)
    line = refused(capsys, "sft", f"resume={folder}")
    assert str(last) in line
    assert "optimizer.state.0.exp_avg" in line
    # As it says: without it the run goes on from the one before.
    last.unlink()
    start("sft", f"resume={folder}")
    assert status(folder) == "finished"
