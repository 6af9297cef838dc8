"""Worlds are stepped in as many threads as the process has processors."""

from __future__ import annotations

import os

import pytest

from rlco.physics.native.stepper import NativeStepper
from rlco.physics.spec.domain import SIM
from rlco.physics.tasks.push_cube import TASK


@pytest.mark.parametrize(("worlds", "threads"), [(2, 2), (4, 3)])
def test_threads_are_those_of_the_process_and_no_more_than_worlds(
    monkeypatch: pytest.MonkeyPatch, worlds: int, threads: int
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 64)  # a machine that others share
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {5, 6, 9}, raising=False)
    stepper = NativeStepper(TASK, SIM, num_envs=worlds)
    assert stepper.worlds.threads == threads
