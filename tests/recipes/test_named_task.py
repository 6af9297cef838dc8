"""The recipes of both stages and of evaluation take one of robosuite's own tasks."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from lift_cases import LIFT, write_lift
from recipe_cases import RL_CO, SFT, Assets, refused, start

from rlco.errors import RlcoError
from rlco.physics.tasks.make_task import make_task
from rlco.policies import load_policy
from rlco.runs.metrics import read_metrics


@pytest.fixture(scope="module")
def demos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_lift(tmp_path_factory.mktemp("lift") / "demos")


@pytest.fixture(scope="module")
def policy(demos: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Imitate them for 40 updates."""
    out = tmp_path_factory.mktemp("lift") / "sft"
    rest = [o for o in SFT if not o.startswith(("updates", "log_every", "batch_size"))]
    more = ("sim_ratio=1", "updates=40", "log_every=20", "batch_size=32", "lr=1e-2")
    start("sft", f"task={LIFT}", f"sim_demos={demos}", *rest, *more, f"out={out}")
    return out / "policy"


def test_stage_one_learns_from_demonstrations_of_lift(policy: Path) -> None:
    rows = read_metrics(policy.parent / "metrics.csv")
    assert rows[-1]["loss_bc"] < rows[0]["loss_bc"]
    _, extra = load_policy(policy)
    assert extra["task"] == LIFT
    assert extra["instructions"] == ["lift the cube"]
    assert extra["state_names"][:3] == ["tool.x", "tool.y", "tool.z"]


@pytest.mark.thorough
@pytest.mark.slow
def test_stage_two_learns_on_robosuites_copies(
    policy: Path, demos: Path, tmp_path: Path
) -> None:
    out = tmp_path / "rl_co"
    left_out = ("iterations", "critic_iterations", "eval_episodes")
    rest = [o for o in RL_CO if not o.startswith(left_out)]
    given = (f"task={LIFT}", f"policy={policy}", f"real_demos={demos}")
    more = ("iterations=1", "critic_iterations=0", "horizon=12", "eval_episodes=1")
    start("rl_co", *given, *rest, *more, f"out={out}")
    first, last = read_metrics(out / "metrics.csv")
    assert last["frames"] == 2 * 12
    assert last["first_ratio"] == pytest.approx(1.0, abs=1e-5)
    # Both terms pull: robosuite's shaped reward, and the demonstrations.
    assert last["return_mean"] > 0.0
    assert last["grad_norm_sim"] > 0.0
    assert last["grad_norm_real"] > 0.0
    assert {"success_sim"} == {k for k in first if k.startswith("success_")}
    before, after = (load_policy(p)[0] for p in (policy, out / "policy"))
    changed = zip(before.parameters(), after.parameters(), strict=True)
    assert any((a != b).any() for a, b in changed)


@pytest.mark.slow
def test_evaluation_plays_robosuites_episodes(policy: Path, tmp_path: Path) -> None:
    out = tmp_path / "evaluation"
    given = (f"policy={policy}", f"task={LIFT}", "episodes=1")
    start("evaluate", *given, f"out={out}")
    (row,) = json.loads((out / "results.json").read_text())["rows"]
    # Fingers that never close lift nothing.
    assert (row["task"], row["episodes"], row["successes"]) == (LIFT, 1, 0)


def test_policies_and_demonstrations_of_another_task_are_refused(
    policy: Path,
    demos: Path,
    assets: Assets,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"
    line = refused(
        capsys, "evaluate", f"policy={policy}", "task=push_cube", f"out={out}"
    )
    assert f"was trained on '{LIFT}'" in line
    given = (f"sim_demos={assets.sim}", "sim_ratio=1", f"out={out}")
    line = refused(capsys, "sft", f"task={LIFT}", *given, "eval_domains=[sim]")
    assert "observation.state" in line
    assert not out.exists()


def test_a_domain_that_lift_lacks_is_refused_before_training(
    demos: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    given = (f"sim_demos={demos}", "sim_ratio=1", f"out={out}")
    line = refused(capsys, "sft", f"task={LIFT}", *given)
    assert "'stand_in' is not supported" in line
    assert "give sim" in line
    assert not out.exists()


def test_who_needs_an_expert_or_domains_says_that_lift_has_none() -> None:
    with pytest.raises(RlcoError, match=r"'robosuite:Lift' is robosuite's own task"):
        make_task(LIFT)
    with pytest.raises(RlcoError, match=r"give one of push_cube, pick_and_place"):
        make_task(LIFT)
