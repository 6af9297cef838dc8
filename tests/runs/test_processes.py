"""Job processes hear what they are asked, whatever their parent does with signals."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest

from rlco.runs.compare import processes

WAITS = (
    "import time\nprint('waits', flush=True)\n"
    "try:\n    time.sleep(600)\nexcept KeyboardInterrupt:\n    print('stops')\n"
)


@contextmanager
def blocked() -> Iterator[None]:
    """Block SIGINT, as a worker of Ray does."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def ignored() -> Iterator[None]:
    """Ignore SIGINT, as a command in the background of a script does."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("parent", [blocked, ignored])
def test_a_job_is_interrupted_whatever_its_parent_does(
    parent: Callable[[], AbstractContextManager[None]], tmp_path: Path
) -> None:
    log = tmp_path / "log.txt"
    with parent():
        process = processes.start([sys.executable, "-c", WAITS], log, nice=0)
        while not log.exists() or "waits" not in log.read_text():
            time.sleep(0.01)
        ended = processes.stop(process)
    assert (ended.status, log.read_text()) == (0, "waits\nstops\n")
