"""Scenes, scripted experts, control and stepping of robosuite models, without torch."""

import importlib
import os

from rlco.errors import RenderingError

try:
    importlib.import_module("mujoco")  # loads OpenGL, as MUJOCO_GL selects it
except (AttributeError, ImportError, OSError, RuntimeError) as error:
    # Without MUJOCO_GL, OpenGL is loaded with the first frame.
    if "MUJOCO_GL" not in os.environ:
        raise
    raise RenderingError(os.environ["MUJOCO_GL"], str(error)) from error
