"""Camera frames of a model, drawn by rlco itself: no OpenGL library is needed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError
from rlco.physics.mj.libmujoco import address_of
from rlco.physics.rendering.camera import camera_id, moved_pose, moves
from rlco.physics.rendering.raster.frames import COMMON, Backgrounds, draw_range
from rlco.physics.rendering.raster.scene import is_fixed, make_scene
from rlco.physics.rendering.raster.state import (
    Sources,
    model_offsets,
    row_sizes,
    state_addresses,
)

Integers = NDArray[np.int64]
Run = Callable[..., None]


class Channels(NamedTuple):
    """What one frame shows."""

    image: NDArray[np.uint8]  # (3, height, width)
    geom: NDArray[np.int32]  # index of the geom, -1: none (height, width)
    depth: NDArray[np.float32]  # along the camera's axis, 0: none (height, width) [m]


def run_here(kernel: Callable[..., None], count: int, *arguments: Any) -> None:
    """Run a compiled loop over all of `count` worlds in this thread."""
    kernel(0, count, *arguments)


class RasterCamera:
    """One camera of a compiled model, for the states of any number of worlds.

    The triangles of the model's geoms are read once. Colours, lights and poses are
    read at every frame, from the model and the state of its world. The same numbers
    give the same bytes, in any thread and after any other frame.

    Args:
        model: The compiled model.
        image_size: Height and width of frames [pixels].
        name: The camera's name.
        num_envs: Number of worlds N whose frames `draw` renders.

    Raises:
        RlcoError: If the camera projects in parallel.
        UnknownNameError: If the model has no such camera.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        image_size: tuple[int, int],
        name: str = "agentview",
        num_envs: int = 1,
    ) -> None:
        self._model = model
        self._size = image_size
        self._id = camera_id(model, name)
        if model.cam_projection[self._id]:
            raise RlcoError(
                f"camera {name!r} projects in parallel, which renderer='raster' does "
                "not; give renderer='opengl', or a camera with a perspective."
            )
        height, width = image_size
        self._scene = make_scene(model, self._id, height)
        self._sizes = row_sizes(self._scene)
        self._offsets = model_offsets()
        still = is_fixed(model, int(model.cam_bodyid[self._id]))
        slots = num_envs + 1 if still else 0
        self._backgrounds = Backgrounds(
            rows=np.zeros((slots, int(self._sizes[1]))),
            drawn=np.zeros(slots, dtype=np.bool_),
            depth=np.zeros((slots, height, width), dtype=np.float32),
            geom=np.zeros((slots, height, width), dtype=np.int32),
            image=np.zeros((slots, 3, height, width), dtype=np.uint8),
        )
        self._nothing = np.zeros((0, 0, 0), np.int32), np.zeros((0, 0, 0), np.float32)

    def sources(self, models: Integers, data: Sequence[Any]) -> Sources:
        """Return where to read N worlds, for `draw`.

        Args:
            models: Addresses of the worlds' models, read at every frame, (N,).
            data: The worlds' states, which must outlive the result.
        """
        states = np.array([state_addresses(d) for d in data], dtype=np.int64)
        return Sources(models, states, self._offsets)

    def draw(
        self,
        sources: Sources,
        which: Integers,
        images: NDArray[np.uint8],
        run: Run = run_here,
    ) -> None:
        """Render the current frames of the worlds `which`.

        Args:
            sources: Where the worlds are read.
            which: Indices of worlds, shape (R,).
            images: uint8 (N, 3, height, width); only those of `which` are written.
            run: Runs a compiled loop over R worlds, such as
                `rlco.physics.native.worlds.Worlds.run_over`, in its threads.
        """
        self._draw(sources, which, images, *self._nothing, run)

    def _draw(
        self,
        sources: Sources,
        which: Integers,
        images: Any,
        geoms: Any,
        depths: Any,
        run: Run,
    ) -> None:
        if not which.size:
            return
        drawn = self._backgrounds.drawn
        rest = (
            self._scene,
            self._sizes,
            sources,
            self._backgrounds,
            images,
            geoms,
            depths,
        )
        if drawn.size and not drawn[COMMON]:
            # Before any thread: afterwards it is only read.
            draw_range(0, 1, np.full(1, -1), *rest)
        run(draw_range, which.size, which, *rest)

    def frame(
        self,
        data: Any,
        *,
        model: mujoco.MjModel | None = None,
        yaw: float = 0.0,
        shift: tuple[float, float] = (0.0, 0.0),
    ) -> NDArray[np.uint8]:
        """Return the current frame of a world, uint8, shape (3, height, width).

        Args:
            data: The world's state.
            model: The world's own model, where it differs from the camera's in values
                only.
            yaw: As in `rlco.physics.rendering.camera.move_camera`, for this frame
                [rad].
            shift: The same, for this frame [m].
        """
        return self.channels(data, model=model, yaw=yaw, shift=shift).image

    def channels(
        self,
        data: Any,
        *,
        model: mujoco.MjModel | None = None,
        yaw: float = 0.0,
        shift: tuple[float, float] = (0.0, 0.0),
    ) -> Channels:
        """Return the current frame with each pixel's geom and depth; see `frame`.

        Transparent geoms have no depth, as in MuJoCo: it is that of what is behind.
        """
        model = self._model if model is None else model
        addresses = state_addresses(data)
        position, matrix = data.cam_xpos.copy(), data.cam_xmat.copy()
        if moves(yaw, shift):
            turn = matrix[self._id].reshape(3, 3)
            moved = moved_pose(position[self._id], turn, yaw, shift)
            position[self._id], matrix[self._id] = moved[0], moved[1].ravel()
        addresses[2:4] = address_of(position), address_of(matrix)
        sources = Sources(
            np.array([model._address]), np.array([addresses]), self._offsets
        )
        out = Channels(
            np.zeros((3, *self._size), np.uint8),
            np.zeros(self._size, np.int32),
            np.zeros(self._size, np.float32),
        )
        only = np.zeros(1, dtype=np.int64)
        self._draw(
            sources, only, out.image[None], out.geom[None], out.depth[None], run_here
        )
        return out

    def close(self) -> None:
        """Do nothing: there is nothing to free; `Camera` has something."""
