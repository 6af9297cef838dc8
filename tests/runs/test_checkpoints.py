"""Checkpoints: whatever a kill, a power cut or a bad disk leaves, nothing is lost."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path

import pytest
import torch
from power_cut import Died, Disk
from toy_training import ITERATIONS, result, train

from rlco.errors import CheckpointError
from rlco.run import Run
from rlco.runs.config import RunOptions


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nothing happened to."""
    path = tmp_path_factory.mktemp("whole") / "run"
    train(RunOptions(out=str(path)))
    return path


@pytest.fixture
def stopped(tmp_path: Path) -> Path:
    """A run that was stopped after iteration 2, with the checkpoints of 1 and 2."""
    path = tmp_path / "run"
    train(RunOptions(out=str(path)), 2)
    (path / "weights.txt").unlink()
    return path


def names(run: Path) -> list[str]:
    return sorted(path.name for path in (run / "checkpoints").iterdir())


# -- Killed, and cut off from power, at every call ---------------------------------


class NoBoard:
    """In place of TensorBoard's writer, which takes most of so short a training."""

    def __init__(self, *_: object) -> None:
        pass

    def add_scalar(self, *_: object) -> None:
        pass

    close = __init__


def die(place: Path, call: int, patch: pytest.MonkeyPatch) -> Disk | None:
    """Train until a call of the system; None where it ends before that."""
    disk = Disk(place, die_at=call)
    try:
        with patch.context() as here:
            disk.watch(here)
            train(RunOptions(out=str(place / "run")))
    except Died:
        return disk
    disk.close()
    return None


@pytest.mark.slow
def test_a_run_that_ends_at_any_call_of_the_system_is_resumed_exactly(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed there, or cut off from power, with the fewest or all names on the disk."""
    monkeypatch.setattr("torch.utils.tensorboard.SummaryWriter", NoBoard)
    resumed = Counter[str]()
    for call in count(1):
        killed = tmp_path / f"{call} killed"
        killed.mkdir()
        disk = die(killed, call, monkeypatch)
        if disk is None:
            break
        left = {"killed": killed}
        for names in ("late", "early"):
            target = tmp_path / f"{call} {names}"
            left[names] = disk.after_power_cut(target, names=names)
        disk.close()
        for end, place in left.items():
            run = place / "run"
            resumed[end] += run.exists()
            train(RunOptions(**{"resume" if run.exists() else "out": str(run)}))
            assert result(run) == result(whole), f"{end} at call {call}"
            shutil.rmtree(place)
    assert min(resumed.values()) > 40


# -- Damaged on the disk -------------------------------------------------------------


def flip(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 4]) + content[middle + 1 :]


DAMAGES: list[Callable[[bytes], bytes]] = [
    flip,
    lambda content: content[: len(content) // 2],
    lambda content: content[:100] + content[140:],  # bytes are missing in the middle
    lambda content: b"",
    lambda content: bytes(len(content)),
    lambda content: content.replace(b'"checksum"', b'"chacksum"'),
]


@pytest.mark.parametrize("damage", DAMAGES)
def test_the_checkpoint_before_a_damaged_one_is_gone_on_from(
    whole: Path, stopped: Path, damage: Callable[[bytes], bytes]
) -> None:
    newest = stopped / "checkpoints/step_0000002.safetensors"
    newest.write_bytes(damage(newest.read_bytes()))
    train(RunOptions(resume=str(stopped)))
    assert result(stopped) == result(whole)
    told = (stopped / "log.txt").read_text().split("WARNING rlco.run: ")[1]
    assert told.startswith(f"checkpoint '{newest}' ")
    assert "goes on from iteration 1 and does what came after again." in told
    # It is kept aside: someone may want to know.
    aside = f"damaged_{newest.name}"
    assert names(stopped) == [aside, newest.name, "step_0000003.safetensors"]


def test_where_every_checkpoint_is_damaged_the_run_is_left_as_it_is(
    whole: Path, stopped: Path
) -> None:
    saved = {p: p.read_bytes() for p in (stopped / "checkpoints").iterdir()}
    for path, content in saved.items():
        path.write_bytes(flip(content))
    before = {p: p.read_bytes() for p in stopped.rglob("*") if p.is_file()}
    for _ in range(2):  # the refused run is not in use
        with pytest.raises(CheckpointError, match="cannot go on, as none of its check"):
            train(RunOptions(resume=str(stopped)))
        assert {p: p.read_bytes() for p in stopped.rglob("*") if p.is_file()} == before
    for path, content in saved.items():
        path.write_bytes(content)
    train(RunOptions(resume=str(stopped)))
    assert result(stopped) == result(whole)


def test_checkpoints_that_are_gone_are_missed(whole: Path, stopped: Path) -> None:
    """Else the run would begin anew, and drop the rows of its table."""
    folder = stopped / "checkpoints"
    folder.rename(stopped / "elsewhere")
    table = (stopped / "metrics.csv").read_bytes()
    with pytest.raises(CheckpointError, match="there is none left"):
        train(RunOptions(resume=str(stopped)))
    assert (stopped / "metrics.csv").read_bytes() == table
    (stopped / "elsewhere").rename(folder)
    (folder / "step_0000002.safetensors").unlink()
    train(RunOptions(resume=str(stopped)))
    assert "of iteration 2 is gone from" in (stopped / "log.txt").read_text()
    assert result(stopped) == result(whole)


def test_a_checkpoint_that_may_not_be_read_is_not_called_damaged(
    stopped: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = Path.open

    def refuse(path: Path, *given: object, **named: object) -> object:
        if path.suffix == ".safetensors":
            raise PermissionError(13, "Permission denied", str(path))
        return opened(path, *given, **named)  # type: ignore[call-overload]

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(CheckpointError, match=r"cannot be read \(Permission denied\)"):
        train(RunOptions(resume=str(stopped)))
    assert names(stopped) == ["step_0000001.safetensors", "step_0000002.safetensors"]


# -- How many stay -------------------------------------------------------------------


@pytest.mark.parametrize("keep", [1, 2])
def test_as_many_checkpoints_stay_as_were_asked_for(tmp_path: Path, keep: int) -> None:
    options = RunOptions(out=str(tmp_path / "run"), keep_checkpoints=keep)
    train(options)
    kept = range(ITERATIONS - keep + 1, ITERATIONS + 1)
    assert names(tmp_path / "run") == [f"step_{i:07d}.safetensors" for i in kept]
    # A resumed run may be asked for another number.
    again = replace(options, out=None, resume=options.out, keep_checkpoints=3)
    train(again, ITERATIONS + 2)
    assert len(names(tmp_path / "run")) == 3


def test_run_json_tells_the_last_checkpoint(stopped: Path) -> None:
    assert json.loads((stopped / "run.json").read_text())["checkpoint"] == 2


def test_a_new_checkpoint_is_there_before_an_old_one_goes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With one checkpoint kept, there is one at every moment."""
    seen = []
    unlink = Path.unlink

    def watched(path: Path, **named: bool) -> None:
        if path.suffix == ".safetensors":
            seen.append(names(tmp_path / "run"))
        unlink(path, **named)

    monkeypatch.setattr(Path, "unlink", watched)
    with Run(RunOptions(out=str(tmp_path / "run"), keep_checkpoints=1), "demo") as run:
        for step in run.iterations(2):
            run.save_checkpoint(step, {"weight": torch.ones(1)})
    assert seen == [["step_0000001.safetensors", "step_0000002.safetensors"]]
