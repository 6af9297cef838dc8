"""Camera frames of a model, rendered off screen, and moved cameras."""

from __future__ import annotations

import contextlib
import copy
import weakref
from collections.abc import Iterator
from typing import Any, Literal, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.mj.rotations import yaw_matrix
from rlco.physics.rendering import gl
from rlco.physics.rendering.simple_meshes import merge_vertices, out_of_view

Quality = Literal["fast", "robosuite"]
QUALITIES: tuple[str, ...] = get_args(Quality)
# Vertices closer than one pixel at this distance from the camera are merged [m].
DETAIL_DISTANCE = 1.0
HIDDEN_GROUP = 5  # a geom group that is not drawn


def check_rendering() -> None:
    """Check that rendering is possible, before anything expensive starts.

    Raises:
        RenderingError: If there is no OpenGL library to render with.
    """
    scene = "<mujoco><worldbody><camera name='agentview'/></worldbody></mujoco>"
    Camera(mujoco.MjModel.from_xml_string(scene), (8, 8)).close()


def check_quality(quality: str) -> None:
    """Check an image quality's name.

    Raises:
        UnknownNameError: If the quality is unknown.
    """
    if quality not in QUALITIES:
        raise UnknownNameError("image quality", quality, QUALITIES)


class Camera:
    """One camera of a compiled model, for the states of any number of worlds.

    Quality ``robosuite`` renders what robosuite's own off-screen renderer renders, byte
    for byte. ``fast`` renders the same view without multisampling, reflections and
    shadows, with fewer sides of round shapes, and without geoms out of view. For a
    camera that does not move, meshes lose detail smaller than a pixel.

    All cameras of a process share one OpenGL context. Meshes and textures are read from
    the model once; colours, lights and poses are read at every frame, from the model
    given for the frame.

    Args:
        model: The compiled model.
        image_size: Height and width of frames [pixels].
        name: The camera's name.
        quality: ``fast`` or ``robosuite``.

    Raises:
        RenderingError: If there is no OpenGL library to render with.
        UnknownNameError: If the model has no such camera, or the quality is unknown.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        image_size: tuple[int, int],
        name: str = "agentview",
        quality: Quality = "fast",
    ) -> None:
        check_quality(quality)
        self._model = model
        self._size = image_size
        self._fast = quality == "fast"
        gl.run(bool)  # report that nothing can render before a wrong name
        self._id = camera_id(model, name)
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._camera.fixedcamid = self._id
        self._options = mujoco.MjvOption()
        # Only robosuite's visual meshes, no collision geoms.
        self._options.geomgroup[0] = 0
        self._scene = mujoco.MjvScene(model, maxgeom=10_000)
        if self._fast:
            for flag in (
                mujoco.mjtRndFlag.mjRND_SHADOW,
                mujoco.mjtRndFlag.mjRND_REFLECTION,
            ):
                self._scene.flags[flag] = False
        self._context = gl.run(
            mujoco.MjrContext, self._drawn_model(), mujoco.mjtFontScale.mjFONTSCALE_50
        )
        self._free = weakref.finalize(self, gl.run, self._context.free)
        self._free.atexit = False  # then the whole OpenGL context goes

    def _drawn_model(self) -> mujoco.MjModel:
        """Return a copy of the model, prepared for the rendering context."""
        model = copy.copy(self._model)
        height, width = self._size
        model.vis.global_.offheight, model.vis.global_.offwidth = height, width
        if self._fast:
            model.vis.quality.offsamples = model.vis.quality.shadowsize = 0
            model.vis.quality.numslices = 20
            model.vis.quality.numstacks = 8
            model.vis.quality.numquads = 2
            # A camera on the robot comes too close to objects to omit any detail.
            if model.body_weldid[model.cam_bodyid[self._id]] == 0:
                view = 2.0 * np.tan(np.deg2rad(model.cam_fovy[self._id]) / 2)
                merge_vertices(model, DETAIL_DISTANCE * view / height)
        return model

    def frame(
        self,
        data: Any,
        *,
        model: mujoco.MjModel | None = None,
        yaw: float = 0.0,
        shift: tuple[float, float] = (0.0, 0.0),
    ) -> NDArray[np.uint8]:
        """Return the current frame of a world, uint8, shape (3, height, width).

        The world's model and state are restored when it returns.

        Args:
            data: The world's state.
            model: The world's own model, where it differs from the camera's in values
                only (`rlco.physics.native.worlds.Worlds.model_of`).
            yaw: As in `move_camera`, for this frame [rad].
            shift: As in `move_camera`, for this frame [m].

        Raises:
            RlcoError: If the camera was closed.
        """
        if not self._free.alive:
            raise RlcoError("this camera is closed; make another one.")
        model = self._model if model is None else model
        with self._placed(data, yaw, shift), self._culled(model, data):
            mujoco.mjv_updateScene(
                model,
                data,
                self._options,
                None,
                self._camera,
                mujoco.mjtCatBit.mjCAT_ALL,
                self._scene,
            )
        # A sensor's height counts; its width is that of the frame, never stretched.
        for eye in self._scene.camera:
            eye.frustum_width = 0.0
        pixels = gl.run(self._draw, model)
        # OpenGL counts rows from below.
        return np.ascontiguousarray(pixels[::-1].transpose(2, 0, 1))

    def _draw(self, model: mujoco.MjModel) -> NDArray[np.uint8]:
        height, width = self._size
        # The context keeps what it read of materials when it was made.
        for name in ("mat_texid", "mat_texrepeat", "mat_texuniform"):
            value = getattr(model, name)
            getattr(self._context, name).reshape(-1)[: value.size] = value.ravel()
        view = mujoco.MjrRect(0, 0, width, height)
        pixels = np.empty((height, width, 3), dtype=np.uint8)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        mujoco.mjr_render(view, self._scene, self._context)
        mujoco.mjr_readPixels(pixels, None, view, self._context)
        return pixels

    @contextlib.contextmanager
    def _placed(
        self, data: Any, yaw: float, shift: tuple[float, float]
    ) -> Iterator[None]:
        """Move the camera of one world temporarily."""
        position, matrix = data.cam_xpos[self._id], data.cam_xmat[self._id]
        before = position.copy(), matrix.copy()
        if moves(yaw, shift):
            turned = moved_pose(position, matrix.reshape(3, 3), yaw, shift)
            position[:], matrix[:] = turned[0], turned[1].ravel()
        try:
            yield
        finally:
            position[:], matrix[:] = before

    @contextlib.contextmanager
    def _culled(self, model: mujoco.MjModel, data: Any) -> Iterator[None]:
        """Hide temporarily what cannot be in the frame."""
        # Cameras with sensor intrinsics or parallel projection are not culled.
        plain = not (
            model.cam_sensorsize[self._id].any() or model.cam_projection[self._id]
        )
        if not (self._fast and plain):
            yield
            return
        height, width = self._size
        before = model.geom_group.copy()
        model.geom_group[out_of_view(model, data, self._id, width / height)] = (
            HIDDEN_GROUP
        )
        try:
            yield
        finally:
            model.geom_group[:] = before

    def close(self) -> None:
        """Free the meshes, textures and buffers that the camera holds."""
        self._free()


def camera_id(model: mujoco.MjModel, name: str) -> int:
    """Return the index of the camera of that name.

    Raises:
        UnknownNameError: If the model has no such camera.
    """
    number = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, name))
    if number < 0:
        known = [model.camera(index).name for index in range(model.ncam)]
        raise UnknownNameError("camera", name, known)
    return number


def moves(yaw: float, shift: tuple[float, float]) -> bool:
    """Return whether `move_camera` moves anything with these arguments."""
    return yaw != 0.0 or any(shift)


def moved_pose(
    position: NDArray[np.float64],
    rotation: NDArray[np.float64],
    yaw: float,
    shift: tuple[float, float],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a camera's position (3,) and rotation matrix (3, 3) after a move.

    See `move_camera`.

    Example:
        >>> import numpy as np
        >>> moved_pose(np.array([0.5, 0.0, 1.0]), np.eye(3), 0.0, (0.1, 0.2))[0]
        array([ 0.4, -0.2,  1. ])
    """
    turn = np.eye(3)
    turn[:2, :2] = yaw_matrix(-yaw)
    return turn @ (position - np.array([*shift, 0.0])), turn @ rotation


def move_camera(
    model: mujoco.MjModel,
    yaw: float,
    shift: tuple[float, float],
    name: str = "agentview",
) -> None:
    """Move a camera of a compiled model, in place.

    Its frames then look as if everything had turned by `yaw` about the table's centre
    (the world's z axis) and moved by `shift`. An observer that assumes the previous
    camera pose finds each object at ``turned + shift``, which is what a domain's camera
    reports (`rlco.physics.spec.observation`). The camera itself therefore shifts and
    turns in the opposite direction.

    Args:
        model: The compiled model.
        yaw: Rotation of the scene in the image [rad].
        shift: Shift of the scene along the world's x and y, after the rotation [m].
        name: A camera fixed to the world.

    Raises:
        UnknownNameError: If the model has no such camera.
    """
    number = camera_id(model, name)
    if not moves(yaw, shift):  # not even by rounding
        return
    matrix, quaternion = np.empty(9), np.empty(4)
    mujoco.mju_quat2Mat(matrix, model.cam_quat[number])
    position, rotation = moved_pose(
        model.cam_pos[number], matrix.reshape(3, 3), yaw, shift
    )
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    model.cam_pos[number], model.cam_quat[number] = position, quaternion
