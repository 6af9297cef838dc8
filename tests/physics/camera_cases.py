"""What the camera tests share: scenes, robosuite's own frames, and who can render."""

from __future__ import annotations

import functools
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rlco.envs import TabletopEnv, make_env, make_robosuite
from rlco.errors import RenderingError
from rlco.physics.rendering.camera import check_rendering
from rlco.physics.rendering.raster import Channels
from rlco.physics.robosuite.tabletop import Tabletop
from rlco.physics.spec.domain import Domain
from rlco.physics.spec.sensors import Sensors

SIZE = (64, 96)
YAW, SHIFT = 0.14, (0.025, -0.015)
TURNED = Domain("turned", sensors=Sensors(camera_yaw=YAW, camera_shift=SHIFT))
QUALITIES = pytest.mark.parametrize("quality", ["fast", "robosuite"])


@functools.cache
def can_render() -> bool:
    try:
        check_rendering()
    except RenderingError:
        return False
    return True


NEEDS_GL = pytest.mark.skipif(not can_render(), reason="no OpenGL library")


@functools.cache
def tabletop() -> Tabletop:
    return make_robosuite("push_cube", seed=3)


def scene(env: Any) -> tuple[mujoco.MjModel, mujoco.MjData]:
    return env.sim.model._model, env.sim.data._data


def own_frame(env: Any, action: NDArray[np.float64] | None = None) -> Any:
    """Return robosuite's own observation of an episode's start, or of the next state.

    An observation asked for in between would shift the moment of all later ones.
    """
    # robosuite does so once, when it is built; other robosuite environments do too.
    env.sim._render_context_offscreen.gl_ctx.make_current()
    seen = env.start(env.initial) if action is None else env.step(action)[0]
    # Its images are upside down, rows counted from below.
    return seen["agentview_image"][::-1].transpose(2, 0, 1)


def image_env(**options: Any) -> TabletopEnv:
    return make_env("push_cube", chunk=4, image_size=(16, 16), **options)


def coloured(frame: NDArray[np.uint8], channel: int) -> NDArray[np.bool_]:
    """Return where one channel is well above the others, shape (H, W)."""
    pixels = frame.astype(float)
    rest = np.delete(pixels, channel, axis=0).max(axis=0)
    return pixels[channel] > 1.5 * rest + 20.0


class Truth:
    """Which geom each pixel shows, and how far it is, by MuJoCo and OpenGL."""

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int]) -> None:
        self._renderer = mujoco.Renderer(model, *size)
        self._options = mujoco.MjvOption()
        self._options.geomgroup[0] = 0
        self._options.sitegroup[:] = 0

    def agrees(
        self, data: mujoco.MjData, channels: Channels, camera: str = "agentview"
    ) -> NDArray[np.bool_]:
        """Return where the geom is equal, or the depth within 1 mm."""
        renderer = self._renderer
        renderer.enable_segmentation_rendering()
        renderer.update_scene(data, camera, self._options)
        geoms = renderer.render()[..., 0].copy()
        renderer.disable_segmentation_rendering()
        renderer.enable_depth_rendering()
        renderer.update_scene(data, camera, self._options)
        depth = renderer.render().copy()
        renderer.disable_depth_rendering()
        return (geoms == channels.geom) | (np.abs(depth - channels.depth) < 1e-3)

    def close(self) -> None:
        self._renderer.close()
