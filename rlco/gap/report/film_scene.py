"""A robot's poses as pictures: shapes, shades and depths, without OpenGL."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError
from rlco.gap.logs.log import Array
from rlco.physics.rendering.raster import RasterCamera

CAMERA = "rlco_film"
_FIELD = 30.0  # vertical field of view [degrees]
_ROOM = 1.04  # of the picture beyond the robot
# Cameras that are tried: above the horizon [degrees], with a preference for the usual.
_UP = {15.0: 1.0, 40.0: 0.95, 65.0: 0.85}
_AROUND = 24
_DRAWN, _HIDDEN = 1, 0  # groups: RasterCamera leaves out the first
_GREY = 0.78


class Pose(NamedTuple):
    """One pose of the robot in the picture."""

    shade: NDArray[np.float32]  # brightness, (height, width)
    robot: NDArray[np.bool_]  # whether a pixel shows the robot, (height, width)
    moving: NDArray[np.bool_]  # whether it shows a part that the joints move


class FilmScene:
    """A model's robot alone, seen from where its motion shows best.

    Args:
        spec: The user's whole model; not modified.
        joints: Names of the joints that move.
        size: Height and width of pictures [pixels].

    Raises:
        NothingToDrawError: The robot has no geoms, or meshes without faces.
    """

    def __init__(
        self, spec: mujoco.MjSpec, joints: Sequence[str], size: tuple[int, int]
    ) -> None:
        own = spec.copy()
        for light in list(own.lights):
            own.delete(light)
        own.worldbody.add_camera(name=CAMERA, fovy=_FIELD)
        self.model = own.compile()
        self.data = mujoco.MjData(self.model)
        self._size = size
        ids = [self.model.joint(name).id for name in joints]
        self._columns = self.model.jnt_qposadr[ids]
        self._moving = _below(self.model, self.model.jnt_bodyid[ids])
        self._drawn = self._choose_geoms()
        self._moving_geoms = self._moving[self.model.geom_bodyid] & self._drawn
        if not self._moving_geoms.any():
            raise NothingToDrawError
        self._camera: RasterCamera | None = None

    def _choose_geoms(self) -> NDArray[np.bool_]:
        """Return the geoms that show the robot, and paint them all alike."""
        model = self.model
        roots = model.body_rootid[self._moving]
        robot = np.isin(model.body_rootid, roots) & (model.body_rootid > 0)
        of = model.geom_bodyid
        plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
        found = np.zeros(model.ngeom, dtype=np.bool_)
        for body in np.flatnonzero(robot):
            mine = (of == body) & ~plane
            # What is for looks alone is in the groups 1 and 2, else in 0.
            looks = mine & np.isin(model.geom_group, (1, 2))
            plain = mine & (model.geom_group == 0)
            found |= next((some for some in (looks, plain) if some.any()), mine)
        model.geom_group[:] = np.where(found, _DRAWN, _HIDDEN)
        model.geom_matid[:] = -1
        model.geom_rgba[:] = (_GREY, _GREY, _GREY, 1.0)
        light = model.vis.headlight
        light.ambient[:], light.diffuse[:], light.specular[:] = 0.42, 0.55, 0.05
        return found

    def place(self, positions: Array) -> None:
        """Move the robot to joint positions, (joints,)."""
        data = self.data
        data.qpos[:] = self.model.qpos0
        data.qpos[self._columns] = positions
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_comPos(self.model, data)
        mujoco.mj_camlight(self.model, data)

    def corners(self, positions: Array) -> Array:
        """Return eight corners around each drawn geom, (geoms, 8, 3), [m]."""
        self.place(positions)
        model, data = self.model, self.data
        drawn = np.flatnonzero(self._drawn)
        box = model.geom_aabb[drawn]
        signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
        local = box[:, None, :3] + signs * box[:, None, 3:]
        turn = data.geom_xmat[drawn].reshape(-1, 3, 3)
        placed = np.einsum("gij,gkj->gki", turn, local)
        return np.asarray(placed + data.geom_xpos[drawn][:, None])

    def moved_by(self, one: Array, other: Array) -> Array:
        """Return how far each corner of the moving parts moves, (corners, 3), [m]."""
        parts = self._moving_geoms[self._drawn]
        away = self.corners(other)[parts] - self.corners(one)[parts]
        return np.asarray(away.reshape(-1, 3))

    def look(self, tracks: Sequence[Array], differences: Array) -> None:
        """Choose a camera that sees all poses, and most of what differs.

        Args:
            tracks: Poses to be seen, each (T, joints).
            differences: Displacements to be seen, (K, 3), [m].
        """
        points = np.concatenate(
            [self.corners(pose).reshape(-1, 3) for track in tracks for pose in track]
        )
        best, turn, spread = -1.0, np.eye(3), np.cov(points.T)
        for up, around in product(_UP, np.arange(_AROUND) * 2.0 * np.pi / _AROUND):
            tried = _axes(around, np.deg2rad(up))
            flat = tried[:, :2]
            # What differs is to be seen, on a robot that is seen from its side.
            seen = float(np.linalg.norm(differences @ flat))
            area = float(np.linalg.det(flat.T @ spread @ flat))
            score = _UP[up] * seen * max(area, 0.0) ** 0.25
            # Of equal views the first: the same film each time.
            if score > best * (1.0 + 1e-6):
                best, turn = score, tried
        height, width = self._size
        flat = points @ turn
        middle = (flat.min(axis=0) + flat.max(axis=0)) / 2.0
        away = flat - middle
        # Each corner has to be within the field of view, the near ones most of all.
        tall = np.maximum(np.abs(away[:, 1]), np.abs(away[:, 0]) * height / width)
        near = _ROOM * tall / np.tan(np.deg2rad(_FIELD) / 2.0) + away[:, 2]
        distance = float(near.max())
        at = turn @ (middle + np.array([0.0, 0.0, distance]))
        camera = self.model.camera(CAMERA).id
        self.model.cam_pos[camera] = at
        mujoco.mju_mat2Quat(self.model.cam_quat[camera], turn.ravel())
        # MuJoCo's near plane is in units of the whole model, which may be a room.
        self.model.vis.map.znear = 0.02 * distance / self.model.stat.extent
        self._camera = RasterCamera(self.model, self._size, CAMERA)

    def draw(self, positions: Array) -> Pose:
        """Return the picture of a pose, (joints,)."""
        if self._camera is None:
            raise ValueError("look() comes before draw()")
        self.place(positions)
        found = self._camera.channels(self.data)
        robot = found.geom >= 0
        moving = np.append(self._moving_geoms, False)[found.geom]  # -1: no geom
        # Everything is one grey under one white light: a channel says it all.
        return Pose(found.image[1] / np.float32(255.0), robot, moving)


class NothingToDrawError(RlcoError):
    """A robot without anything to see."""

    def __init__(self) -> None:
        super().__init__("the model has no geoms or meshes on its moving links.")


def _below(model: mujoco.MjModel, bodies: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return the bodies that one of some bodies carries, themselves included."""
    found = np.zeros(model.nbody, dtype=np.bool_)
    found[bodies] = True
    for body in range(1, model.nbody):
        found[body] |= found[model.body_parentid[body]]
    return found


def _axes(around: float, up: float) -> Array:
    """Return a camera's right, up and back in the world, as columns (3, 3)."""
    back = np.array(
        [np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)]
    )
    right = np.array([-np.sin(around), np.cos(around), 0.0])
    return np.stack([right, np.cross(back, right), back], axis=1)
