"""What is found is written whole or not at all, whatever ends the process."""

from __future__ import annotations

import os
import resource
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from small_problems import write_case

from rlco.errors import OutputExistsError, RlcoError
from rlco.gap import Finding, run_gap
from rlco.physics.effects import EFFECTS, AppliedEffect

pytestmark = pytest.mark.slow

DAMPING = AppliedEffect("viscous_damping", "shoulder", {"damping": 0.6})
MOST = set(EFFECTS) - {"viscous_damping", "coulomb_friction"}
FILES = {"report.json", "report.html", "model.xml", "model.diff", "effects.yaml"}
CALLS = {"open", "os.mkdir", "os.rename", "os.remove", "os.rmdir"}


@pytest.fixture(scope="module")
def finding(tmp_path_factory: pytest.TempPathFactory) -> Finding:
    case = write_case(tmp_path_factory.mktemp("case"), DAMPING)
    return run_gap(*case, exclude=MOST, threads=1, film=False)


@pytest.fixture(autouse=True)
def short_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the figures, which take the most time."""
    text = "<p>" + "what was found " * 4000 + "</p>"
    monkeypatch.setattr("rlco.gap.report.report_html.page", lambda _: text)


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


@pytest.fixture(scope="module")
def whole(
    finding: Finding, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, bytes]:
    """What nobody disturbed; in a folder as deep as those of the tests."""
    with pytest.MonkeyPatch.context() as patch:
        text = "<p>" + "what was found " * 4000 + "</p>"
        patch.setattr("rlco.gap.report.report_html.page", lambda _: text)
        finding.write(folder := tmp_path_factory.mktemp("whole") / "report")
    return contents(folder)


def status_of(begin: Callable[[], None], finding: Finding, folder: Path) -> int:
    """Write in a process of its own, which may end at any moment."""
    child = os.fork()
    if child == 0:
        try:
            begin()
            finding.write(folder)
        except BaseException:  # noqa: BLE001
            os._exit(3)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def killed_at(number: int, folder: Path) -> Callable[[], None]:
    """Return what ends the process as ``kill -9`` does, at a call in this folder."""
    calls = 0

    def hook(event: str, given: tuple[Any, ...]) -> None:
        nonlocal calls
        if event in CALLS and str(folder) in str(given[0]):
            calls += 1
            if calls == number:
                os.kill(os.getpid(), signal.SIGKILL)

    return lambda: sys.addaudithook(hook)


def killed_after(size: int) -> Callable[[], None]:
    """Return what ends the process in the middle of a file, after so many bytes."""

    def begin() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    return begin


def check_left(finding: Finding, folder: Path, whole: dict[str, bytes]) -> None:
    """Check that it is whole, or written anew by the same call, or refused at first."""
    part = folder.with_name("report.unfinished")
    if not folder.exists():
        left = contents(part) if part.exists() else {}
        if left:
            with pytest.raises(RlcoError, match=r"report\.unfinished' holds what") as e:
                finding.write(folder)
            assert str(e.value).endswith("take it away, or give another out=DIR.")
            assert contents(part) == left  # which is for its owner to judge
            for file in part.iterdir():
                file.unlink()
        finding.write(folder)
    assert contents(folder) == whole
    assert not part.exists()


@pytest.mark.thorough
def test_a_report_killed_at_any_call_is_whole_or_refused(
    finding: Finding, whole: dict[str, bytes], tmp_path: Path
) -> None:
    number, status = 0, -signal.SIGKILL
    while status == -signal.SIGKILL:
        number += 1
        folder = tmp_path / str(number) / "report"
        folder.parent.mkdir()
        status = status_of(killed_at(number, folder), finding, folder)
        check_left(finding, folder, whole)
    assert status == 0
    assert number > 10  # the last one ended before it was killed


@pytest.mark.parametrize("size", [0, 500, 3_000, 40_000])
def test_a_report_killed_in_the_middle_of_a_file_is_refused(
    finding: Finding, whole: dict[str, bytes], tmp_path: Path, size: int
) -> None:
    folder = tmp_path / "report"
    status = status_of(killed_after(size), finding, folder)
    assert status == -signal.SIGXFSZ
    check_left(finding, folder, whole)


def test_a_full_disk_loses_nothing_that_was_written(
    finding: Finding,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device", "effects.yaml")

    folder, part = tmp_path / "report", tmp_path / "report.unfinished"
    with monkeypatch.context() as patch:
        patch.setattr("rlco.gap.correct.corrected_files.write_effects", full)
        with pytest.raises(OSError, match="No space"):
            finding.write(folder)
    assert caplog.messages[-1] == f"what was written until then is in {part}"
    assert not folder.exists()
    assert (part / "report.json").stat().st_size > 100


def test_an_empty_folder_is_taken_and_a_full_one_left_as_it_is(
    finding: Finding, whole: dict[str, bytes], tmp_path: Path
) -> None:
    folder = tmp_path / "report"
    folder.mkdir()
    finding.write(folder)
    assert contents(folder) == whole
    with pytest.raises(OutputExistsError):
        finding.write(folder)
    assert contents(folder) == whole


def test_of_two_that_write_one_report_the_second_is_refused(
    finding: Finding, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refused: list[str] = []

    def meanwhile(_: object) -> str:
        with pytest.raises(RlcoError) as caught:
            finding.write(tmp_path / "report")
        refused.append(str(caught.value))
        return "page"

    monkeypatch.setattr("rlco.gap.report.report_html.page", meanwhile)
    finding.write(tmp_path / "report")
    assert "is being written by another process; wait for it to end" in refused[0]
    assert (tmp_path / "report" / "report.html").read_text() == "page"


def test_what_came_meanwhile_under_that_name_is_not_overwritten(
    finding: Finding, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def meanwhile(_: object) -> str:
        (tmp_path / "report").mkdir()
        (tmp_path / "report" / "precious").write_text("precious")
        return "page"

    monkeypatch.setattr("rlco.gap.report.report_html.page", meanwhile)
    with pytest.raises(OutputExistsError):
        finding.write(tmp_path / "report")
    assert contents(tmp_path / "report") == {"precious": b"precious"}
    assert set(contents(tmp_path / "report.unfinished")) >= FILES
