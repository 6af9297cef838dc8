"""Camera frames of a model, rendered off screen."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import RenderingError


def check_rendering() -> None:
    """Raise where nothing can render, before anything expensive starts.

    Raises:
        RenderingError: There is no OpenGL library to render with.
    """
    scene = "<mujoco><worldbody><camera name='agentview'/></worldbody></mujoco>"
    Camera(mujoco.MjModel.from_xml_string(scene), (8, 8)).close()


class Camera:
    """One fixed camera of a compiled model, one rendering context.

    Args:
        model: The compiled model.
        image_size: Height and width of frames [pixels].
        name: The camera's name.

    Raises:
        RenderingError: If there is no OpenGL library to render with.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        image_size: tuple[int, int],
        name: str = "agentview",
    ) -> None:
        # What MuJoCo chose when it was imported; robosuite sets MUJOCO_GL afterwards.
        context = getattr(mujoco, "GLContext", None)
        backend = context.__module__.rpartition(".")[-1] if context else "disabled"
        try:
            self._renderer = mujoco.Renderer(model, *image_size)
        # What a missing library raises differs by backend and by library.
        except (
            ImportError,
            AttributeError,
            RuntimeError,
            OSError,
            mujoco.FatalError,
        ) as error:
            raise RenderingError(backend, str(error)) from error
        self._name = name
        self._options = mujoco.MjvOption()
        # robosuite's visual meshes only, neither collision geoms nor sites.
        self._options.geomgroup[0] = 0
        self._options.sitegroup[:] = 0

    def frame(self, data: Any) -> NDArray[np.uint8]:
        """Return the present frame of a copy, uint8, shape (3, height, width)."""
        self._renderer.update_scene(data, self._name, self._options)
        return np.ascontiguousarray(self._renderer.render().transpose(2, 0, 1))

    def close(self) -> None:
        """Free the rendering context."""
        self._renderer.close()
