"""Rendering without a screen: which OpenGL library MuJoCo should load."""

from __future__ import annotations

import ctypes.util
import os
import sys


def choose_gl() -> None:
    """Let MuJoCo render off screen where there is no screen, before it is imported.

    MuJoCo reads ``MUJOCO_GL`` once, at its import, and without it asks for a screen.
    Nothing is changed where the variable is set, where there is a screen, or where
    neither library is found: all but images and videos then works as ever.
    """
    if sys.platform != "linux" or os.environ.get("DISPLAY"):
        return
    for backend, library in (("egl", "EGL"), ("osmesa", "OSMesa")):
        if ctypes.util.find_library(library):
            os.environ.setdefault("MUJOCO_GL", backend)
