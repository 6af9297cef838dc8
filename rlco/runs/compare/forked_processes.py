"""Jobs as forks of this process, which has imported what they need: seconds saved each.

For jobs so short that a new process would spend most of its time on imports. What is
counted starts in processes of its own.
"""

from __future__ import annotations

import gc
import importlib
import logging
import os
import runpy
import signal
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from rlco.runs.compare.launch import become_job
from rlco.runs.compare.processes import Ended, interrupt, take_in

#: What the recipes of an experiment import, which takes far longer than short jobs do.
_HEAVY = (
    "lerobot.datasets.lerobot_dataset",
    "scipy.stats",
    "torch.utils.tensorboard",
    "rlco.collectors.from_options",
    "rlco.data.expert_demos",
    "rlco.evaluation",
    "rlco.training.iterations",
    "rlco.training.kept_policy",
    "rlco.training.stage_one",
    "rlco.training.stage_two",
)


class ForkedProcesses:
    """Forks that run a job's script as its own process would.

    Nothing that starts threads may have run in this process before the first one.
    """

    def __init__(self) -> None:
        # Read once, when torch is imported.
        os.environ["OMP_NUM_THREADS"] = "1"
        for name in _HEAVY:
            importlib.import_module(name)
        # What is imported stays: no fork looks through it for garbage, page by page.
        gc.collect()
        gc.freeze()

    def start(self, command: Sequence[str], log: Path, *, nice: int) -> int:
        """Start a script, `PYTHON SCRIPT OPTIONS`; return the process's number."""
        sys.stdout.flush()
        sys.stderr.flush()
        parent = os.getpid()
        if number := os.fork():
            return number
        _run(command[1:], log, nice, parent)

    def poll(self, process: int) -> Ended | None:
        """Return how a process ended; None while it runs."""
        return take_in(process)

    def stop(self, process: int) -> Ended:
        """Interrupt a process."""
        return interrupt(process)

    def close(self) -> None:
        """Nothing is held."""


def _run(words: Sequence[str], log: Path, nice: int, parent: int) -> NoReturn:
    """Run a script in this fork, which never returns to what its parent was doing."""
    status = 1
    try:
        become_job(parent, nice)
        # As a Python that is started sets it; the parent's own is the parent's.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _write_to(log)
        sys.argv = list(words)
        sys.path[0] = str(Path(words[0]).parent)
        runpy.run_path(words[0], run_name="__main__")
        status = 0
    except SystemExit as ended:
        status = _status(ended.code)
    finally:
        if (error := sys.exception()) is not None:
            traceback.print_exception(error)
        sys.stdout.flush()
        sys.stderr.flush()
        # Not by sys.exit: what the parent has registered for its end is the parent's.
        os._exit(status)


def _write_to(log: Path) -> None:
    """Turn all output to a log, that of libraries in C as well."""
    with open(os.devnull, "rb") as nothing, log.open("ab") as output:
        os.dup2(nothing.fileno(), 0)
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    sys.stdout = os.fdopen(1, "w", buffering=1, closefd=False)
    sys.stderr = os.fdopen(2, "w", buffering=1, closefd=False)
    logging.getLogger("rlco").handlers.clear()  # the parent's, to its own output


def _status(code: object) -> int:
    """Return the exit status that Python makes of a SystemExit's code."""
    if code is None:
        return 0
    if isinstance(code, int):
        return code
    sys.stderr.write(f"{code}\n")
    return 1
