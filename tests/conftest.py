"""What every test needs: one thread, and a GL library where one is installed."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rlco.reporting.headless import choose_gl

# Before torch and MuJoCo are imported: both read these once.
os.environ.setdefault("OMP_NUM_THREADS", "1")
choose_gl()


# The dearest files in the order in which the workers begin them, so that none is left
# to one worker at the end. In a fresh clone one worker compiles the native backend, a
# minute's work, while the other begins with what needs nothing of it; and the wheel
# takes over what was compiled.
DEAREST = (
    "docs/test_commands.py",
    "recipes/test_compare.py",
    "gap/search/test_find_gap.py",
    "policies/vla/test_lerobot_policies.py",
    "recipes/test_chain.py",
    "gap/report/test_gap_report.py",
    "test_cli.py",
    "envs/test_effects.py",
    "physics/native/test_same_physics_of_tasks.py",
    "collectors/test_ray_rollouts.py",
    "recipes/test_find_gap_recipe.py",
    "docs/test_results_pages.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the dearest files first."""
    here = Path(__file__).parent
    order = {here / name: place for place, name in enumerate(DEAREST)}
    items.sort(key=lambda item: order.get(item.path, len(order)))


@pytest.fixture(scope="session", autouse=True)
def one_processor_a_worker() -> Iterator[None]:
    """Step worlds in one thread: workers of two threads each wait for each other.

    What a test starts has all processors all the same.
    """
    with pytest.MonkeyPatch.context() as patch:
        if "PYTEST_XDIST_WORKER" in os.environ:
            patch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
        yield


@pytest.fixture(scope="session")
def rendering() -> None:
    """Skip what draws images where no OpenGL library can be had."""
    from rlco.errors import RenderingError
    from rlco.physics.rendering.camera import check_rendering

    try:
        check_rendering()
    except RenderingError as error:
        pytest.skip(f"no OpenGL library: {error}")


@pytest.fixture(scope="module")
def ray_cluster() -> Iterator[None]:
    """Start a Ray cluster of two processors, or use the one that RAY_ADDRESS names.

    Not for the session: its processes take a fifteenth of a processor while they wait.
    """
    from rlco.errors import LostProcessError
    from rlco.runs.ray_cluster import connect, disconnect

    try:
        connect(os.environ.get("RAY_ADDRESS"), processors=2)
    except LostProcessError as error:
        # Three starts took longer than Ray waits; any other failure is one here, too.
        pytest.skip(f"this machine is too busy for Ray's own processes: {error}")
    yield
    disconnect()


@pytest.fixture(autouse=True)
def one_thread() -> None:
    """Two threads on a busy machine are many times slower than one."""
    import torch

    torch.set_num_threads(1)


@pytest.fixture(autouse=True, scope="module")
def free_environments() -> Iterator[None]:
    """Free what a module leaves: robosuite's environments are cycles of 150 MB."""
    before = _resident()
    yield
    if _resident() > before + 200e6:  # to look at a large heap takes a second
        gc.collect()
        gc.freeze()  # what is left stays, as libraries do: not to be looked at again
        if sys.platform == "linux":  # freed, such memory stays with glibc's arenas
            ctypes.CDLL(None).malloc_trim(0)


def _resident() -> float:
    """Return the memory that this process holds [bytes]."""
    pages = Path("/proc/self/statm")
    if not pages.exists():
        return float("inf")
    return float(pages.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
