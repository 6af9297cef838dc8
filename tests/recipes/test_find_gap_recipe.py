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

import numpy as np
import pytest
from recipe_cases import RECIPES, refused, start, tree

from rlco.gap.log import Array
from rlco.physics.effects import EFFECTS, AppliedEffect

sys.path.insert(0, str(Path(__file__).parents[1] / "gap"))
from small_problems import ARM, arm_problem

Capture = pytest.CaptureFixture[str]
DRAG = RECIPES.parent / "docs" / "my_effect.py"
DAMPING = AppliedEffect("viscous_damping", "shoulder", {"damping": 0.6})


def write_case(folder: Path, *hidden: AppliedEffect) -> list[str]:
    """Write the small arm and recordings of it; return the recipe's arguments."""
    (folder / "logs").mkdir(parents=True)
    (folder / "arm.xml").write_text(ARM)
    for recording in arm_problem(*hidden, recordings=6, seconds=4.0).log.recordings:
        columns = [recording.time[:, None], recording.position, recording.command]
        rows: Array = np.concatenate([np.asarray(c) for c in columns], axis=1)
        header = "time,shoulder,elbow,cmd_shoulder,cmd_elbow"
        file = folder / "logs" / f"{recording.name}.csv"
        np.savetxt(file, rows, delimiter=",", header=header, comments="")
    return [f"model={folder / 'arm.xml'}", f"data={folder / 'logs'}"]


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    return write_case(tmp_path_factory.mktemp("damped"), DAMPING)


@pytest.fixture(scope="module")
def out(case: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("find_gap") / "out"
    start("find_gap", *case, f"out={folder}", "threads=1")
    return folder


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
        ("effects=nowhere.py", ["'nowhere.py'", "no file"]),
        (f"effects={__file__}", ["registers no effect"]),
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


ONE_THREAD = {**os.environ, "OMP_NUM_THREADS": "1"}


def command(case: list[str], folder: Path) -> list[str]:
    script = str(RECIPES / "find_gap.py")
    return [sys.executable, script, *case, f"out={folder}", "threads=1"]


def test_an_effect_of_ones_own_is_found_and_torch_is_not_needed(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    drag = AppliedEffect("quadratic_drag", "elbow", {"drag": 0.25})
    try:
        importlib.import_module("find_gap").register_effects(str(DRAG))
        case = write_case(tmp_path / "drag", drag)
    finally:
        EFFECTS.pop("quadratic_drag", None)
    # A process of its own knows the effect by its file alone.
    words = "import sys, runpy; sys.argv = sys.argv[1:]\n"
    words += "runpy.run_path(sys.argv[0], run_name='__main__')\n"
    words += "assert 'torch' not in sys.modules, 'torch was imported'"
    program = [sys.executable, "-c", words, *command(case, folder)[1:]]
    subprocess.run([*program, f"effects={DRAG}"], check=True, env=ONE_THREAD)
    (effect,) = json.loads((folder / "report.json").read_text())["effects"]
    assert (effect["name"], effect["target"]) == ("quadratic_drag", "elbow")
    assert effect["parameters"]["drag"]["value"] == pytest.approx(0.25, rel=0.1)


def test_ctrl_c_writes_the_best_so_far_however_often(
    case: list[str], tmp_path: Path
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
        process.send_signal(signal.SIGINT)
        time.sleep(0.2)
    told = process.stderr.read()
    assert process.wait() == 130, told
    report = json.loads((folder / "report.json").read_text())
    assert report["complete"] is False
    assert "stopped" in (folder / "report.html").read_text("utf-8")
    assert (folder / "model.xml").exists()
    assert (folder / "effects.yaml").exists()


def test_only_the_first_ctrl_c_ends_what_runs() -> None:
    find_gap = importlib.import_module("find_gap")
    # A shell's background job is started deaf to Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with find_gap.one_interrupt():
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)  # while the best so far is written
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
