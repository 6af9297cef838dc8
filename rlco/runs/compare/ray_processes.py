"""Job processes on a Ray cluster: each a task that runs what a queue would start here.

The nodes share the folders of the jobs and have the same Python: a job writes its run
folder and its log where the queue looks for them, wherever it runs.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rlco.errors import ConfigError, RlcoError
from rlco.runs.compare import processes
from rlco.runs.compare.processes import Ended
from rlco.runs.ray_cluster import connect, disconnect, import_ray

_AGAIN = 4.0  # after which an interruption is repeated [s]
#: A process whose worker or node ended is taken for one that was killed.
_LOST = Ended(-signal.SIGKILL, 0.0)


@dataclass
class RayProcesses:
    """Starts job processes on a cluster, in the place of `LocalProcesses`.

    Attributes:
        address: Of the cluster, see `rlco.runs.ray_cluster.connect`.
        jobs: Processors of the cluster that is started where there is no address.

    Raises:
        ConfigError: Ray is not installed, or there is no cluster at the address.
    """

    address: str | None
    jobs: int
    _connected: bool = field(init=False)
    _task: Any = field(init=False)

    def __post_init__(self) -> None:
        self._connected = connect(self.address, self.jobs)
        # A job is tried again by the queue, which knows what it left behind.
        self._task = import_ray().remote(num_cpus=1, max_retries=0)(_run)

    def start(self, command: Sequence[str], log: Path, *, nice: int) -> Any:
        """Start a process as soon as a processor of the cluster is free."""
        where = (str(Path.cwd()), str(log.resolve()))
        return self._task.remote([sys.executable, *command[1:]], *where, nice)

    def poll(self, process: Any) -> Ended | None:
        """Return how a process ended; None while it runs or waits for a processor.

        Raises:
            ConfigError: A node cannot run it, nor any other.
        """
        ray = import_ray()
        ready, _ = ray.wait([process], timeout=0)
        if not ready:
            return None
        try:
            status, seconds = ray.get(process)
        except ray.exceptions.RayError as error:
            cause = getattr(error, "cause", None)
            if isinstance(cause, RlcoError):
                raise cause from None
            return _LOST
        return Ended(status, seconds)

    def stop(self, process: Any) -> Ended:
        """Interrupt a process as Ctrl-C does."""
        ray = import_ray()
        deadline = time.monotonic() + 2 * processes.PATIENCE
        ready: list[Any] = []
        # On a busy node an interruption may be lost; the job hears the first alone.
        while not ready and time.monotonic() < deadline:
            ray.cancel(process)
            ready, _ = ray.wait([process], timeout=_AGAIN)
        with contextlib.suppress(RlcoError):  # it never ran, and that is told already
            return self.poll(process) or _LOST
        return _LOST

    def close(self) -> None:
        """End the cluster if it is of this process alone."""
        if self._connected:
            disconnect()


def _run(command: Sequence[str], folder: str, log: str, nice: int) -> tuple[int, float]:
    """Run a command on a node; return its status and its seconds of the processor."""
    if not Path(folder).is_dir():
        raise ConfigError(
            [
                f"the node {os.uname().nodename} has no folder {folder!r}; jobs write "
                "to folders that all nodes share"
            ]
        )
    os.chdir(folder)
    # So a task is cancelled. Noted, not raised: an exception just after the start would
    # leave an orphan, which holds its run folder.
    asked: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: asked.append(number))
    try:
        process = processes.start(command, Path(log), nice=nice)
        while (ended := processes.poll(process)) is None and not asked:
            time.sleep(0.1)
        if ended is None:
            ended = processes.stop(process)
    finally:
        signal.signal(signal.SIGINT, before)
    return ended.status, ended.cpu_seconds
