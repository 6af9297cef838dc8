"""Faults of the machine below a run: one sentence, and all that was saved is there."""

from __future__ import annotations

import json
import logging
import os
import resource
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from toy_training import result, train

from rlco.errors import OutputExistsError, RlcoError
from rlco.run import Run, run_recipe
from rlco.runs import run_folder, whole_files
from rlco.runs.config import RunOptions
from rlco.runs.metrics import MetricsFile


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nothing happened to."""
    path = tmp_path_factory.mktemp("whole") / "run"
    train(RunOptions(out=str(path)))
    return path


def said(capsys: pytest.CaptureFixture[str], *arguments: str, status: int) -> str:
    """Run the toy training to its failure; return the sentence that it ends with."""
    with pytest.raises(SystemExit) as caught:
        run_recipe(train, RunOptions, arguments)
    assert caught.value.code == status
    text = capsys.readouterr().err
    assert "Traceback" not in text
    return text.split("error: ")[1]


def full(path: object) -> OSError:
    return OSError(28, "No space left on device", str(path))


# -- The disk ----------------------------------------------------------------------


def test_a_disk_that_fills_in_the_middle_of_a_row_loses_nothing(
    whole: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    append = MetricsFile.append

    def half(file: MetricsFile, step: int, row: dict[str, object]) -> None:
        if step == 3 and file.path.name == "metrics.csv":
            with file.path.open("a") as stream:
                stream.write("3,0.1")
            raise full(file.path)
        append(file, step, row)

    out = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(MetricsFile, "append", half)
        text = said(capsys, f"out={out}", status=1)
    assert "metrics.csv' cannot be written or read (No space left on device)" in text
    train(RunOptions(resume=str(out)))
    assert result(out) == result(whole)


def test_a_log_that_cannot_be_written_stops_no_run(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(handler: logging.FileHandler) -> None:
        raise full(handler.baseFilename)

    monkeypatch.setattr(logging.FileHandler, "flush", refuse)
    out = tmp_path / "run"
    logging.getLogger("rlco").setLevel(logging.INFO)
    with monkeypatch.context() as patch:
        patch.setattr("rlco.runs.progress.QUIET", 0.0)  # a line after each iteration
        train(RunOptions(out=str(out)))
    assert result(out) == result(whole)


def test_a_folder_that_became_read_only_is_one_sentence_and_is_resumed_later(
    whole: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out = tmp_path / "run"
    train(RunOptions(out=str(out)), 2)
    opened = Path.open

    def refuse(path: Path, mode: str = "r", **named: object) -> object:
        if "r" not in mode and "run" in path.parts:
            raise OSError(30, "Read-only file system", str(path))
        return opened(path, mode, **named)  # type: ignore[call-overload]

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", refuse)
        text = said(capsys, f"resume={out}", status=1)
    assert "cannot be written or read (Read-only file system)" in text
    train(RunOptions(resume=str(out)))
    assert result(out) == result(whole)


# -- Two runs ----------------------------------------------------------------------


def test_of_two_runs_that_begin_in_one_folder_the_second_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other one comes between the look whether it is there and the making of it."""
    out = tmp_path / "run"
    write = run_folder.write_text

    def slow(path: Path, text: str) -> None:
        if not out.exists():
            with monkeypatch.context() as patch:
                patch.setattr(run_folder, "write_text", write)
                patch.setattr(os, "getpid", lambda: 1)  # another process
                train(RunOptions(out=str(out)), 1)
        write(path, text)

    monkeypatch.setattr(run_folder, "write_text", slow)
    with pytest.raises(OutputExistsError):
        train(RunOptions(out=str(out)))
    assert json.loads((out / "run.json").read_text())["status"] == "finished"
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


# -- The clock ---------------------------------------------------------------------


def test_a_clock_that_goes_back_changes_nothing_but_stamps(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"
    train(RunOptions(out=str(out)), 2)
    before = json.loads((out / "run.json").read_text())["seconds"]
    now = time.time
    with monkeypatch.context() as patch:
        patch.setattr(time, "time", lambda: now() - 1e6)
        train(RunOptions(resume=str(out)))
    assert result(out) == result(whole)
    assert json.loads((out / "run.json").read_text())["seconds"] >= before


def test_a_clock_that_names_a_folder_twice_overwrites_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stamps = iter(["2026-01-01_00-00-00"] * 3 + ["2026-01-01_00-00-01"])
    monkeypatch.setattr(time, "strftime", lambda *_: next(stamps))
    made = [
        run_folder.create(None, "run", 0, "toy", tmp_path, {"a.txt": str(i)})
        for i in range(2)
    ]
    assert [path.name[:19] for path in made] == [
        "2026-01-01_00-00-00",
        "2026-01-01_00-00-01",
    ]
    assert [(path / "a.txt").read_text() for path in made] == ["0", "1"]


# -- Memory ------------------------------------------------------------------------


@pytest.fixture
def little_memory() -> Iterator[None]:
    """Allow this process two gigabytes more addresses than it has."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + 2 * 2**30
    resource.setrlimit(resource.RLIMIT_AS, (most, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, limits)


@pytest.mark.usefixtures("little_memory")
@pytest.mark.parametrize(
    "take",
    [lambda: np.ones(2**33), lambda: torch.ones(2**33), lambda: bytearray(2**36)],
    ids=["numpy", "torch", "python"],
)
def test_a_full_memory_is_one_sentence_and_loses_nothing(
    whole: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    take: object,
) -> None:
    log_timings = Run.log_timings

    def fill(run: Run, step: int, row: dict[str, float]) -> None:
        if step == 2:
            take()  # type: ignore[operator]
        log_timings(run, step, row)

    out = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(Run, "log_timings", fill)
        text = said(capsys, f"out={out}", status=1)
    assert text.startswith("there is not enough memory")
    assert json.loads((out / "run.json").read_text())["status"] == "failed"
    train(RunOptions(resume=str(out)))
    assert result(out) == result(whole)


def test_another_error_of_the_runtime_keeps_its_traceback() -> None:
    def main(_: RunOptions) -> None:
        raise RuntimeError("a defect")

    with pytest.raises(RuntimeError, match="a defect"):
        run_recipe(main, RunOptions, [])


# -- What is resumed ---------------------------------------------------------------


def test_a_refused_resume_does_not_hold_the_run(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"
    train(RunOptions(out=str(out)), 2)
    table = (out / "metrics.csv").read_bytes()
    (out / "metrics.csv").write_text("step,loss\nx,1\n")
    with pytest.raises(RlcoError, match=r"metrics\.csv"):
        train(RunOptions(resume=str(out)))
    (out / "metrics.csv").write_bytes(table)
    train(RunOptions(resume=str(out)))
    assert result(out) == result(whole)


def test_a_text_appears_whole_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "run.json"
    whole_files.write_text(file, "before")

    def refuse(part: Path, path: Path) -> None:
        raise full(path)

    monkeypatch.setattr(whole_files, "put_in_place", refuse)
    with pytest.raises(OSError, match="No space left"):
        whole_files.write_text(file, "after")
    assert file.read_text() == "before"
