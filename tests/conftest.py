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


@pytest.fixture(scope="session")
def rendering() -> None:
    """Skip what draws images where no OpenGL library can be had."""
    from rlco.errors import RenderingError
    from rlco.physics.rendering.camera import check_rendering

    try:
        check_rendering()
    except RenderingError as error:
        pytest.skip(f"no OpenGL library: {error}")


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
        if sys.platform == "linux":  # freed, such memory stays with glibc's arenas
            ctypes.CDLL(None).malloc_trim(0)


def _resident() -> float:
    """Return the memory that this process holds [bytes]."""
    pages = Path("/proc/self/statm")
    if not pages.exists():
        return float("inf")
    return float(pages.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
