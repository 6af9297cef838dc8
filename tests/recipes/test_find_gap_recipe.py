"""find_gap from its command line: its files, its refusals, its interruption."""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hidden_arms import TWO_LINKS, record
from recipe_cases import RECIPES, refused, start, tree
from small_problems import ARM, arm_problem

from rlco.gap import workflow
from rlco.gap.logs.log import Array, Log
from rlco.physics.effects import AppliedEffect

pytestmark = pytest.mark.slow

Capture = pytest.CaptureFixture[str]
DRAG = RECIPES.parent / "docs" / "my_effect.py"
DAMPING = AppliedEffect("viscous_damping", "shoulder", {"damping": 0.6})


def arguments(folder: Path, *hidden: AppliedEffect) -> list[str]:
    """Write the small arm and recordings of it; return the recipe's arguments."""
    return write_log(folder, ARM, arm_problem(*hidden, recordings=6, seconds=4.0).log)


def write_log(folder: Path, xml: str, log: Log) -> list[str]:
    """Write an arm and recordings of it; return the recipe's arguments."""
    (folder / "logs").mkdir(parents=True)
    (folder / "arm.xml").write_text(xml)
    for recording in log.recordings:
        columns = [recording.time[:, None], recording.position, recording.command]
        rows: Array = np.concatenate([np.asarray(c) for c in columns], axis=1)
        header = "time,shoulder,elbow,cmd_shoulder,cmd_elbow"
        file = folder / "logs" / f"{recording.name}.csv"
        np.savetxt(file, rows, delimiter=",", header=header, comments="")
    return [f"model={folder / 'arm.xml'}", f"data={folder / 'logs'}"]


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    return arguments(tmp_path_factory.mktemp("damped"), DAMPING)


@pytest.fixture(scope="module")
def searched(
    case: list[str], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, list[str]]:
    """Search once, without torch; return the folder and the lines that were printed."""
    folder = tmp_path_factory.mktemp("find_gap") / "out"
    return folder, without_torch(case, folder)


@pytest.fixture
def out(searched: tuple[Path, list[str]]) -> Path:
    return searched[0]


def test_what_was_hidden_is_found_and_written(out: Path) -> None:
    report = json.loads((out / "report.json").read_text())
    assert report["complete"] is True
    assert report["verdict"] == "named"
    (effect,) = report["effects"]
    assert (effect["name"], effect["target"]) == ("viscous_damping", "shoulder")
    assert effect["parameters"]["damping"]["value"] == pytest.approx(0.6, rel=0.05)
    gap = report["gap"]
    assert gap["after"]["heldout_rms"] < 0.1 * gap["before"]["heldout_rms"]
    assert report["where"][0]["target"] == "shoulder"
    assert report["where"][0]["regime"] == "fast"


def test_all_files_lie_in_the_folder(out: Path) -> None:
    found = {path.name for path in out.iterdir()}
    files = {"report.json", "report.html", "model.xml", "model.diff", "effects.yaml"}
    assert files <= found
    assert "viscous_damping" in (out / "effects.yaml").read_text()
    assert "Missing from the model: viscous damping at shoulder" in (
        out / "report.html"
    ).read_text("utf-8")


def test_a_model_that_diverges_has_a_report_and_no_corrected_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case, folder = arguments(tmp_path / "case"), tmp_path / "out"
    model = tmp_path / "case" / "arm.xml"
    euler = ARM.replace('timestep="0.005" integrator="implicitfast"', 'timestep="0.02"')
    model.write_text(euler.replace('kp="40"', 'kp="9000"'))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    start("find_gap", *case, f"out={folder}", "threads=1")
    assert set(tree(folder)) == {"report.json", "report.html"}
    found = json.loads((folder / "report.json").read_text())
    assert (found["verdict"], found["complete"]) == ("unstable_model", True)
    assert found["unstable"]["timestep"] < 0.02
    assert len(found["unstable"]["recordings"]) == 6
    page = (folder / "report.html").read_text("utf-8")
    assert "nothing is searched in a simulation that diverges" in page
    # MuJoCo would leave a log of its own where the command was typed.
    assert not tree(tmp_path / "here")


def test_an_existing_folder_is_left_as_it_is(
    capsys: Capture, case: list[str], tmp_path: Path
) -> None:
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "report.json").write_text("precious")
    line = refused(capsys, "find_gap", *case, f"out={kept}")
    assert f"{str(kept)!r} exists and is not overwritten" in line
    assert tree(kept) == {"report.json": b"precious"}


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("spreads=0.1", ["'spreads'", "did you mean 'spread'"]),
        ("model=nowhere.xml", ["'nowhere.xml'", "MJCF"]),
        ("data=nowhere", ["'nowhere'"]),
        ("rename=a", ["rename='a'", "THEIRS:OURS"]),
        ("rename=elbow:elbo", ["elbo"]),
        ("angles=grad", ["'grad'", "'degrees'", "'radians'"]),
        ("effects=nowhere.py", ["'nowhere.py'", "is not a file"]),
        (f"effects={__file__}", ["registers no effect"]),
        ("effects_code=nowhere.py", ["'nowhere.py'", "is not a file"]),
        ("spread=0.9", ["spread", "0.5"]),
    ],
)
def test_wrong_input_is_one_sentence_and_makes_nothing(
    capsys: Capture, case: list[str], tmp_path: Path, argument: str, words: list[str]
) -> None:
    folder = tmp_path / "out"
    given = {text.partition("=")[0]: text for text in [*case, argument]}
    line = refused(capsys, "find_gap", *given.values(), f"out={folder}")
    for word in words:
        assert word in line, line
    assert not folder.exists()


def test_folders_above_the_report_are_not_left_behind_either(
    capsys: Capture, case: list[str], tmp_path: Path
) -> None:
    refused(capsys, "find_gap", *case, f"out={tmp_path / 'a' / 'b'}", "rename=a")
    assert not (tmp_path / "a").exists()


def test_the_disagreement_is_told_before_the_search_and_the_verdict_after(
    searched: tuple[Path, list[str]],
) -> None:
    folder, lines = searched
    assert "before any fit, the disagreement is" in lines
    told = lines[lines.index("before any fit, the disagreement is") + 1 :]
    assert "% in shoulder" in told[0]
    verdict = "Missing from the model: viscous damping at shoulder."
    assert verdict in told
    assert any("damping 0." in line for line in told[told.index(verdict) :])
    assert told[-1] == f"report: {folder / 'report.html'}"


ONE_THREAD = {**os.environ, "OMP_NUM_THREADS": "1"}


def command(case: list[str], folder: Path) -> list[str]:
    script = str(RECIPES / "find_gap.py")
    less = ["threads=1", "film=false"]
    return [sys.executable, script, *case, f"out={folder}", *less]


def without_torch(case: list[str], folder: Path, *more: str) -> list[str]:
    """Search in a process that fails if it imported torch; return what it printed."""
    words = "import sys, runpy; sys.argv = sys.argv[1:]\n"
    words += "runpy.run_path(sys.argv[0], run_name='__main__')\n"
    words += "assert 'torch' not in sys.modules, 'torch was imported'"
    program = [sys.executable, "-c", words, *command(case, folder)[1:], *more]
    done = subprocess.run(
        program, env=ONE_THREAD, stderr=subprocess.PIPE, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stderr.splitlines()


def dragged(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Hold the elbow back with the square of its speed."""
    data.qfrc_applied[1] = -0.25 * abs(data.qvel[1]) * data.qvel[1]


def test_an_effect_of_ones_own_is_found(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    case = write_log(tmp_path / "drag", TWO_LINKS, record(act=dragged))
    # A process of its own knows the effect by its file alone.
    without_torch(case, folder, f"effects_code={DRAG}")
    (effect,) = json.loads((folder / "report.json").read_text())["effects"]
    assert (effect["name"], effect["target"]) == ("quadratic_drag", "elbow")
    assert effect["parameters"]["drag"]["value"] == pytest.approx(0.25, rel=0.1)


@pytest.mark.parametrize(
    ("number", "status"),
    [
        (signal.SIGINT, 130),
        pytest.param(signal.SIGTERM, 143, marks=pytest.mark.thorough),
    ],
)
def test_ctrl_c_or_sigterm_writes_the_best_so_far_however_often(
    case: list[str], tmp_path: Path, number: signal.Signals, status: int
) -> None:
    folder = tmp_path / "out"
    process = subprocess.Popen(
        command(case, folder), env=ONE_THREAD, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    while "before any fit" not in (line := process.stderr.readline()):
        assert line, "it ended before it began to search"
    time.sleep(0.5)
    for _ in range(3):
        process.send_signal(number)
        time.sleep(0.2)
    told = process.stderr.read()
    assert process.wait() == status, told
    assert tree(tmp_path).keys() == {f"out/{name}" for name in tree(folder)}
    report = json.loads((folder / "report.json").read_text())
    assert report["complete"] is False
    assert "stopped" in (folder / "report.html").read_text("utf-8")
    assert (folder / "model.xml").exists()
    assert (folder / "effects.yaml").exists()


def test_only_the_first_ctrl_c_ends_what_runs_and_none_the_writing() -> None:
    find_gap = importlib.import_module("find_gap")
    # A shell's background job is started deaf to Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with find_gap.one_interrupt() as ends:
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGTERM)  # while the best so far is written
        assert ends.asked == [signal.SIGINT, signal.SIGTERM]
        with find_gap.one_interrupt() as ends:
            ends.held = True
            signal.raise_signal(signal.SIGTERM)  # while what was found is written
        assert ends.asked == [signal.SIGTERM]
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.thorough
def test_ctrl_c_after_the_search_loses_nothing(
    case: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Asked to end while its figures are prepared, it writes them, and then ends."""
    real = workflow.figure_data

    def interrupted(*given: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        return real(*given)

    monkeypatch.setattr(workflow, "figure_data", interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(SystemExit) as ended:
            start("find_gap", *case, f"out={tmp_path / 'out'}", "film=false")
    finally:
        signal.signal(signal.SIGINT, before)
    assert ended.value.code == 130
    assert json.loads((tmp_path / "out" / "report.json").read_text())["complete"]


@pytest.mark.thorough
def test_what_a_killed_search_left_is_begun_anew_or_refused(
    capsys: Capture, case: list[str], tmp_path: Path
) -> None:
    folder, part = tmp_path / "out", tmp_path / "out.unfinished"
    process = subprocess.Popen(
        command(case, folder), env=ONE_THREAD, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    while "before any fit" not in (line := process.stderr.readline()):
        assert line, "it ended before it began to search"
    line = refused(capsys, "find_gap", *case, f"out={folder}")
    assert "out.unfinished' is being written by another process" in line
    process.kill()
    process.communicate()
    assert not folder.exists()
    assert tree(part) == {}
    (part / "report.json").write_text("half")  # as one killed while it wrote leaves it
    line = refused(capsys, "find_gap", *case, f"out={folder}")
    assert (
        "out.unfinished' holds what was written by a process that did not end" in line
    )
    assert tree(tmp_path) == {"out.unfinished/report.json": b"half"}
    (part / "report.json").unlink()
    start("find_gap", *case, f"out={folder}", "threads=1")
    assert not part.exists()
    assert (folder / "effects.yaml").exists()
