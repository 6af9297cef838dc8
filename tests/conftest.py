"""What every test needs: one thread, and a GL library where one is installed."""

from __future__ import annotations

import os

import pytest

from rlco.headless import choose_gl

# Before torch and MuJoCo are imported: both read these once.
os.environ.setdefault("OMP_NUM_THREADS", "1")
choose_gl()


@pytest.fixture(scope="session")
def rendering() -> None:
    """Skip what draws pictures where no OpenGL library can be had."""
    from rlco.errors import RenderingError
    from rlco.physics.camera import check_rendering

    try:
        check_rendering()
    except RenderingError as error:
        pytest.skip(f"no OpenGL library: {error}")


@pytest.fixture(autouse=True)
def one_thread() -> None:
    """Two threads on a busy machine are many times slower than one."""
    import torch

    torch.set_num_threads(1)
