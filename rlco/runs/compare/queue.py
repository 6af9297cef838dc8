"""Runs jobs, so many at once, each in a folder that a killed one leaves resumable."""

from __future__ import annotations

import logging
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rlco.errors import DataError
from rlco.files import read_json
from rlco.runs import run_folder
from rlco.runs.compare.cells import Cell, Store, curves, outcome, results
from rlco.runs.compare.jobs import Job
from rlco.runs.compare.plan import Plan
from rlco.runs.compare.processes import Ended, LocalProcesses, Processes
from rlco.runs.whole_files import write_json

log = logging.getLogger("rlco.compare")

_PAUSE = 0.1  # between looks at the processes [s]


@dataclass
class Queue:
    """Runs the jobs of a plan.

    Attributes:
        plan: What is to run, in its order.
        store: Where cells are, and run folders.
        jobs: How many jobs run at once.
        hours: When no further job is started [h]; what runs by then is finished.
        nice: Added to the niceness of jobs.
        processes: Where they run.

    A job whose process dies, killed or lost with its machine, is tried again once, from
    where it was. One that ends with an error of its own would do so again.
    """

    plan: Plan
    store: Store
    jobs: int
    hours: float | None
    nice: int
    processes: Processes = field(default_factory=LocalProcesses)
    clock: Callable[[], float] = time.monotonic
    _left: list[Job] = field(init=False)
    _running: dict[Job, Any] = field(init=False)
    _failed: set[Job] = field(init=False)
    _died: set[Job] = field(init=False)

    def run(self) -> set[Job]:
        """Run until nothing is left or may be started; return the jobs that failed.

        Raises:
            KeyboardInterrupt: It was interrupted; what ran was stopped, resumable.
        """
        self._left, self._running = list(self.plan.jobs), {}
        self._failed, self._died = set(), set()
        began = self.clock()
        try:
            while True:
                spent = (self.clock() - began) / 3600
                if self.hours is None or spent < self.hours:
                    self._start_ready()
                if not self._running:
                    break
                self._collect()
                time.sleep(_PAUSE)
        except BaseException:
            for job, process in self._running.items():
                folder = self.store.folder(job)
                ended = self.processes.stop(process)
                attempts = [*attempts_of(folder), _attempt(ended)]
                write_json(folder / "attempts.json", {"attempts": attempts})
            raise
        for job in self._left:
            if waits := [n.name for n in job.needs.values() if n in self._failed]:
                log.warning("%s did not run: %s failed", job.name, waits[0])
        return self._failed

    def _start_ready(self) -> None:
        """Start the first jobs whose needs are there, as far as processors are free."""
        for job in list(self._left):
            if len(self._running) == self.jobs:
                return
            if all(self._there(need) for need in job.needs.values()):
                self._left.remove(job)
                self._running[job] = self._start(job)

    def _there(self, need: Job) -> bool:
        # One whose folder is there runs again only if its cell is missing.
        waits = need in self._left or need in self._running or need in self._failed
        return not waits and self.store.run_folder(need).exists()

    def _start(self, job: Job) -> Any:
        folder = self.store.folder(job)
        folder.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(self.store.run_folder(job), ignore_errors=True)
        command = [sys.executable, str(job.kind.path), _where(folder / "part")]
        needed = {n: str(self.store.run_folder(j)) for n, j in job.needs.items()}
        command += [f"{key}={value}" for key, value in job.options(needed).items()]
        with (folder / "log.txt").open("a", encoding="utf-8") as file:
            file.write(f"$ {' '.join(command)}\n")
        log.info("%s starts", job.name)
        return self.processes.start(command, folder / "log.txt", nice=self.nice)

    def _collect(self) -> None:
        """Take in the jobs that have ended."""
        for job, process in list(self._running.items()):
            if (ended := self.processes.poll(process)) is not None:
                del self._running[job]
                self._finish(job, ended)

    def _finish(self, job: Job, ended: Ended) -> None:
        folder = self.store.folder(job)
        attempts = [*attempts_of(folder), _attempt(ended)]
        try:
            _check(job, ended)
            cell = _cell(job, self.store, attempts)
            first = self.store.add(job, cell)
        except DataError as error:
            if ended.status < 0 and job not in self._died:
                self._died.add(job)
                self._left.insert(0, job)
                name = signal.Signals(-ended.status).name
                write_json(folder / "attempts.json", {"attempts": attempts})
                self._say(job, f"died of {name} and is tried again")
                return
            self._failed.add(job)
            if job.code.has_changed():
                shutil.rmtree(folder / "part", ignore_errors=True)  # of two codes
            attempts[-1]["failed"] = reason = str(error).rstrip(".")
            self._say(job, f"failed: {reason}; its log is {folder / 'log.txt'}")
        else:
            (folder / "part").rename(self.store.run_folder(job))
            self._say(job, f"finished after {ended.cpu_seconds / 60:.1f} minutes")
            if outcome(first.rows) != outcome(cell.rows):
                log.warning(
                    "%s came to something else than its cell, which stands (%s; here "
                    "%s): what goes on from it begins elsewhere than the tables show",
                    job.name,
                    first.processor or "processor not known",
                    cell.processor,
                )
        write_json(folder / "attempts.json", {"attempts": attempts})

    def _say(self, job: Job, what: str) -> None:
        left = [*self._left, *self._running]
        log.info(
            "%s %s; %d of %d jobs to go, %.1f hours",
            job.name,
            what,
            len(left),
            len(self.plan.every),
            self.plan.hours(left, self.store, self.jobs),
        )


def _check(job: Job, ended: Ended) -> None:
    """Check that a job ended well, and that it ran what its key says.

    Raises:
        DataError: It did not.
    """
    if ended.status:
        raise DataError(f"it ended with status {ended.status}.")
    if job.code.has_changed():
        raise DataError(
            "its code was changed while it ran; start compare.py again, and leave the "
            "code as it is meanwhile."
        )


def _where(part: Path) -> str:
    """Return the option that begins a run folder, or that goes on with one.

    One that was cut off before it could be resumed is removed.
    """
    if all((part / name).is_file() for name in ("config.yaml", "run.json")):
        return f"resume={part}"
    shutil.rmtree(part, ignore_errors=True)
    return f"out={part}"


def attempts_of(folder: Path) -> list[dict[str, Any]]:
    """Return how a job's processes ended so far, in their order.

    They are lost where the file is damaged, and the job is run as if it never was.
    """
    try:
        found = read_json(folder / "attempts.json").groups("attempts")
        for one in found:
            one.number("cpu_seconds")
    except DataError:
        return []
    return [dict(one.content) for one in found]


def failed_before(jobs: Iterable[Job], store: Store) -> set[Job]:
    """Return the jobs whose last process failed; one that was stopped did not."""
    found = set()
    for job in jobs:
        attempts = attempts_of(store.folder(job))
        if attempts and "failed" in attempts[-1]:
            found.add(job)
    return found


def _attempt(ended: Ended) -> dict[str, Any]:
    """Return what is kept of a process; of one that failed, the reason too."""
    return {"status": ended.status, "cpu_seconds": round(ended.cpu_seconds, 2)}


def _cell(job: Job, store: Store, attempts: list[dict[str, Any]]) -> Cell:
    """Return the cell of a job whose process has ended well.

    Raises:
        DataError: It left no results, though it should have.
    """
    run = store.folder(job) / "part"
    return Cell(
        name=job.name,
        key=job.key,
        identity=job.identity,
        code=job.code.version,
        script=job.kind.script,
        options=job.options({name: f"job:{n.key}" for name, n in job.needs.items()}),
        rows=results(run) if job.kind.results else [],
        curves=curves(run, job.kind.curves),
        cpu_seconds=round(sum(one["cpu_seconds"] for one in attempts), 2),
        attempts=len(attempts),
        processor=run_folder.processor(),
        commit=run_folder.commit(Path(run_folder.__file__).parent),
        versions=run_folder.versions(),
        finished=time.strftime("%Y-%m-%d %H:%M:%S"),
        began_from={
            need.key: outcome(results(store.run_folder(need)))
            for need in job.needs.values()
            if need.kind.results
        },
    )
