"""Stage II in several processes: two that learn together, two that play over Ray."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import pytest
from rank_cases import Found, in_two_ranks, next_group
from recipe_cases import RL_CO, Assets, refused, start

from rlco.run import Run
from rlco.runs.metrics import read_metrics

pytestmark = pytest.mark.slow


def stage_one(assets: Assets) -> list[str]:
    return [f"policy={assets.sft / 'policy'}", f"real_demos={assets.real}"]


class CutOffError(Exception):
    """Stands for whatever ends a process between a row and its checkpoint."""


# -- Learners that torchrun starts -----------------------------------------------------


def learn(given: list[str], folder: Path) -> dict[str, Any]:
    """Train in two ranks; train again, cut off in the second iteration; resume."""
    options = [*given, "launch=torchrun"]
    start("rl_co", *options, f"out={folder / 'whole'}")
    next_group()
    save = Run.save_checkpoint

    def save_once(run: Run, step: int, state: Any, **more: Any) -> Path:
        if step == 2:
            raise CutOffError
        return save(run, step, state, **more)

    Run.save_checkpoint = save_once  # type: ignore[method-assign]
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        try:
            start("rl_co", *options, f"out={folder / 'cut'}")
        except (CutOffError, SystemExit) as error:
            ended = repr(error)
    Run.save_checkpoint = save  # type: ignore[method-assign]
    next_group()
    start("rl_co", f"resume={folder / 'cut'}")
    return {"ended": ended, "said": said.getvalue()}


@pytest.fixture(scope="module")
def learned(
    assets: Assets, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Found, Path]:
    folder = tmp_path_factory.mktemp("learned")
    given = [*stage_one(assets), *RL_CO, "reuse=1", "target_kl=0.5"]
    return in_two_ranks(learn, folder, given, folder, groups=3), folder


def test_two_ranks_write_one_run_of_the_frames_of_both(
    learned: tuple[Found, Path], assets: Assets
) -> None:
    _, folder = learned
    assert sorted(path.name for path in folder.iterdir() if path.is_dir()) == [
        "cut",
        "whole",
    ]
    rows = read_metrics(folder / "whole" / "metrics.csv")
    alone = read_metrics(assets.rl_co / "metrics.csv")
    assert [row["frames"] for row in rows] == [row["frames"] for row in alone]
    # Evaluated before: the same policy, the same episodes.
    assert rows[0]["success_sim"] == alone[0]["success_sim"]
    assert (folder / "whole" / "policy" / "policy.safetensors").is_file()


def test_a_rank_that_is_left_alone_says_so_in_a_sentence(
    learned: tuple[Found, Path],
) -> None:
    (first, second), _ = learned
    assert first["ended"] == "CutOffError()"
    assert second["ended"] == "SystemExit(2)"
    assert second["said"].startswith("error: another process of this training has")
    assert second["said"].endswith("start it again with resume=DIR.\n")


def test_ranks_resume_to_what_they_would_have_come_to(
    learned: tuple[Found, Path],
) -> None:
    _, folder = learned
    for name in ("metrics.csv", "policy/policy.safetensors"):
        cut, whole = (folder / run / name for run in ("cut", "whole"))
        assert cut.read_bytes() == whole.read_bytes(), name


# -- Workers of Ray --------------------------------------------------------------------


def test_workers_of_ray_play_and_a_resumed_run_goes_on_without_them(
    assets: Assets, ray_cluster: None, tmp_path: Path
) -> None:
    out = tmp_path / "ray"
    given = [*stage_one(assets), *RL_CO, f"out={out}"]
    start("rl_co", *given, "launch=ray", "workers=2")
    rows = read_metrics(out / "metrics.csv")
    alone = read_metrics(assets.rl_co / "metrics.csv")
    assert [row["frames"] for row in rows] == [row["frames"] for row in alone]
    # The worker played with the weights that the learner had.
    assert all(row["log_prob_gap"] < 1e-4 for row in rows[1:])
    start("rl_co", f"resume={out}", "launch=local", "workers=null", "iterations=4")
    assert len(read_metrics(out / "metrics.csv")) == 5


def test_a_cluster_that_is_not_there_is_said(
    assets: Assets, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    said = refused(
        capsys, "rl_co", *stage_one(assets), f"out={tmp_path / 'a'}", "launch=ray"
    )
    assert "give workers=2" in said
    assert not (tmp_path / "a").exists()
