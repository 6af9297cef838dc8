"""Which renderer draws a camera's frames: rlco's own, or OpenGL through MuJoCo."""

from __future__ import annotations

from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.rendering.camera import (
    Camera,
    Quality,
    check_quality,
    check_rendering,
)
from rlco.physics.rendering.raster import RasterCamera
from rlco.physics.spec.names import RENDERERS, Renderer
from rlco.physics.spec.stepper import Stepper


class Frames(Protocol):
    """Renders the current frames of a stepper's worlds."""

    def draw(self, which: NDArray[np.int64], images: NDArray[np.uint8]) -> None:
        """Render the worlds `which` into their rows of images (N, 3, h, w)."""

    def close(self) -> None:
        """Free what was kept to render."""


def check_renderer(renderer: str, quality: str = "fast") -> None:
    """Check the names of a renderer and of an image quality.

    Raises:
        UnknownNameError: If one is unknown.
        RlcoError: If the renderer has no such quality.
    """
    if renderer not in RENDERERS:
        raise UnknownNameError("renderer", renderer, RENDERERS)
    check_quality(quality)
    if renderer == "raster" and quality != "fast":
        raise RlcoError(
            f"image_quality={quality!r} is OpenGL's; give renderer='opengl' with it, "
            "or leave it out."
        )


def check_can_render(renderer: str) -> None:
    """Check that a renderer works here, before anything expensive starts.

    Raises:
        UnknownNameError: If it is unknown.
        RenderingError: If it is ``opengl``, and there is no OpenGL library.
    """
    check_renderer(renderer)
    if renderer == "opengl":
        check_rendering()


def make_camera(
    model: mujoco.MjModel,
    image_size: tuple[int, int],
    name: str = "agentview",
    *,
    renderer: Renderer = "opengl",
    quality: Quality = "fast",
) -> Camera | RasterCamera:
    """Return a camera of a model, which renders one frame at a time.

    Args:
        model: The compiled model.
        image_size: Height and width of frames [pixels].
        name: The camera's name.
        renderer: ``raster`` or ``opengl``.
        quality: Of ``opengl``, see `Camera`.

    Raises:
        RenderingError: If there is no OpenGL library to render with.
        UnknownNameError: If the model has no such camera, or a name is unknown.
        RlcoError: If the renderer has no such quality, or cannot draw that camera.
    """
    check_renderer(renderer, quality)
    if renderer == "raster":
        return RasterCamera(model, image_size, name)
    return Camera(model, image_size, name, quality)


def frames_of(
    stepper: Stepper,
    image_size: tuple[int, int],
    *,
    renderer: Renderer,
    name: str = "agentview",
    quality: Quality = "fast",
) -> Frames:
    """Return what renders the frames of a stepper's worlds; see `make_camera`."""
    check_renderer(renderer, quality)
    if renderer == "raster":
        return _RasterFrames(stepper, image_size, name)
    return _GLFrames(stepper, image_size, name, quality)


class _RasterFrames:
    """Frames by `RasterCamera`, in the threads that step the worlds."""

    def __init__(
        self, stepper: Stepper, image_size: tuple[int, int], name: str
    ) -> None:
        self._stepper = stepper
        count = len(stepper.data)
        self._camera = RasterCamera(stepper.model, image_size, name, num_envs=count)
        self._sources = self._camera.sources(stepper.model_addresses, stepper.data)

    def draw(self, which: NDArray[np.int64], images: NDArray[np.uint8]) -> None:
        self._camera.draw(self._sources, which, images, self._stepper.run_over)

    def close(self) -> None:
        self._camera.close()


class _GLFrames:
    """Frames by `Camera`, one after the other."""

    def __init__(
        self,
        stepper: Stepper,
        image_size: tuple[int, int],
        name: str,
        quality: Quality,
    ) -> None:
        self._stepper = stepper
        self._camera = Camera(stepper.model, image_size, name, quality)

    def draw(self, which: NDArray[np.int64], images: NDArray[np.uint8]) -> None:
        for env in which.tolist():
            data, model = self._stepper.data[env], self._stepper.model_of(env)
            images[env] = self._camera.frame(data, model=model)

    def close(self) -> None:
        self._camera.close()
