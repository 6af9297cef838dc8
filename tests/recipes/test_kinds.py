"""Token and flow policies, and critic-free advantages, through the recipes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from recipe_cases import RL_CO, SFT, Assets, refused, start

from rlco.run import Run
from rlco.runs.metrics import read_metrics

TOKEN = ("policy=token", "token.width=16", "token.layers=1", "token.bins=16")
FLOW = ("policy=flow", "flow.steps=2", "flow.noisy_steps=one")
ONE = [o for o in RL_CO if not o.startswith(("iterations", "critic_iterations"))]


def stage_one(assets: Assets, folder: Path, *options: str) -> Path:
    """Train on both data sets; return the folder of the policy."""
    given = [f"sim_demos={assets.sim}", f"real_demos={assets.real}"]
    # Enough updates that the noise of a flow's loss does not hide that it falls.
    longer = ("updates=60", "log_every=20", "lr=1e-2")
    rest = [o for o in SFT if not o.startswith(("updates", "log_every"))]
    start("sft", *given, *rest, *options, *longer, f"out={folder}")
    return folder / "policy"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "options", "stage_two"),
    [
        ("token", TOKEN, ["critic=head"]),
        pytest.param(
            *("token", TOKEN, ["advantage=mc", "group_size=2"]),
            marks=pytest.mark.thorough,
        ),
        pytest.param("flow", FLOW, ["critic_hidden=[16]"], marks=pytest.mark.thorough),
        ("flow", (*FLOW, "flow.method=fpo"), ["advantage=mc", "group_size=2"]),
    ],
)
def test_each_kind_goes_through_both_stages_and_is_evaluated(
    assets: Assets,
    tmp_path: Path,
    kind: str,
    options: tuple[str, ...],
    stage_two: list[str],
) -> None:
    policy = stage_one(assets, tmp_path / "sft", *options)
    rows = read_metrics(tmp_path / "sft" / "metrics.csv")
    assert rows[-1]["loss_bc"] < rows[0]["loss_bc"]
    given = [f"policy={policy}", f"real_demos={assets.real}", *ONE, *stage_two]
    start("rl_co", *given, "iterations=1", "critic_iterations=0", f"out={tmp_path}/rl")
    row = read_metrics(tmp_path / "rl" / "metrics.csv")[-1]
    assert row["first_ratio"] == pytest.approx(1.0, abs=1e-5)
    assert row["log_prob_gap"] < 1e-3
    assert row["grad_norm_sim"] > 0
    assert row["grad_norm_real"] > 0
    assert ("loss_critic" in row) is ("advantage=mc" not in stage_two)
    folder = tmp_path / "evaluation"
    start("evaluate", f"policy={tmp_path}/rl/policy", "episodes=1", f"out={folder}")
    (result,) = json.loads((folder / "results.json").read_text())["rows"]
    assert result["policy"] == kind


class KilledError(Exception):
    """Stands for whatever ends a process between a row and its checkpoint."""


@pytest.mark.slow
def test_a_flow_that_was_cut_off_draws_the_same_noises_when_resumed(
    assets: Assets, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save = Run.save_checkpoint

    def save_once(run: Run, step: int, state: Any, **options: Any) -> Path:
        if step == 2:
            raise KilledError
        return save(run, step, state, **options)

    stage_one(assets, tmp_path / "whole", *FLOW)
    with monkeypatch.context() as patch:
        patch.setattr(Run, "save_checkpoint", save_once)
        with pytest.raises(KilledError):
            stage_one(assets, tmp_path / "cut", *FLOW)
    start("sft", f"resume={tmp_path / 'cut'}")
    for name in ("metrics.csv", "policy/policy.safetensors"):
        found = (tmp_path / "cut" / name).read_bytes()
        assert found == (tmp_path / "whole" / name).read_bytes(), name


def test_stage_two_that_starts_from_nothing_stops(
    assets: Assets, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = [f"policy={assets.sft / 'policy'}", "real_coeff=0", *ONE, "horizon=8"]
    more = ["reward=sparse", "eval_episodes=0", f"out={tmp_path / 'out'}"]
    rest = [o for o in given if not o.startswith("eval_episodes")]
    line = refused(capsys, "rl_co", *rest, *more)
    assert "0 of 2 episodes were solved" in line
    assert "reward=shaped" in line
    assert not (tmp_path / "out" / "policy").exists()


@pytest.mark.parametrize(
    ("recipe", "options", "words"),
    [
        ("sft", ["policy=token", "token.heads=3"], ["heads must divide width"]),
        ("sft", ["policy=flow", "flow.noise_range=[0.2,0.1]"], ["noise_range"]),
        ("sft", ["policy=tokens"], ["policy", "'gaussian'", "'token'", "'flow'"]),
        ("sft", ["noise_std=0.1"], ["did you mean 'token.noise_std'"]),
        ("rl_co", ["advantage=mc", "num_envs=12"], ["num_envs=12", "group_size=8"]),
        ("rl_co", ["critic=head"], ["GaussianPolicy has no state", "ValueNetwork"]),
        ("quickstart", ["advantage=mc", "num_envs=4"], ["num_envs=4", "group_size=8"]),
    ],
)
def test_options_that_cannot_be_are_refused_before_a_folder_is_made(
    assets: Assets,
    inputs: dict[str, list[str]],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    recipe: str,
    options: list[str],
    words: list[str],
) -> None:
    names = [option.partition("=")[0] for option in options]
    others = [o for o in inputs.get(recipe, []) if o.partition("=")[0] not in names]
    line = refused(capsys, recipe, *others, *options, f"out={tmp_path / 'out'}")
    for word in words:
        assert word in line
    assert not (tmp_path / "out").exists()
