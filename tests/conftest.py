"""What every test needs: one thread, and a GL library where one is installed."""

from __future__ import annotations

import ctypes.util
import os

import pytest

# Before torch and MuJoCo are imported: both read these once.
os.environ.setdefault("OMP_NUM_THREADS", "1")
if "MUJOCO_GL" not in os.environ:
    for backend, library in (("egl", "EGL"), ("osmesa", "OSMesa")):
        if ctypes.util.find_library(library):
            os.environ["MUJOCO_GL"] = backend
            break


@pytest.fixture(autouse=True)
def one_thread() -> None:
    """Two threads on a busy machine are many times slower than one."""
    import torch

    torch.set_num_threads(1)
