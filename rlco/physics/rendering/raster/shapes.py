"""Triangles of geoms: primitives cut into flat pieces, meshes at several details.

Everything is in the geom's own frame. A corner of a triangle has a normal of its own,
so that edges stay sharp where a surface has them.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.physics.rendering.raster.same_arrays import SameArrays
from rlco.physics.rendering.simple_meshes import distinct_faces, representatives

# A corner's normal counts as that of a smooth surface if its cosine with the triangle's
# own is at least this, and else as that of an edge; the value is MuJoCo's.
SMOOTH = 0.8
# Sides of round shapes, from the coarsest.
SIDES = (8, 12, 20, 32, 64)
_SHAPES = mujoco.mjtGeom


class Shape(NamedTuple):
    """Triangles of one level of detail."""

    vertices: NDArray[np.float32]  # (V, 3) [m]
    faces: NDArray[np.int32]  # corners, counter-clockwise from outside, (T, 3)
    normals: NDArray[np.float32]  # of each corner, (T, 3, 3)
    error: float  # how far it may be from the exact surface [m]


def shape_levels(model: mujoco.MjModel, geom: int, cells: tuple[float, ...]) -> Any:
    """Return a geom's levels of detail from the finest to the coarsest.

    Args:
        model: The compiled model.
        geom: Index of the geom.
        cells: Sizes of detail that meshes may lose, ascending; 0 loses none [m].

    Returns:
        A list of `Shape`; empty for a kind of geom that is not drawn.

    Example:
        >>> import mujoco
        >>> geom = "<geom type='box' size='1 1 1'/>"
        >>> xml = f"<mujoco><worldbody>{geom}</worldbody></mujoco>"
        >>> (box,) = shape_levels(mujoco.MjModel.from_xml_string(xml), 0, (0.0,))
        >>> box.faces.shape
        (12, 3)
    """
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == _SHAPES.mjGEOM_MESH:
        return _mesh_levels(model, int(model.geom_dataid[geom]), cells)
    if kind == _SHAPES.mjGEOM_BOX:
        return [_box(size)]
    if kind == _SHAPES.mjGEOM_PLANE:
        return [_plane(model, size)]
    if kind in (_SHAPES.mjGEOM_SPHERE, _SHAPES.mjGEOM_ELLIPSOID):
        radii = np.full(3, size[0]) if kind == _SHAPES.mjGEOM_SPHERE else size
        return [_ball(radii, 0.0, sides) for sides in reversed(SIDES)]
    if kind == _SHAPES.mjGEOM_CAPSULE:
        radii = np.full(3, size[0])
        return [_ball(radii, size[1], sides) for sides in reversed(SIDES)]
    if kind == _SHAPES.mjGEOM_CYLINDER:
        return [_cylinder(size[0], size[1], sides) for sides in reversed(SIDES)]
    return []


def _flat(vertices: Any, faces: Any) -> Shape:
    """Return a shape whose triangles are lit as flat ones."""
    corners = np.asarray(vertices, dtype=np.float64)
    faces = np.asarray(faces, dtype=np.int32)
    normals = np.repeat(_face_normals(corners, faces)[:, None], 3, axis=1)
    return Shape(corners.astype(np.float32), faces, normals.astype(np.float32), 0.0)


def _face_normals(vertices: Any, faces: Any) -> NDArray[np.float64]:
    """Return unit normals of triangles, (T, 3); 0 where a triangle has no area."""
    a, b, c = (vertices[faces[:, corner]].astype(np.float64) for corner in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    unit: NDArray[np.float64] = np.divide(
        normals, length, out=np.zeros_like(normals), where=length > 0
    )
    return unit


def _box(size: Any) -> Shape:
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6)]
    quads += [(0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    return _flat(signs * size, faces)


def _plane(model: mujoco.MjModel, size: Any) -> Shape:
    # A side of 0 means infinite: beyond everything that a camera draws.
    far = 2.0 * float(model.vis.map.zfar * model.stat.extent)
    x, y = (side if side > 0 else far for side in size[:2])
    corners = [(-x, -y, 0.0), (x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0)]
    return _flat(corners, [(0, 1, 2), (0, 2, 3)])


def _ring(sides: int) -> NDArray[np.float64]:
    angle = 2.0 * np.pi * np.arange(sides) / sides
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _sagitta(radius: float, sides: int) -> float:
    """Return how far a regular polygon's sides are inside its circle [m]."""
    return float(radius * (1.0 - np.cos(np.pi / sides)))


def _cylinder(radius: float, half: float, sides: int) -> Shape:
    ring = _ring(sides)
    low, high = (
        np.column_stack([radius * ring, np.full(sides, z)]) for z in (-half, half)
    )
    vertices = np.concatenate([low, high, [[0, 0, -half], [0, 0, half]]])
    here = np.arange(sides)
    after = (here + 1) % sides
    bottom, top = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    faces = np.concatenate(
        [
            np.stack([here, after, sides + after], axis=1),
            np.stack([here, sides + after, sides + here], axis=1),
            np.stack([bottom, after, here], axis=1),
            np.stack([top, sides + here, sides + after], axis=1),
        ]
    )
    outward = np.column_stack([ring, np.zeros(sides)])
    down, up = np.zeros((2, sides, 3, 3))
    down[..., 2], up[..., 2] = -1.0, 1.0
    normals = np.concatenate(
        [
            np.stack([outward, outward[after], outward[after]], axis=1),
            np.stack([outward, outward[after], outward], axis=1),
            down,
            up,
        ]
    )
    return Shape(
        vertices.astype(np.float32),
        faces.astype(np.int32),
        normals.astype(np.float32),
        _sagitta(radius, sides),
    )


def _ball(radii: Any, half: float, sides: int) -> Shape:
    """Return an ellipsoid, cut in two halves `half` above and below the centre."""
    stacks = sides // 2  # an even number: the equator is one of the rings
    ring = _ring(sides)
    polar = np.pi * np.arange(stacks + 1) / stacks
    rings = [(angle, half) for angle in polar[: stacks // 2 + 1]]
    # The equator comes twice, so that a capsule's cylinder lies between.
    rings += [(angle, -half) for angle in polar[stacks // 2 :]]
    unit = np.concatenate(
        [
            np.column_stack([np.sin(a) * ring, np.full(sides, np.cos(a))])
            for a, _ in rings
        ]
    )
    vertices = unit * radii
    vertices[:, 2] += np.repeat([shift for _, shift in rings], sides)
    here = np.arange(sides)
    after = (here + 1) % sides
    faces = np.concatenate(
        [
            np.concatenate(
                [
                    np.stack([a + here, b + here, b + after], axis=1),
                    np.stack([a + here, b + after, a + after], axis=1),
                ]
            )
            for a, b in ((r * sides, (r + 1) * sides) for r in range(len(rings) - 1))
        ]
    )
    faces = faces[np.linalg.norm(_face_normals(vertices, faces), axis=1) > 0.5]
    normals = unit / radii
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Shape(
        vertices.astype(np.float32),
        faces.astype(np.int32),
        normals[faces].astype(np.float32),
        _sagitta(float(np.max(radii)), sides),
    )


def _mesh_levels(
    model: mujoco.MjModel, mesh: int, cells: tuple[float, ...]
) -> list[Shape]:
    vert, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    faces = slice(face, face + model.mesh_facenum[mesh])
    normal = model.mesh_normaladr[mesh]
    return _levels(
        SameArrays(
            model.mesh_vert[vert : vert + model.mesh_vertnum[mesh]],
            model.mesh_face[faces],
            model.mesh_normal[normal : normal + model.mesh_normalnum[mesh]],
            model.mesh_facenormal[faces],
        ),
        cells,
        # MuJoCo looks for sharp edges only where there are no texture coordinates.
        bool(model.mesh_texcoordadr[mesh] < 0),
    )


@functools.lru_cache(maxsize=512)
def _levels(mesh: SameArrays, cells: tuple[float, ...], edges: bool) -> list[Shape]:
    """Return a mesh without details smaller than each of `cells`; takes 30 ms."""
    vertices, faces, normals, face_normals = mesh.arrays
    corners = normals[face_normals]
    return [_merged(vertices, faces, corners, cell, edges) for cell in cells]


def _merged(vertices: Any, faces: Any, normals: Any, cell: float, edges: bool) -> Shape:
    """Return a mesh whose vertices within a cell are merged; cell 0 merges none."""
    if cell > 0.0:
        merged = representatives(vertices, cell)[faces]
        kept = distinct_faces(merged, len(vertices))
        faces, normals = merged[kept], normals[kept]
    flat = _face_normals(vertices, faces)[:, None]
    # Merging may turn a small triangle over, but not the surface.
    turned = (normals.mean(axis=1, keepdims=True) * flat).sum(axis=2) < 0.0
    turned &= cell > 0.0
    faces = np.where(turned, faces[:, [0, 2, 1]], faces)
    normals = np.where(turned[..., None], normals[:, [0, 2, 1]], normals)
    flat = np.where(turned[..., None], -flat, flat)
    if edges:
        sharp = (normals * flat).sum(axis=2, keepdims=True) < SMOOTH
        normals = np.where(sharp, flat, normals)
    used, corners = np.unique(faces, return_inverse=True)
    return Shape(
        vertices[used].astype(np.float32),
        corners.reshape(-1, 3).astype(np.int32),
        normals.astype(np.float32),
        cell,
    )
