"""Job processes: started, waited for with their time, and ended with this one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

_LAUNCH = Path(__file__).with_name("launch.py")
PATIENCE = 20.0  # for a process to end by itself once it was asked to [s]


@dataclass(frozen=True)
class Ended:
    """How a process ended.

    Attributes:
        status: Its exit status; negative: the signal that ended it.
        cpu_seconds: Of the processor, its children's with it [s].
    """

    status: int
    cpu_seconds: float


class Processes(Protocol):
    """Where a queue starts processes: on this machine, or on others."""

    def start(self, command: Sequence[str], log: Path, *, nice: int) -> Any:
        """Start a process, its output appended to a log."""

    def poll(self, process: Any) -> Ended | None:
        """Return how a process ended; None while it runs."""

    def stop(self, process: Any) -> Ended:
        """Interrupt a process."""

    def close(self) -> None:
        """Free what it holds."""


class LocalProcesses:
    """Processes of this machine."""

    def start(
        self, command: Sequence[str], log: Path, *, nice: int
    ) -> subprocess.Popen[bytes]:
        """Start a process, see `start`."""
        return start(command, log, nice=nice)

    def poll(self, process: subprocess.Popen[bytes]) -> Ended | None:
        """Return how a process ended, see `poll`."""
        return poll(process)

    def stop(self, process: subprocess.Popen[bytes]) -> Ended:
        """Interrupt a process, see `stop`."""
        return stop(process)

    def close(self) -> None:
        """Nothing is held."""


def start(command: Sequence[str], log: Path, *, nice: int) -> subprocess.Popen[bytes]:
    """Start a process with one thread for OpenMP, its output appended to a log.

    It ends when this one does: an orphan would hold its run folder.
    """
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    launch = [sys.executable, "-IS", str(_LAUNCH), str(os.getpid()), str(nice)]
    with log.open("ab") as output:
        return subprocess.Popen(
            [*launch, *command],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=environment,
        )


def poll(process: subprocess.Popen[bytes]) -> Ended | None:
    """Return how a process ended; None while it runs."""
    # Popen's own poll would not tell the time on the processor.
    if (ended := take_in(process.pid)) is not None:
        process.returncode = ended.status
    return ended


def stop(process: subprocess.Popen[bytes]) -> Ended:
    """Interrupt a process as Ctrl-C does; kill it if that does not help."""
    # Not by Popen's own method: that takes an ended process in, and its time is lost.
    ended = interrupt(process.pid)
    process.returncode = ended.status
    return ended


def interrupt(number: int) -> Ended:
    """Interrupt a process of this one as Ctrl-C does; kill it if that does not help."""
    os.kill(number, signal.SIGINT)
    asked = time.monotonic()
    while (ended := take_in(number)) is None:
        if time.monotonic() - asked > PATIENCE:
            os.kill(number, signal.SIGKILL)
        time.sleep(0.05)
    return ended


def take_in(number: int) -> Ended | None:
    """Return how a process of this one ended; None while it runs."""
    done, status, usage = os.wait4(number, os.WNOHANG)
    if not done:
        return None
    code = os.waitstatus_to_exitcode(status)
    return Ended(code, usage.ru_utime + usage.ru_stime)
