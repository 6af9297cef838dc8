"""Forks run a script as a process of its own would, and leave this one as it was."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rlco.runs.compare.forked_processes import ForkedProcesses
from rlco.runs.compare.processes import Ended

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def forks() -> ForkedProcesses:
    return ForkedProcesses()


def run(forks: ForkedProcesses, folder: Path, script: str, *options: str) -> Ended:
    """Run a script to its end; its output is in log.txt."""
    number = started(forks, folder, script, *options)
    while (ended := forks.poll(number)) is None:
        time.sleep(0.01)
    return ended


def started(forks: ForkedProcesses, folder: Path, script: str, *options: str) -> int:
    path = folder / "script.py"
    path.write_text(script)
    command = [sys.executable, str(path), *options]
    return forks.start(command, folder / "log.txt", nice=0)


def test_a_script_sees_its_options_its_folder_and_its_name(
    forks: ForkedProcesses, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "only_beside.py").write_text("WORD = 'beside'")
    (tmp_path / "log.txt").write_text("before\n")
    script = "import sys, only_beside\nprint(__name__, only_beside.WORD, sys.argv[1:])"
    argv, modules = list(sys.argv), set(sys.modules)
    assert run(forks, tmp_path, script, "out=x", "seed=1").status == 0
    said = (tmp_path / "log.txt").read_text()
    assert said == "before\n__main__ beside ['out=x', 'seed=1']\n"
    assert capfd.readouterr() == ("", "")
    assert sys.argv == argv
    assert set(sys.modules) == modules


def test_what_it_logs_goes_to_its_log_alone(
    forks: ForkedProcesses, tmp_path: Path
) -> None:
    parents = logging.FileHandler(tmp_path / "parents.txt")
    logger = logging.getLogger("rlco")
    logger.addHandler(parents)
    script = "import logging\nlogger = logging.getLogger('rlco')\n"
    script += "logger.addHandler(logging.StreamHandler())\nlogger.warning('heard')"
    try:
        assert run(forks, tmp_path, script).status == 0
    finally:
        logger.removeHandler(parents)
        parents.close()
    assert (tmp_path / "log.txt").read_text() == "heard\n"
    assert not (tmp_path / "parents.txt").read_text()


@pytest.mark.parametrize(
    ("script", "status", "said"),
    [
        ("raise SystemExit(2)", 2, ""),
        ("import sys; sys.exit('no luck')", 1, "no luck\n"),
        ("import sys; sys.exit()", 0, ""),
        ("1 / 0", 1, "ZeroDivisionError: division by zero\n"),
        ("import os; os.kill(os.getpid(), 9)", -9, ""),
        ("import os; os.write(2, b'from C'); print('x', end='')", 0, "from Cx"),
    ],
)
def test_how_a_script_ends_is_told(
    forks: ForkedProcesses, tmp_path: Path, script: str, status: int, said: str
) -> None:
    assert run(forks, tmp_path, script).status == status
    assert (tmp_path / "log.txt").read_text().endswith(said)


def test_time_on_the_processor_is_the_fork_s_own(
    forks: ForkedProcesses, tmp_path: Path
) -> None:
    busy = "import time\nwhile time.process_time() < 0.3: pass"
    assert 0.3 <= run(forks, tmp_path, busy).cpu_seconds < 3.0


WAITS = "import pathlib, time\npathlib.Path(__file__ + '.on').touch()\ntime.sleep(60)"


def wait_for(path: Path) -> None:
    for _ in range(6000):
        if path.exists():
            return
        time.sleep(0.01)
    pytest.fail(f"nobody wrote {path}")


def test_an_interruption_ends_it(forks: ForkedProcesses, tmp_path: Path) -> None:
    number = started(forks, tmp_path, WAITS)
    wait_for(tmp_path / "script.py.on")
    assert forks.stop(number).status == 1
    assert "KeyboardInterrupt" in (tmp_path / "log.txt").read_text()


def test_it_ends_with_its_parent(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(WAITS)
    parent = (
        "import pathlib, sys, time\n"
        "from rlco.runs.compare import forked_processes\n"
        "forked_processes._HEAVY = ()\n"  # which this is not about
        "forks = forked_processes.ForkedProcesses()\n"
        "here = pathlib.Path(sys.argv[1])\n"
        "command = [sys.executable, str(here / 'script.py')]\n"
        "print(forks.start(command, here / 'log.txt', nice=0), flush=True)\n"
        "time.sleep(60)\n"
    )
    command = [sys.executable, "-c", parent, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        number = int(process.stdout.readline())
        wait_for(tmp_path / "script.py.on")
        process.kill()
    for _ in range(500):
        if not running(number):
            return
        time.sleep(0.01)
    os.kill(number, signal.SIGKILL)
    pytest.fail("it outlived its parent")


def running(number: int) -> bool:
    """Return whether a process is there, and no zombie that nobody has waited for."""
    try:
        stat = Path(f"/proc/{number}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"
