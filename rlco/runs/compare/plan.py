"""What is left to run, in which order, and how long it will take."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from rlco.runs.compare.cells import Store
from rlco.runs.compare.jobs import Job


@dataclass(frozen=True)
class Plan:
    """The jobs of an experiment, and those that are to run.

    Attributes:
        every: All of them.
        jobs: What is to run: cheapest first, none before those it needs.
    """

    every: tuple[Job, ...]
    jobs: tuple[Job, ...]

    def hours(self, left: Iterable[Job], store: Store, at_once: int) -> float:
        """Return how long jobs will take, so many at once [h]."""
        minutes, _ = expected_minutes(self.every, store)
        return sum(minutes[job.kind.name] for job in left) / 60 / at_once


def make_plan(jobs: Sequence[Job], store: Store) -> Plan:
    """Return what is left to run of an experiment's jobs."""
    minutes, _ = expected_minutes(jobs, store)
    chosen = set(_needed(jobs, store))
    # Sorting keeps the order of jobs that cost the same.
    cheapest = sorted(
        (job for job in jobs if job in chosen), key=lambda job: minutes[job.kind.name]
    )
    return Plan(tuple(jobs), tuple(_needs_first(cheapest)))


def _needs_first(jobs: Sequence[Job]) -> list[Job]:
    """Move each job behind those that it needs, and leave the order otherwise."""
    found: dict[Job, None] = {}
    chosen = set(jobs)

    def add(job: Job) -> None:
        if job in found:  # looked through already, with all that it needs
            return
        for need in job.needs.values():
            if need in chosen:
                add(need)
        found.setdefault(job)

    for job in jobs:
        add(job)
    return list(found)


def _needed(jobs: Sequence[Job], store: Store) -> list[Job]:
    """Return jobs without a cell, and those whose folders they miss."""
    chosen = {job: None for job in jobs if store.find(job) is None}
    waiting = list(chosen)
    while waiting:
        for need in waiting.pop().needs.values():
            if need not in chosen and not store.run_folder(need).exists():
                chosen[need] = None
                waiting.append(need)
    return list(chosen)


def expected_minutes(
    jobs: Iterable[Job], store: Store
) -> tuple[dict[str, float], set[str]]:
    """Return the minutes of each kind of job, measured where any has finished."""
    seconds: dict[str, list[float]] = {}
    minutes: dict[str, float] = {}
    for job in jobs:
        minutes[job.kind.name] = job.kind.minutes
        if (cell := store.find(job)) is not None and cell.cpu_seconds:
            seconds.setdefault(job.kind.name, []).append(cell.cpu_seconds)
    minutes |= {name: float(np.mean(values)) / 60 for name, values in seconds.items()}
    return minutes, set(seconds)
