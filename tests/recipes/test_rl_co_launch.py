"""Stage II in several processes: two that learn together, two that play over Ray."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import ray
from rank_cases import Found, in_two_ranks, next_group
from recipe_cases import RL_CO, Assets, refused, start

from rlco.errors import ConfigError
from rlco.run import Run
from rlco.runs.compare import ray_processes
from rlco.runs.compare.processes import Ended
from rlco.runs.compare.ray_processes import RayProcesses
from rlco.runs.metrics import read_metrics

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]


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

    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stderr(said):
        patch.setattr(Run, "save_checkpoint", save_once)
        try:
            start("rl_co", *options, f"out={folder / 'cut'}")
        except (CutOffError, SystemExit) as error:
            ended = repr(error)
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


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_a_rank_that_is_left_alone_says_so_in_a_sentence(
    learned: tuple[Found, Path],
) -> None:
    (first, second), _ = learned
    assert first["ended"] == "CutOffError()"
    assert second["ended"] == "SystemExit(2)"
    assert second["said"].startswith("error: another process of this training has")
    assert second["said"].endswith("start it again with resume=DIR.\n")


@pytest.mark.thorough
def test_ranks_resume_to_what_they_would_have_come_to(
    learned: tuple[Found, Path],
) -> None:
    _, folder = learned
    for name in ("metrics.csv", "policy/policy.safetensors"):
        cut, whole = (folder / run / name for run in ("cut", "whole"))
        assert cut.read_bytes() == whole.read_bytes(), name


@pytest.mark.thorough
def test_torchrun_itself_starts_the_same_run(
    learned: tuple[Found, Path], assets: Assets, tmp_path: Path
) -> None:
    _, folder = learned
    out = tmp_path / "run"
    given = [*stage_one(assets), *RL_CO, "reuse=1", "target_kl=0.5", "launch=torchrun"]
    ended = subprocess.run(
        [
            *(sys.executable, "-m", "torch.distributed.run"),
            *("--standalone", "--nproc-per-node=2", "recipes/rl_co.py"),
            *(*given, f"out={out}"),
        ],
        env=os.environ | {"GLOO_SOCKET_IFNAME": "lo"},
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, ended.stderr[-2000:]
    for name in ("metrics.csv", "policy/policy.safetensors"):
        assert (out / name).read_bytes() == (folder / "whole" / name).read_bytes()


# -- Workers of Ray --------------------------------------------------------------------


@pytest.mark.thorough
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


# -- Jobs of compare -------------------------------------------------------------------


@pytest.fixture
def processes(ray_cluster: None) -> RayProcesses:
    return RayProcesses(None, jobs=1)


def test_a_job_on_the_cluster_ends_with_its_status_and_log(
    processes: RayProcesses, tmp_path: Path
) -> None:
    log = tmp_path / "log.txt"
    code = "import sys; print('here'); sys.exit(3)"
    process = processes.start(["python", "-c", code], log, nice=0)
    ended = waited(processes, process)
    assert ended.status == 3
    assert ended.cpu_seconds > 0
    assert log.read_text() == "here\n"


def test_a_job_on_the_cluster_is_interrupted_as_by_ctrl_c(
    processes: RayProcesses, tmp_path: Path
) -> None:
    log = tmp_path / "log.txt"
    code = (
        "import time\ntry:\n    print('waits', flush=True)\n"
        "    time.sleep(600)\nexcept KeyboardInterrupt:\n    print('stops')\n"
    )
    process = processes.start(["python", "-c", code], log, nice=0)
    wait_for_a_line(processes, process, log)
    processes.stop(process)
    assert log.read_text() == "waits\nstops\n"


@pytest.mark.thorough
def test_an_interruption_that_is_lost_is_repeated_and_the_job_hears_one(
    processes: RayProcesses, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, real, calls = tmp_path / "log.txt", ray.cancel, []

    def lossy(process: Any) -> None:
        calls.append(process)
        if len(calls) > 1:
            real(process)

    code = (
        "import time\ntry:\n    print('waits', flush=True)\n"
        "    time.sleep(600)\nexcept KeyboardInterrupt:\n"
        "    time.sleep(1.5)\n    print('stops')\n"
    )
    process = processes.start(["python", "-c", code], log, nice=0)
    wait_for_a_line(processes, process, log)
    monkeypatch.setattr(ray, "cancel", lossy)
    monkeypatch.setattr(ray_processes, "_AGAIN", 0.5)
    ended = processes.stop(process)
    assert log.read_text() == "waits\nstops\n"
    assert ended.status == 0
    assert len(calls) > 2  # those that came while it ended changed nothing


def test_a_job_whose_worker_is_killed_has_died(
    processes: RayProcesses, tmp_path: Path
) -> None:
    log = tmp_path / "log.txt"
    code = "import os, time; print(os.getppid(), flush=True); time.sleep(600)"
    process = processes.start(["python", "-c", code], log, nice=0)
    wait_for_a_line(processes, process, log)
    os.kill(int(log.read_text()), signal.SIGKILL)
    assert waited(processes, process).status == -signal.SIGKILL


def test_a_node_without_the_folder_of_the_jobs_is_told(
    processes: RayProcesses, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Path, "cwd", lambda: Path("/nowhere"))
    process = processes.start(["python", "-c", ""], tmp_path / "log.txt", nice=0)
    with pytest.raises(ConfigError, match="has no folder '/nowhere'; jobs write"):
        waited(processes, process)


GRID = """
over: {seed: [1, 2]}
jobs: {count: {script: count.py, options: {seed: "{seed}"}}}
table: {methods: {count: {job: count}}}
"""
COUNT = """
import json, os, sys
from pathlib import Path
given = dict(one.split("=", 1) for one in sys.argv[1:])
Path(given["out"]).mkdir()
row = {"method": "count", "domain": "sim", "episodes": 8, "successes": 6}
row["seed"] = int(given["seed"])
(Path(given["out"]) / "results.json").write_text(json.dumps({"rows": [row]}))
(Path(given["out"]) / "metrics.csv").write_text("step\\n")
"""


def test_a_grid_runs_on_the_cluster(ray_cluster: None, tmp_path: Path) -> None:
    (tmp_path / "grid.yaml").write_text(GRID)
    (tmp_path / "count.py").write_text(COUNT)
    out = tmp_path / "out"
    given = (f"experiment={tmp_path / 'grid.yaml'}", f"out={out}", "nice=0")
    start("compare", *given, "launch=ray", "jobs=2")
    assert "| count | 75%" in (out / "table.md").read_text()


def test_an_address_without_ray_is_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "grid.yaml").write_text(GRID)
    (tmp_path / "count.py").write_text(COUNT)
    given = f"experiment={tmp_path / 'grid.yaml'}"
    assert "give launch=ray" in refused(capsys, "compare", given, "ray_address=auto")


def waited(processes: RayProcesses, process: Any) -> Ended:
    while (ended := processes.poll(process)) is None:
        time.sleep(0.05)  # on two processors it needs this one's
    return ended


def wait_for_a_line(processes: RayProcesses, process: Any, log: Path) -> None:
    while not log.exists() or not log.read_text().endswith("\n"):
        assert processes.poll(process) is None
        time.sleep(0.05)
