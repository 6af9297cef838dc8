"""The run directory: never overwritten, and a killed run ends like any other."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch

from rlco.errors import NonFiniteError, OutputExistsError, RlcoError
from rlco.run import Run, run_recipe
from rlco.runs.config import RunOptions, option

TOY = '''
"""A recipe that draws from every random number and can be killed at a point."""
import os, random, signal
from dataclasses import dataclass
from pathlib import Path

from rlco.runs.config import RunOptions, option
from rlco.run import Run, run_recipe


@dataclass
class Config(RunOptions):
    die_at: int = option(0, "iteration to die in", may_change=True)
    die_in: str = option("iteration", "where to die", may_change=True)


def die(*args):
    os.kill(os.getpid(), signal.SIGKILL)


def main(config):
    import numpy as np
    import torch

    with Run(config, "toy") as run:
        weight, velocity = torch.randn(3), torch.zeros(3)
        saved = run.load_checkpoint()
        if saved is None:
            run.log_metrics(0, {"loss": 1.0})
        else:
            weight, velocity = saved["weight"], saved["velocity"]
        for i in run.iterations(8):
            x = torch.randn(4, 3) * random.random() + np.random.rand()
            loss = (x @ weight).square().mean()
            velocity = 0.9 * velocity + (x @ weight) @ x
            weight = weight - 0.01 * velocity
            run.log_metrics(i, {"loss": loss} | ({"late": i} if i >= 6 else {}))
            run.log_timings(i, {"update": random.random()})
            if i == config.die_at and config.die_in == "iteration":
                die()
            if i % 3 == 0:
                if i == config.die_at:
                    Path.replace = die  # after the file is written, before its name
                run.save_checkpoint(i, {"weight": weight, "velocity": velocity})


if __name__ == "__main__":
    run_recipe(main, Config)
'''


# Reads one list of arguments a line and answers with the exit code of a process of
# its own that ran the recipe with them: torch is imported once, not four times.
STARTER = """
import json, os, sys, traceback
import torch, torch.utils.tensorboard
from rlco.run import run_recipe
from toy import Config, main

torch.set_num_threads(1)
for line in sys.stdin:
    child = os.fork()
    if child == 0:
        status = 1
        try:
            run_recipe(main, Config, json.loads(line))
            status = 0
        except BaseException:
            traceback.print_exc()
        os._exit(status)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@dataclass
class Config(RunOptions):
    """Options of the recipes below."""

    size: int = option(1, "a number")


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., int]]:
    """Run the toy recipe in a process of its own and return its exit code."""
    (tmp_path / "toy.py").write_text(TOY)
    with subprocess.Popen(
        [sys.executable, "-c", STARTER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
    ) as starter:
        assert starter.stdin is not None
        assert starter.stdout is not None
        stdin, stdout = starter.stdin, starter.stdout

        def run(*arguments: str) -> int:
            stdin.write(json.dumps(arguments) + "\n")
            stdin.flush()
            return int(stdout.readline())

        yield run
        stdin.close()


@pytest.mark.slow
def test_killed_and_resumed_equals_never_killed(
    start: Callable[..., int], tmp_path: Path
) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    assert start(f"out={whole}") == 0
    # Killed in an iteration past a checkpoint, before the last column appeared.
    assert start(f"out={killed}", "die_at=5") == -signal.SIGKILL
    # Resumed; killed when a checkpoint was written and not yet named.
    again = (f"resume={killed}", "die_at=6", "die_in=checkpoint")
    assert start(*again) == -signal.SIGKILL
    assert (killed / "metrics.csv").read_text().startswith("step,loss,late")
    saved = [path.name for path in (killed / "checkpoints").glob("step*")]
    assert saved == ["step_0000003.safetensors"]
    assert start(f"resume={killed}", "die_at=0", "die_in=iteration") == 0

    for name in ("metrics.csv", "timings.csv", "config.yaml"):
        assert (killed / name).read_bytes() == (whole / name).read_bytes(), name
    assert scalars(killed) == scalars(whole)
    assert not list(killed.rglob("*.part"))
    info = json.loads((killed / "run.json").read_text())
    assert info["status"] == "finished"
    assert len(info["resumed"]) == 2


def scalars(run: Path) -> dict[str, list[tuple[int, float]]]:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(run / "tb"))
    events.Reload()
    tags = events.Tags()["scalars"]
    return {tag: [(e.step, e.value) for e in events.Scalars(tag)] for tag in tags}


def test_existing_folder_is_refused_and_untouched(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(OutputExistsError, match="exists and is not overwritten"):
        Run(RunOptions(out=str(tmp_path)), "demo")
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    with pytest.raises(RlcoError, match="cannot be made"):
        Run(RunOptions(out=str(tmp_path / "mine.txt" / "x")), "demo")


def test_folders_name_says_recipe_date_name_and_seed(tmp_path: Path) -> None:
    options = RunOptions(name="first", seed=3)
    # Two runs within one second get two folders.
    with (
        Run(options, "sft", root=tmp_path) as a,
        Run(options, "sft", root=tmp_path) as b,
    ):
        assert a.path != b.path
    assert a.path.parent == tmp_path / "sft"
    date, time, name, seed = a.path.name.split("_")
    assert (len(date), len(time), name, seed) == (10, 8, "first", "s3")


def test_run_in_use_or_of_another_recipe_is_not_resumed(tmp_path: Path) -> None:
    out = str(tmp_path / "run")
    with Run(RunOptions(out=out), "sft"), pytest.raises(RlcoError, match="in use"):
        Run(RunOptions(resume=out), "sft")
    with pytest.raises(RlcoError, match="is of recipe 'sft', not 'rl_co'"):
        Run(RunOptions(resume=out), "rl_co")
    (tmp_path / "run" / "run.json").write_text("{")
    with pytest.raises(RlcoError, match=r"run\.json' is truncated or damaged"):
        Run(RunOptions(resume=out), "sft")
    with pytest.raises(RlcoError, match="missing; give the folder of an earlier run"):
        Run(RunOptions(resume=str(tmp_path / "nowhere")), "sft")


def test_refused_resume_leaves_every_file_as_it_was(tmp_path: Path) -> None:
    out = tmp_path / "run"
    with Run(RunOptions(out=str(out)), "sft") as run:
        run.log_metrics(1, {"loss": 1})
    before = {p: p.read_bytes() for p in out.rglob("*") if p.is_file()}
    with pytest.raises(RlcoError):
        Run(RunOptions(resume=str(out)), "rl_co")
    assert {p: p.read_bytes() for p in out.rglob("*") if p.is_file()} == before


def test_rotation_keeps_the_newest(tmp_path: Path) -> None:
    with Run(RunOptions(out=str(tmp_path / "run")), "demo") as run:
        for step in run.iterations(12):
            run.save_checkpoint(step, {"step": step}, keep=3)
        names = sorted(path.name[5:12] for path in run.checkpoints.iterdir())
        assert names == ["0000010", "0000011", "0000012"]
        assert run.load_checkpoint() == {"step": 12}


def test_row_that_a_resume_would_drop_is_refused(tmp_path: Path) -> None:
    with Run(RunOptions(out=str(tmp_path / "run")), "demo") as run:
        run.save_checkpoint(2, {})
        with pytest.raises(ValueError, match="step 2 is logged after its checkpoint"):
            run.log_metrics(2, {"loss": 1})


def test_seed_decides_the_random_numbers(tmp_path: Path) -> None:
    drawn = []
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        with Run(RunOptions(out=str(tmp_path / name), seed=seed), "demo"):
            drawn.append(torch.rand(()).item())
    assert drawn[0] == drawn[1] != drawn[2]


def test_stage_is_made_once_and_then_resumed(tmp_path: Path) -> None:
    out = str(tmp_path / "run")
    with Run(RunOptions(out=out), "chain") as run:
        with run.stage(RunOptions(seed=7), "sft", "stage_one") as stage:
            stage.save_checkpoint(4, {"w": 1})
        assert stage.path == run.path / "stage_one"
    with (
        Run(RunOptions(resume=out), "chain") as run,
        run.stage(RunOptions(seed=7), "sft", "stage_one") as stage,
    ):
        assert stage.load_checkpoint() == {"w": 1}


def test_a_resumed_stage_has_the_options_it_was_started_with(tmp_path: Path) -> None:
    out = str(tmp_path / "run")
    with Run(RunOptions(out=out), "chain") as run:
        first = RunOptions(seed=7, name="a")
        assert run.stage_options(first, "stage_one") is first
        with run.stage(first, "sft", "stage_one"):
            pass
    now = RunOptions(seed=8, name="c")
    with Run(RunOptions(resume=out), "chain") as run:
        assert run.stage_options(now, "stage_two") is now  # it was not reached
        again = run.stage_options(now, "stage_one", anew=["name"])
    assert (again.seed, again.name) == (7, "c")


def test_results_and_log_are_written(tmp_path: Path) -> None:
    row = {
        "method": "sft",
        "task": "push_cube",
        "policy": "gaussian",
        "domain": "sim",
        "variation": None,
        "seed": 0,
        "episodes": 20,
        "successes": 17,
    }
    with Run(RunOptions(out=str(tmp_path / "run")), "demo") as run:
        logging.getLogger("rlco.test").warning("the cube fell")
        run.save_results([row])
    results = json.loads((run.path / "results.json").read_text())
    assert results["rows"] == [row]
    assert set(results) == {"seconds", "rows"}
    assert "WARNING rlco.test: the cube fell" in (run.path / "log.txt").read_text()


def test_wrong_input_is_one_line_and_status_2(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def main(config: Config) -> None:
        with Run(config, "demo"):
            raise RlcoError("the data set is empty; record one.")

    for arguments, message in (
        (["sizee=2"], "error: unknown option 'sizee' (did you mean 'size'?); 'help'"),
        ([f"out={tmp_path / 'x'}"], "error: the data set is empty; record one.\n"),
        ([f"out={tmp_path}"], f"error: output folder '{tmp_path}' exists"),
    ):
        with pytest.raises(SystemExit) as ended:
            run_recipe(main, Config, arguments)
        assert ended.value.code == 2
        error = capsys.readouterr().err
        assert error.startswith(message)
        assert error.count("\n") == 1
    info = json.loads((tmp_path / "x" / "run.json").read_text())
    assert info["status"] == "failed"
    assert "record one" in (tmp_path / "x" / "log.txt").read_text()


def test_a_state_that_is_not_finite_is_not_saved(tmp_path: Path) -> None:
    out = tmp_path / "run"
    good = {"weight": torch.ones(2), "count": torch.arange(2)}
    bad = {"optimizer": {0: {"exp_avg": torch.tensor([1.0, torch.nan])}}}

    def train() -> None:
        with Run(RunOptions(out=str(out)), "demo") as run:
            for step in run.iterations(3):
                run.log_metrics(step, {"loss": 1.0})
                run.save_checkpoint(step, good | (bad if step == 2 else {}))

    with pytest.raises(
        NonFiniteError, match=r"iteration 2 .* optimizer\.0\.exp_avg is"
    ):
        train()
    info = json.loads((out / "run.json").read_text())
    assert info["status"] == "failed"
    (kept,) = (out / "checkpoints").iterdir()
    assert str(kept) in (out / "log.txt").read_text()
    with Run(RunOptions(resume=str(out)), "demo") as run:
        assert torch.equal(run.load_checkpoint()["weight"], good["weight"])
        assert list(run.iterations(3)) == [2, 3]


def test_interrupt_is_status_130_and_says_how_to_go_on(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    out = tmp_path / "run"
    # A shell that starts pytest in the background has it ignore Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))

    def main(config: Config) -> None:
        with Run(config, "demo") as run:
            for step in run.iterations(5):
                run.save_checkpoint(step, step)
                if step == 2 and not run.resumed:
                    os.kill(os.getpid(), signal.SIGINT)
            run.log_metrics(6, {"reached": step})

    with pytest.raises(SystemExit) as ended:
        run_recipe(main, Config, [f"out={out}"])
    assert ended.value.code == 130
    assert f"resume={out}" in capsys.readouterr().err
    assert json.loads((out / "run.json").read_text())["status"] == "interrupted"
    run_recipe(main, Config, [f"resume={out}"])
    assert (out / "metrics.csv").read_text() == "step,reached\n6,5\n"


def test_defect_keeps_its_traceback() -> None:
    def main(config: Config) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run_recipe(main, Config, [])


# -- What people who wait are told -----------------------------------------------


def test_what_is_loaded_is_said_before_it_is(
    capsys: pytest.CaptureFixture[str],
) -> None:
    told = []

    def main(config: RunOptions) -> None:
        told.append(capsys.readouterr().err)

    run_recipe(main, RunOptions, [], loads="a_library_that_nobody_has_loaded")
    run_recipe(main, RunOptions, [], loads="torch")  # it is there already
    assert told == ["loading a_library_that_nobody_has_loaded\n", ""]


def test_without_a_terminal_lines_tell_success_and_loss(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rlco.runs.progress.QUIET", 0.0)
    logging.getLogger("rlco").setLevel(logging.INFO)
    with Run(RunOptions(out=str(tmp_path / "run")), "toy") as run:
        for iteration in run.iterations(2):
            row = {"loss_bc": 0.5 / iteration, "frames": 7}
            if iteration == 1:
                row["success_sim"] = 0.25
            run.log_metrics(iteration, row)
    log = (tmp_path / "run" / "log.txt").read_text()
    assert "toy: 1 of 2, loss_bc 0.5, success_sim 0.25" in log
    # The last success that was measured stays.
    assert "toy: 2 of 2, loss_bc 0.25, success_sim 0.25" in log


def test_without_a_terminal_the_end_is_told_in_the_callers_unit(tmp_path: Path) -> None:
    logging.getLogger("rlco").setLevel(logging.INFO)
    with Run(RunOptions(out=str(tmp_path / "run")), "toy") as run:
        for iteration in run.iterations(3, lambda row: f"{row * 100} of 300 updates"):
            run.log_metrics(iteration, {"loss_bc": 1.0 / iteration})
    lines = (tmp_path / "run" / "log.txt").read_text().splitlines()
    (line,) = [line for line in lines if "toy: " in line]
    assert line.endswith("toy: 300 of 300 updates, loss_bc 0.333")
