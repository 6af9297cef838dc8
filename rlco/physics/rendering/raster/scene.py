"""What a rasteriser draws: the triangles of a model's geoms as flat arrays.

These never change. All that may differ between worlds or change in time (poses,
colours, lights, the camera) is read at every frame, see `state`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.physics.rendering.raster.shapes import Shape, shape_levels
from rlco.physics.rendering.raster.textures import Textures, read_textures

Integers = NDArray[np.int64]
Singles = NDArray[np.float32]

# As MuJoCo shows by default, without robosuite's collision geoms, which are group 0.
SHOWN_GROUPS = (1, 2)
# Sizes of detail for which meshes are simplified, in pixels at 1 m from the camera.
DETAILS = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0)
# The same for a camera on the robot, which comes close to what it sees.
CLOSE_DETAILS = (0.0, 0.0625, 0.125, 0.25, 0.5, 1.0)


class Scene(NamedTuple):
    """G geoms with L levels of detail, which share V vertices and T triangles.

    Geoms that cannot move come first. Coordinates are in the frame of the geom.
    """

    points: Singles  # vertices (3, V) [m]
    faces: NDArray[np.int32]  # corners, counted from the level's first vertex (T, 3)
    normals: Singles  # of a triangle's three corners (T, 9)
    geoms: Integers  # columns ID to UNWRAPPED (G, 6)
    bounds: Singles  # sphere around a geom, half sizes for textures (G, 7) [m]
    levels: Integers  # first and next level's vertex, the same of triangles (L, 4)
    errors: Singles  # detail that a level lacks (L,) [m]
    textures: Textures
    numbers: Integers  # STILL to VERTICES (8,)
    near: np.float32  # what is closer to the camera is not drawn [m]


# Columns of `Scene.geoms`: index in the model, material or -1, first level and the next
# geom's, whether it is seen from behind, whether it has texture coordinates of its own.
ID, MATERIAL, FIRST_LEVEL, NEXT_LEVEL, TWO_SIDED, UNWRAPPED = range(6)
# Columns of `Scene.bounds`.
SPHERE, RADIUS, HALF = 0, 3, 4
# Places in `Scene.numbers`: how many geoms cannot move, the number of lights, the
# camera, the sky's texture or -1, and the most vertices of a level.
STILL, LIGHTS, CAMERA, SKY, VERTICES = range(5)


def make_scene(model: mujoco.MjModel, camera: int, height: int) -> Scene:
    """Return what one camera of a model may see.

    Args:
        model: The compiled model.
        camera: Index of the camera.
        height: Of its frames [pixels].
    """
    fixed = is_fixed(model, int(model.cam_bodyid[camera]))
    pixel = 2.0 * np.tan(np.deg2rad(model.cam_fovy[camera]) / 2) / height
    cells = tuple(float(pixel * d) for d in (DETAILS if fixed else CLOSE_DETAILS))
    drawn = [g for g in range(model.ngeom) if model.geom_group[g] in SHOWN_GROUPS]
    drawn.sort(key=lambda g: not is_fixed(model, int(model.geom_bodyid[g])))
    found = {
        g: [s for s in shape_levels(model, g, cells) if s.faces.size] for g in drawn
    }
    found = {geom: shapes for geom, shapes in found.items() if shapes}
    # Geoms with the same mesh have the same shapes, which are stored once.
    unique = list({id(s): s for shapes in found.values() for s in shapes}.values())
    number = {id(shape): index for index, shape in enumerate(unique)}
    vertex = np.cumsum([0, *(len(s.vertices) for s in unique)])
    triangle = np.cumsum([0, *(len(s.faces) for s in unique)])
    order = [number[id(s)] for shapes in found.values() for s in shapes]
    levels = np.stack([vertex[:-1], vertex[1:], triangle[:-1], triangle[1:]], axis=1)
    rows, bounds, level = [], [], 0
    for geom, shapes in found.items():
        material = int(model.geom_matid[geom])
        plane = model.geom_type[geom] == _PLANE
        ends = level, level + len(shapes)
        rows.append((geom, material, *ends, plane, _unwrapped(model, geom)))
        bounds.append((*_sphere(shapes), *_half(model, geom)))
        level = ends[1]
    still = sum(is_fixed(model, int(model.geom_bodyid[g])) for g in found)
    sky = np.flatnonzero(model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX)
    most = max((len(s.vertices) for s in unique), default=0)
    numbers = (still, model.nlight, camera, sky[0] if sky.size else -1, max(most, 12))
    return Scene(
        points=np.ascontiguousarray(_stack([s.vertices for s in unique], (3,)).T),
        faces=_stack([s.faces for s in unique], (3,)).astype(np.int32),
        normals=_stack([s.normals for s in unique], (3, 3)).reshape(-1, 9),
        geoms=np.array(rows, dtype=np.int64).reshape(-1, 6),
        bounds=np.array(bounds, dtype=np.float32).reshape(-1, 7),
        levels=levels[order],
        errors=np.array([unique[n].error for n in order], dtype=np.float32),
        textures=read_textures(model),
        numbers=np.array(numbers, dtype=np.int64),
        near=np.float32(model.vis.map.znear * model.stat.extent),
    )


_PLANE = mujoco.mjtGeom.mjGEOM_PLANE


def is_fixed(model: mujoco.MjModel, body: int) -> bool:
    """Return whether a body never moves in an episode, nor from one to the next."""
    if model.body_weldid[body] != 0:
        return False
    while body:
        if model.body_mocapid[body] >= 0:
            return False
        body = int(model.body_parentid[body])
    return True


def _half(model: mujoco.MjModel, geom: int) -> NDArray[np.float64]:
    """Return the half sizes that a texture is stretched to; 1 where there are none."""
    kind, size = model.geom_type[geom], model.geom_size[geom].copy()
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        size[:] = size[0]
    elif kind in (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE):
        size[:] = size[0], size[0], size[1]
    elif kind == _PLANE:
        size[2] = 1.0
    return np.where(size > 0.0, size, 1.0)


def _unwrapped(model: mujoco.MjModel, geom: int) -> bool:
    mesh = model.geom_dataid[geom]
    return bool(
        model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH
        and model.mesh_texcoordadr[mesh] >= 0
    )


def _stack(parts: list[NDArray[Any]], shape: tuple[int, ...]) -> NDArray[Any]:
    return np.concatenate(
        [np.zeros((0, *shape), parts[0].dtype if parts else "f4"), *parts]
    )


def _sphere(shapes: list[Shape]) -> tuple[float, ...]:
    """Return the centre and the radius of a sphere around all levels of a geom."""
    vertices = np.concatenate([shape.vertices for shape in shapes])
    center = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    # A little more, whatever rounding does.
    radius = 1.0001 * np.linalg.norm(vertices - center, axis=1).max()
    return (*center.tolist(), float(radius))
