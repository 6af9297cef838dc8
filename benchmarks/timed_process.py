"""A process that is timed and may be stopped, with what it printed."""

from __future__ import annotations

import os
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Finished:
    """What is left of a process.

    Attributes:
        status: Its exit status; that of a stopped process is -9.
        output: What it printed.
        errors: What it printed to stderr.
        seconds: By the clock.
        cpu: Of all its threads together [s]: what others on the machine do, does not
            count.
    """

    status: int
    output: str
    errors: str
    seconds: float
    cpu: float


def run_timed(
    command: Sequence[str],
    limit: float | None = None,
    environment: Mapping[str, str] | None = None,
) -> Finished:
    """Run a command to its end, or stop it at a limit [s].

    Example:
        >>> run_timed(["sh", "-c", "echo one; exit 3"]).status
        3
    """
    began = time.perf_counter()
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            command,
            stdout=output,
            stderr=errors,
            env={**os.environ, "OMP_NUM_THREADS": "1", **(environment or {})},
        )
        stop = threading.Timer(limit or threading.TIMEOUT_MAX, process.kill)
        stop.start()
        try:
            # Popen's own wait would not tell the time on the processor.
            _, status, usage = os.wait4(process.pid, 0)
        except KeyboardInterrupt:
            process.kill()
            raise
        finally:
            stop.cancel()
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        errors.seek(0)
        return Finished(
            process.returncode,
            output.read().decode(errors="replace"),
            errors.read().decode(errors="replace"),
            round(time.perf_counter() - began, 1),
            round(usage.ru_utime + usage.ru_stime, 1),
        )
