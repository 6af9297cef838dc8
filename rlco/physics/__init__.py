"""Scenes, experts, control and stepping of robosuite models, without torch."""

import os

from rlco.errors import RenderingError

try:
    import mujoco as _mujoco  # noqa: F401 # it loads OpenGL, as MUJOCO_GL names it
except (AttributeError, ImportError, OSError, RuntimeError) as error:
    # Without MUJOCO_GL, OpenGL is loaded when a frame is asked for.
    if "MUJOCO_GL" not in os.environ:
        raise
    raise RenderingError(os.environ["MUJOCO_GL"], str(error)) from error
