"""A grid of runs: cached, resumed, in order, and nothing dropped from its table."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from recipe_cases import RECIPES, start

from rlco.errors import ConfigError
from rlco.runs.compare.cells import Store
from rlco.runs.compare.jobs import Job, expand
from rlco.runs.compare.plan import make_plan
from rlco.runs.compare.queue import Queue
from rlco.runs.compare.reading.read_experiment import read_experiment
from rlco.runs.compare.smallest import smallest
from rlco.runs.config import parse

pytestmark = pytest.mark.slow

#: A job that takes no time. It notes that it ran, and solves what it is asked to.
SCRIPT = '''"""Counts."""

import json
import os
import sys
import time
from pathlib import Path

import beside

given = dict(argument.split("=", 1) for argument in sys.argv[1:])
out = Path(given.get("resume") or given["out"])
with open(os.environ["NOTED"], "a") as file:
    file.write(("again " if "resume" in given else "") + given["who"] + "\\n")
if given.get("fail") == "true":
    sys.exit("no luck")
out.mkdir(exist_ok=True)
(out / "config.yaml").write_text("")
(out / "run.json").write_text("{}")
steps = out / "steps.txt"
for step in range(int(given.get("steps", 0))):
    if step >= len(steps.read_text().split() if steps.exists() else []):
        with steps.open("a") as file:
            file.write(f"{step} ")
        time.sleep(0.05)
EPISODES = 10
solved = int(given["solves"]) + beside.MORE
if "after" in given:
    solved += json.loads((Path(given["after"]) / "results.json").read_text())["rows"][
        0
    ]["successes"]
rows = [
    {"method": given["who"].split()[0], "domain": "sim", "episodes": EPISODES,
     "successes": solved, "seed": int(given.get("seed", 0))}
]
table = ["step,frames,success_sim,success_rollout", "0,0,.25,", "1,8,,.3", "2,16,.5,.4"]
(out / "metrics.csv").write_text("\\n".join(table) + "\\n")
(out / "results.json").write_text(json.dumps({"rows": rows}))
'''


@pytest.fixture
def grid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Grid:
    monkeypatch.setenv("NOTED", str(tmp_path / "noted.txt"))
    (tmp_path / "job.py").write_text(SCRIPT)
    (tmp_path / "beside.py").write_text("MORE = 0\n")
    return Grid(tmp_path)


class Grid:
    """An experiment in a folder, with its script.

    Three seeds; a first stage, and a second one with two values of beta after it.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.noted = folder / "noted.txt"
        self.content: dict[str, Any] = {
            "name": "small",
            "over": {"seed": [1, 2, 3], "beta": [0, 4]},
            "jobs": {
                "first": {
                    "script": "job.py",
                    "minutes": 1,
                    "options": {"who": "first {seed}", "solves": "{seed}"},
                },
                "second": {
                    "script": "job.py",
                    "minutes": 2,
                    "options": {
                        "who": "second {seed} {beta}",
                        "solves": "{beta}",
                        "seed": "{seed}",
                        "after": "{first}",
                    },
                },
            },
            "table": {
                "methods": {
                    "first": {"job": "first"},
                    "beta {beta}": {"job": "second"},
                },
                "differences": [["beta 4", "first"]],
            },
        }

    def write(self) -> Path:
        path = self.folder / "small.yaml"
        path.write_text(yaml.safe_dump(self.content, sort_keys=False))
        return path

    def arguments(self, *more: str) -> list[str]:
        out = self.folder / "out"
        return [f"experiment={self.write()}", f"out={out}", "nice=0", *more]

    def run(self, *more: str) -> list[str]:
        """Run the experiment; return who ran, in their order."""
        before = len(self.ran())
        start("compare", *self.arguments(*more))
        return self.ran()[before:]

    def run_and_fail(self, *more: str) -> list[str]:
        """Run it with jobs that fail, which its exit status says; return who ran."""
        before = len(self.ran())
        with pytest.raises(SystemExit) as ended:
            start("compare", *self.arguments(*more))
        assert ended.value.code == 2
        return self.ran()[before:]

    def ran(self) -> list[str]:
        return self.noted.read_text().splitlines() if self.noted.exists() else []

    @property
    def table(self) -> str:
        return (self.folder / "out" / "table.md").read_text()

    def jobs(self) -> list[Job]:
        return expand(read_experiment(self.write()))


ALL = [
    *("first 1", "first 2", "first 3"),
    *("second 1 0", "second 1 4", "second 2 0"),
    *("second 2 4", "second 3 0", "second 3 4"),
]


# -- What runs, and what need not ------------------------------------------------------


def test_every_job_runs_once_and_later_ones_read_the_folders_of_earlier_ones(
    grid: Grid,
) -> None:
    assert grid.run("jobs=1") == ALL
    # Seeds solve 1, 2 and 3 of 10; a second stage adds its beta to the first's.
    first, beta0, beta4 = grid.table.splitlines()[2:5]
    # t[2] = 4.303, s = 0.1: 0.2 +- 4.303 * 0.1 / sqrt(3)
    assert first == "| first | 20% [0%, 45%] | 10% | 3 |"
    assert beta0 == "| beta 0 | 20% [0%, 45%] | 10% | 3 |"
    assert beta4 == "| beta 4 | 60% [35%, 85%] | 50% | 3 |"
    assert "| beta 4 - first | +40.0 [+40.0, +40.0] | 3 |" in grid.table
    assert grid.run() == []


def test_combinations_that_are_left_out_do_not_run_and_are_not_missing(
    grid: Grid,
) -> None:
    grid.content["without"] = [{"seed": [1, 2], "beta": 0}]
    ran = grid.run("jobs=1")
    assert ran == [one for one in ALL if one not in ("second 1 0", "second 2 0")]
    assert "| beta 0 | 30% | 30% | 1 |" in grid.table
    assert "missing" not in grid.table


def test_a_variable_with_one_value_need_not_be_in_a_label(grid: Grid) -> None:
    grid.content["over"]["beta"] = [4]
    grid.content["table"]["methods"] = {"rl": {"job": "second"}}
    del grid.content["table"]["differences"]
    grid.run()
    assert "| rl | 60% [35%, 85%] | 50% | 3 |" in grid.table


def test_a_table_needs_no_file_whose_hash_is_given(grid: Grid) -> None:
    weights = grid.folder / "weights.pth"
    weights.write_bytes(b"large")
    grid.content["jobs"]["first"]["options"]["who"] = str(weights)
    grid.run()
    weights.unlink()
    grid.run("hours=0")
    assert "missing" in grid.table
    digest = hashlib.sha256(b"large").hexdigest()
    grid.content["files"] = {str(weights): digest}
    grid.run("hours=0")
    assert "missing" not in grid.table
    # Another file there is refused, not taken for the one that was meant.
    weights.write_bytes(b"other")
    with pytest.raises(ConfigError, match=f"{digest[:12]}..., but the file there has"):
        grid.jobs()


def test_cells_hold_what_a_result_comes_from(grid: Grid) -> None:
    grid.run()
    (path,) = (grid.folder / "out").glob("jobs/second_seed2_beta4-*/cell.json")
    cell = json.loads(path.read_text())
    assert cell["script"] == "job.py"
    assert cell["options"]["solves"] == "4"
    assert cell["options"]["after"].startswith("job:")
    assert cell["rows"][0]["successes"] == 6
    # The rows of metrics.csv with an evaluation.
    assert cell["curves"]["metrics.csv"] == [
        {"step": 0.0, "frames": 0.0, "success_sim": 0.25},
        {"step": 2.0, "frames": 16.0, "success_sim": 0.5, "success_rollout": 0.4},
    ]
    assert cell["cpu_seconds"] > 0
    assert cell["processor"]
    rows = json.loads((grid.folder / "out" / "results.json").read_text())["rows"]
    assert len(rows) == 9
    assert rows[-1]["over"] == {"seed": 3, "beta": 4}


def test_other_options_run_again_and_the_rest_is_kept(grid: Grid) -> None:
    grid.run()
    grid.content["over"]["beta"] = [0, 5]
    grid.content["table"].pop("differences")
    assert grid.run("jobs=1") == ["second 1 5", "second 2 5", "second 3 5"]
    # Another first stage is another second stage, too.
    grid.content["jobs"]["first"]["options"]["more"] = 1
    assert len(grid.run()) == 9


def test_comments_docstrings_and_layout_change_nothing(grid: Grid) -> None:
    grid.run()
    changed = SCRIPT.replace('"""Counts."""', '"""Counts episodes."""  # quickly')
    (grid.folder / "job.py").write_text(changed.replace("EPISODES = 10", "EPISODES=10"))
    assert grid.run() == []


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [("job.py", "EPISODES = 10", "EPISODES = 20"), ("beside.py", "0", "1")],
)
def test_other_code_runs_again_in_the_script_and_in_what_it_imports(
    grid: Grid, file: str, old: str, new: str
) -> None:
    grid.run()
    path = grid.folder / file
    path.write_text(path.read_text().replace(old, new))
    assert len(grid.run("code=same")) == 9


def test_results_of_older_code_are_used_on_request_and_marked(grid: Grid) -> None:
    grid.content["over"]["seed"] = [1, 2]
    grid.run()
    grid.content["over"]["seed"] = [1, 2, 3]
    (grid.folder / "beside.py").write_text("MORE = 1\n")
    grid.run("hours=0", "code=same")
    assert "| first | missing | - | 0 of 3: 3 missing |" in grid.table
    ran = grid.run("code=any", "jobs=1")
    assert ran == ["first 3", "second 3 0", "second 3 4"]
    assert "| first \\* |" in grid.table
    assert "\\* with results of another version of the code" in grid.table


def test_what_results_of_older_code_went_on_from_is_counted_with_them(
    grid: Grid,
) -> None:
    grid.run()
    older = {job.key for job in grid.jobs()}
    (grid.folder / "beside.py").write_text("MORE = 1\n")
    both = grid.content
    grid.content = {**both, "jobs": {"first": both["jobs"]["first"]}}
    grid.content["table"] = {"methods": {"first": {"job": "first"}}}
    grid.content["over"] = {"seed": [1, 2, 3]}
    assert len(grid.run()) == 3
    newer = {job.key for job in grid.jobs()}
    store = Store(grid.folder / "out", None, "any")
    firsts, grid.content = grid.content, both
    # Also where it was made again by this very version of the code.
    assert {cell.key for cell in store.find_all(grid.jobs()).values()} == older
    grid.content = firsts
    (grid.folder / "beside.py").write_text("MORE = 1 - 1\n")
    alone = store.find_all(grid.jobs())
    assert {cell.key for cell in alone.values()} == newer
    grid.content = both
    assert {cell.key for cell in store.find_all(grid.jobs()).values()} == older
    # Where this version of the code has all, nothing older is counted.
    grid.run()
    jobs = grid.jobs()
    store = Store(grid.folder / "out", None, "any")
    assert {c.key for c in store.find_all(jobs).values()} == {j.key for j in jobs}


def test_a_file_in_the_options_decides_by_what_is_in_it(grid: Grid) -> None:
    file = grid.folder / "effects.yaml"
    file.write_text("friction: 1")
    grid.content["jobs"]["first"]["options"]["domain"] = str(file)
    before = [job.key for job in grid.jobs()]
    moved = file.rename(grid.folder / "moved.yaml")
    grid.content["jobs"]["first"]["options"]["domain"] = str(moved)
    assert [job.key for job in grid.jobs()] == before
    moved.write_text("friction: 2")
    assert not {job.key for job in grid.jobs()} & set(before)


def test_committed_cells_are_found_and_stand(grid: Grid) -> None:
    cells = grid.folder / "cells"
    grid.run(f"cells={cells}")
    assert len(list(cells.glob("*.json"))) == 9
    shutil.rmtree(grid.folder / "out")
    assert grid.run(f"cells={cells}") == []
    assert "| beta 4 | 60% [35%, 85%] | 50% | 3 |" in grid.table
    # A new second stage needs the first one's folder, which is gone; its result is not
    # measured anew.
    (path,) = cells.glob("first_seed2-*.json")
    path.write_text(path.read_text().replace('"successes":2', '"successes":7'))
    grid.content["over"]["beta"] = [0, 4, 5]
    assert len(grid.run(f"cells={cells}")) == 6
    assert "| first | 37% " in grid.table


def test_what_began_from_another_run_than_its_cell_shows_is_named(
    grid: Grid, capsys: pytest.CaptureFixture[str]
) -> None:
    cells = grid.folder / "cells"
    grid.run(f"cells={cells}")
    assert "Begun from another run" not in grid.table
    shutil.rmtree(grid.folder / "out")
    # As where another processor rounds differently: seed 2 came to 7 there.
    (path,) = cells.glob("first_seed2-*.json")
    path.write_text(path.read_text().replace('"successes":2', '"successes":7'))
    grid.content["over"]["beta"] = [0, 5]
    grid.content["table"].pop("differences")
    grid.run(f"cells={cells}")
    said = capsys.readouterr().err
    assert "first_seed2 came to something else than its cell, which stands" in said
    assert "first_seed1 came to something else" not in said
    ending = "which came to something else (2): second_seed2_beta0, second_seed2_beta5."
    assert grid.table.endswith(f"{ending}\n")


def test_a_part_runs_alone_and_the_tables_are_of_all(grid: Grid) -> None:
    ran = grid.run("jobs=1", "only=[seed=3,seed=1,beta=4]")
    assert ran == ["first 1", "first 3", "second 1 4", "second 3 4"]
    assert "| beta 4 | 60% [0%, 100%] | 50% | 2 of 3: 1 missing |" in grid.table
    assert sorted(grid.run()) == ["first 2", "second 1 0", *ALL[5:8]]


@pytest.mark.parametrize("given", ["seed", "who=1", "seed=4", "=1"])
def test_a_part_that_is_none_is_refused(
    grid: Grid, capsys: pytest.CaptureFixture[str], given: str
) -> None:
    grid.run_and_fail(f"only=[{given}]")
    assert f"only='{given}'" in capsys.readouterr().err
    assert not (grid.folder / "out").exists()


def test_a_plan_says_what_would_run_and_runs_nothing(
    grid: Grid, capsys: pytest.CaptureFixture[str]
) -> None:
    assert grid.run("dry=true", "jobs=2") == []
    said = capsys.readouterr().err
    assert "first: 3 of 3 jobs to run, 1.0 minutes each (expected)" in said
    assert "second: 6 of 6 jobs to run, 2.0 minutes each (expected)" in said
    assert "0.1 hours, 2 jobs at once" in said  # 3 + 12 minutes
    assert not (grid.folder / "out").exists()


# -- In which order, and how long ------------------------------------------------------


def test_the_cheapest_run_first_but_none_before_what_it_needs(grid: Grid) -> None:
    grid.content["jobs"]["first"]["minutes"] = 3
    jobs = grid.content["jobs"]
    alone = {key: v for key, v in jobs["second"]["options"].items() if key != "after"}
    jobs["alone"] = {
        "script": "job.py",
        "minutes": 2.5,
        "options": alone | {"who": "alone {seed}", "solves": 0},
    }
    assert grid.run("jobs=1") == [
        *("first 1", "second 1 0", "second 1 4"),
        *("first 2", "second 2 0", "second 2 4"),
        *("first 3", "second 3 0", "second 3 4"),
        *("alone 1", "alone 2", "alone 3"),
    ]


def test_no_job_starts_after_the_hours_are_over(grid: Grid) -> None:
    out = grid.folder / "out"
    store = Store(out, None)
    plan = make_plan(grid.jobs(), store)
    # A clock that goes forward by an hour whenever it is read.
    hours = iter(range(100))
    clock = lambda: 3600.0 * next(hours)  # noqa: E731
    Queue(plan, store, jobs=1, hours=1.5, nice=0, clock=clock).run()
    assert grid.ran() == ["first 1"]  # begun at one hour, finished after more
    assert grid.run("hours=0") == []
    assert "| first | 10% | 10% | 1 of 3: 2 missing |" in grid.table


def test_measured_minutes_replace_the_expected_ones(
    grid: Grid, capsys: pytest.CaptureFixture[str]
) -> None:
    grid.content["over"]["seed"] = [1]
    grid.run()
    grid.content["over"]["seed"] = [1, 2]
    capsys.readouterr()
    grid.run("dry=true")
    said = capsys.readouterr().err
    assert "first: 1 of 2 jobs to run, 0.0 minutes each (measured)" in said


# -- What goes wrong -------------------------------------------------------------------


def test_failed_and_missing_cells_stay_in_the_table_and_logs_are_kept(
    grid: Grid, capsys: pytest.CaptureFixture[str]
) -> None:
    grid.content["over"]["fail"] = ["false"]
    grid.content["jobs"]["first"]["options"]["fail"] = "{fail}"
    grid.content["table"]["by"] = ["fail"]
    grid.content["over"]["fail"] = ["false", "true"]
    grid.run_and_fail()
    good, bad = grid.table.split("## fail true")
    assert "| first | 20% [0%, 45%] | 10% | 3 |" in good
    # Nothing is known of the domain where no run has finished.
    assert "| first | missing | - | 0 of 3: 3 failed |" in bad
    assert "| beta 0 | missing | - | 0 of 3: 3 missing |" in bad
    assert "| beta 4 - first | missing | 0 |" in bad
    (log,) = (grid.folder / "out").glob("jobs/first_seed1_failtrue-*/log.txt")
    assert "no luck" in log.read_text()
    said = capsys.readouterr().err
    assert f"its log is {log}" in said
    assert said.endswith(
        "error: 3 of 18 jobs failed; all others are in the table, and the same command "
        "tries these again.\n"
    )
    # The next call tries again, and keeps what it said before.
    assert grid.run_and_fail("jobs=1") == ["first 1", "first 2", "first 3"]
    assert log.read_text().count("no luck") == 2


def test_a_job_that_dies_is_tried_again_once_from_where_it_was(
    grid: Grid, capsys: pytest.CaptureFixture[str]
) -> None:
    # The first dies once, in the middle; the second whenever it runs.
    dies = """
if given["who"] == "first 2" or (given["who"] == "first 1" and "resume" not in given):
    os.kill(os.getpid(), 9)
"""
    script = SCRIPT.replace("EPISODES = 10\n", dies + "EPISODES = 10\n")
    (grid.folder / "job.py").write_text(script)
    del grid.content["jobs"]["second"], grid.content["table"]["methods"]["beta {beta}"]
    del grid.content["table"]["differences"], grid.content["over"]["beta"]
    assert grid.run_and_fail("jobs=1") == [
        *("first 1", "again first 1"),
        *("first 2", "again first 2"),
        "first 3",
    ]
    said = capsys.readouterr().err
    assert "first_seed1 died of SIGKILL and is tried again" in said
    assert "first_seed2 failed: it ended with status -9" in said
    assert "2 of 3: 1 failed" in grid.table
    (cell,) = (grid.folder / "out").glob("jobs/first_seed1-*/cell.json")
    assert json.loads(cell.read_text())["attempts"] == 2


def test_a_job_without_results_has_failed(
    grid: Grid, capsys: pytest.CaptureFixture[str]
) -> None:
    (grid.folder / "job.py").write_text(SCRIPT.replace('{"rows": rows}', "{}"))
    grid.run_and_fail()
    assert "results.json' lacks 'rows'" in capsys.readouterr().err
    assert "| first | missing | - | 0 of 3: 3 failed |" in grid.table


def test_a_job_may_make_data_that_others_read(grid: Grid) -> None:
    (grid.folder / "data.py").write_text(
        "import pathlib, sys\n"
        "given = dict(argument.split('=', 1) for argument in sys.argv[1:])\n"
        "pathlib.Path(given['out']).mkdir()\n"
        "(pathlib.Path(given['out']) / 'rows.txt').write_text(given['seed'])\n"
    )
    data = {"script": "data.py", "results": False, "options": {"seed": "{seed}"}}
    first = grid.content["jobs"]["first"]
    first["options"]["data"] = "{data}"
    grid.content["jobs"] = {"data": data, **grid.content["jobs"]}
    assert grid.run("jobs=1") == ALL
    made = sorted((grid.folder / "out" / "jobs").glob("data_seed*/run/rows.txt"))
    assert [path.read_text() for path in made] == ["1", "2", "3"]
    assert "| beta 4 |" in grid.table
    assert grid.run() == []
    # It cannot be compared, and to say that it makes results does not help.
    grid.content["table"]["methods"]["data"] = {"job": "data"}
    with pytest.raises(ConfigError, match="has job 'data', which has no results"):
        read_experiment(grid.write())


def test_code_that_changes_while_a_job_runs_is_no_result_of_it(
    grid: Grid, capsys: pytest.CaptureFixture[str]
) -> None:
    script = SCRIPT + "Path(beside.__file__).write_text('MORE = 3')\n"
    (grid.folder / "job.py").write_text(script)
    grid.run_and_fail("jobs=1")
    assert "its code was changed while it ran" in capsys.readouterr().err
    assert "| first | missing | - | 0 of 3: 3 failed |" in grid.table


@pytest.fixture
def running(grid: Grid) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """Start a runner in another process; return it in the midst of its first job."""
    grid.content["over"] = {"seed": [1], "beta": [0]}
    grid.content["jobs"]["first"]["options"]["steps"] = 40  # two seconds
    grid.content["table"].pop("differences")
    command = [sys.executable, str(RECIPES / "compare.py"), *grid.arguments()]
    # Where tests run in the background of a shell, a child would ignore Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    runner = subprocess.Popen(command, start_new_session=True)
    signal.signal(signal.SIGINT, before)
    steps = None
    while steps is None or len(steps.read_text().split()) < 3:
        assert runner.poll() is None
        steps = next((grid.folder / "out").glob("jobs/*/part/steps.txt"), None)
        time.sleep(0.01)
    yield runner, steps
    runner.kill()


def check_resumed(grid: Grid) -> None:
    """Check that the job goes on where it was, and that what needs it follows."""
    assert grid.run() == ["again first 1", "second 1 0"]
    done = next((grid.folder / "out").glob("jobs/first*/run/steps.txt"))
    assert done.read_text().split() == [str(step) for step in range(40)]


def test_a_killed_runner_takes_its_jobs_along_and_they_are_resumed(
    grid: Grid, running: tuple[subprocess.Popen[bytes], Path]
) -> None:
    runner, steps = running
    os.kill(runner.pid, signal.SIGKILL)
    runner.wait()
    time.sleep(0.3)
    stopped = steps.read_text()
    time.sleep(0.3)
    assert steps.read_text() == stopped
    assert len(stopped.split()) < 40
    check_resumed(grid)


@pytest.mark.parametrize("everyone", [True, False], ids=["group", "runner"])
def test_an_interrupted_runner_stops_its_jobs_and_writes_the_table(
    grid: Grid, running: tuple[subprocess.Popen[bytes], Path], everyone: bool
) -> None:
    # Ctrl-C in a terminal reaches jobs, too; a signal to the runner does not.
    runner, steps = running
    (os.killpg if everyone else os.kill)(runner.pid, signal.SIGINT)
    assert runner.wait() == 130
    assert "| first | missing | - | 0 of 1: 1 missing |" in grid.table
    attempts = json.loads((steps.parents[1] / "attempts.json").read_text())["attempts"]
    assert len(attempts) == 1
    assert attempts[0]["cpu_seconds"] > 0
    check_resumed(grid)


def test_a_job_that_cannot_be_resumed_begins_anew(grid: Grid) -> None:
    job = next(iter(grid.jobs()))
    part = grid.folder / "out" / "jobs" / job.folder / "part"
    part.mkdir(parents=True)
    (part / "half.txt").write_text("cut off before run.json was there")
    assert "first 1" in grid.run()
    assert not (part.with_name("run") / "half.txt").exists()


# -- What a file may say ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda c: c["jobs"]["second"]["options"].update(seed="{sed}"),
            "job second names {sed} (did you mean 'seed'?), which is no variable and "
            "no job above it; known: seed, beta, first",
        ),
        (
            lambda c: c["jobs"]["first"]["options"].update(after="{second}"),
            "job first names {second} (did you mean 'seed'?), which is no variable and "
            "no job above it; known: seed, beta.",
        ),
        (
            lambda c: c["jobs"]["first"].update(scripts="x.py"),
            "job first has an unknown 'scripts' (did you mean 'script'?)",
        ),
        (
            lambda c: c["jobs"]["first"].update(script="nowhere.py"),
            "job first has script 'nowhere.py', which is no file here",
        ),
        (
            lambda c: c["jobs"]["first"]["options"].update(out="here"),
            "job first cannot have the option out, which the runner decides",
        ),
        (
            lambda c: c["jobs"]["first"]["options"].update(who="{0}"),
            "job first: braces hold '0', which is no name",
        ),
        (lambda c: c["over"].update(seed=[1, 1]), "over seed holds a value twice"),
        (  # tables call both by the name of the file
            lambda c: c["over"].update(place=["a/there.yaml", "b/there.yaml"]),
            "over place holds a value twice",
        ),
        (lambda c: c["over"].update(seed=3), "over seed is no list of values"),
        (
            lambda c: c.update(without=[{"seed": 7}]),
            "without has seed: 7, which is no value of it; known: 1, 2, 3",
        ),
        (
            lambda c: c.update(without=[{"sed": 1}]),
            "without has an unknown 'sed' (did you mean 'seed'?)",
        ),
        (lambda c: c.update(without=["seed"]), "without holds 'seed', which is no"),
        (lambda c: c.update(files={"a.pth": 12}), "files has a.pth: 12; give its SHA"),
        (
            lambda c: c["table"].update(by="beta", mean="seed"),
            "table has mean: 'seed', which is none of by; known: beta",
        ),
        (
            lambda c: c["table"].update(axis="beta"),
            "table has axis: 'beta', which is none of by; known: none",
        ),
        (
            lambda c: c["table"].update(published=[{"source": "a paper"}]),
            "table's published {'source': 'a paper'} is not of the form {source: WHO, ",
        ),
        (
            lambda c: c["table"].update(
                published=[{"source": "p", "at": {"beta": 3}, "success": {"frst": 0.1}}]
            ),
            "table's published names 'frst' (did you mean 'first'?), which is no ",
        ),
        (
            lambda c: c["table"]["methods"]["first"].update(at={"beta": 3}),
            "table's method 'first''s at has beta: 3, which is no value of it; known: ",
        ),
        (
            lambda c: c["table"].update(methods={"rl": {"job": "second"}}),
            "table's method 'rl' mixes all values of beta; put {beta} into its label, "
            "or the variable into by",
        ),
        (
            lambda c: c["table"].update(differences=[["beta 3", "first"]]),
            "table's difference names 'beta 3' (did you mean 'beta 4'?), which is no "
            "method; known: beta 0, beta 4, first",
        ),
        (
            lambda c: c["table"].update(predictions=[{"gain": ["first"]}]),
            "table's prediction {'gain': ['first']} is not of the form {gain: [A, B], ",
        ),
        (
            lambda c: c["table"].update(seed="sed"),
            "table names 'sed' (did you mean 'seed'?), which is no variable",
        ),
        (lambda c: c.pop("over"), "over is missing, or is no mapping of names"),
    ],
)
def test_what_is_wrong_in_a_file_is_said_before_anything_runs(
    grid: Grid,
    capsys: pytest.CaptureFixture[str],
    change: Any,
    message: str,
) -> None:
    change(grid.content)
    with pytest.raises(SystemExit) as ended:
        grid.run()
    assert ended.value.code == 2
    assert message in capsys.readouterr().err
    assert not (grid.folder / "out").exists()


def test_a_method_that_a_job_does_not_report_is_named(
    grid: Grid, capsys: pytest.CaptureFixture[str]
) -> None:
    grid.content["table"]["methods"]["first"]["method"] = "sft"
    with pytest.raises(SystemExit):
        grid.run()
    said = capsys.readouterr().err
    assert "first_seed1 has no result of method 'sft'" in said
    assert "it has first." in said


# -- The experiments of the repository -------------------------------------------------

EXPERIMENTS = sorted((RECIPES.parent / "benchmarks" / "experiments").glob("*.yaml"))
TUNED_ON = range(100, 120)  # no result may be of a seed that settings were chosen on


@pytest.mark.parametrize("path", EXPERIMENTS, ids=lambda path: path.stem)
def test_an_experiment_has_options_that_its_scripts_take_and_no_tuning_seed(
    path: Path,
) -> None:
    experiment = read_experiment(path)
    assert not set(experiment.over[experiment.table.seed]) & set(TUNED_ON)
    for job in {job.kind.name: job for job in expand(experiment)}.values():
        check_options(job, job.options(dict.fromkeys(job.needs, "folder")))


def check_options(job: Job, options: dict[str, str]) -> Any:
    """Read a job's options as its script does; return its configuration."""
    spec = importlib.util.spec_from_file_location("script", job.kind.path)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    sys.modules["script"] = script
    spec.loader.exec_module(script)
    if not job.kind.results:
        options["out"] = "folder"  # of the data, which the runner gives
    given = [f"{key}={value}" for key, value in options.items()]
    return parse(script.Config, given, job.kind.path)


def test_the_file_in_the_documentation_can_be_read(tmp_path: Path) -> None:
    page = (RECIPES.parent / "docs" / "recipes.md").read_text("utf-8")
    path = tmp_path / "anchor.yaml"
    path.write_text(page.split("```yaml\n")[1].split("```")[0])
    experiment = read_experiment(path)
    names = [job.name for job in expand(experiment)]
    assert len(names) == 5 + 10
    assert names[5:7] == ["rl_seed0_beta0", "rl_seed0_beta0.2"]


def test_the_smallest_form_of_an_experiment_is_one_cell_of_everything(
    grid: Grid, capsys: pytest.CaptureFixture[str]
) -> None:
    assert len(grid.run("smallest=true")) == 2  # of the first values, one of each kind
    with pytest.raises(SystemExit):
        grid.run("smallest=true", f"cells={grid.folder / 'kept'}")
    assert "would keep results that mean nothing" in capsys.readouterr().err


@pytest.mark.parametrize("path", EXPERIMENTS, ids=lambda path: path.stem)
def test_every_experiment_has_a_smallest_form_that_its_scripts_take(path: Path) -> None:
    jobs = expand(smallest(read_experiment(path)))
    assert len(jobs) == len({job.kind.name for job in jobs})
    for job in jobs:
        options = job.options(dict.fromkeys(job.needs, "folder"))
        config = check_options(job, options)
        assert getattr(config, "iterations", 2) <= 2
        assert getattr(config, "updates", 10) <= 10
        for name in ("sim_demos", "real_demos", "heldout_demos"):
            given = getattr(config, name, None)
            # A number where a script records them itself, else a folder.
            assert given == 1 if job.kind.path.stem == "quickstart" else given != "1", (
                name
            )
        assert getattr(config, "episodes", "") in (4, "", "0-3")
        assert getattr(config, "eval_episodes", 1) <= 1
