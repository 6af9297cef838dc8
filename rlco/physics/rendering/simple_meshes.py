"""Reduce meshes to fewer triangles, and find the geoms that a camera cannot see.

The time of software rendering grows with the number of triangles, and a robot's visual
meshes have a hundred thousand of them for a frame of 128 x 128 pixels.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray


def merge_vertices(model: mujoco.MjModel, cell: float) -> None:
    """Merge mesh vertices that lie in the same cell of a grid, in place.

    Each cell keeps the vertex nearest to the mean of its vertices, with its normals.
    Triangles that lose a corner, and duplicates, are removed (Rossignac and Borrel
    1993). Only rendering changes, so use a copy of the model, and only for a rendering
    context.

    Args:
        model: The compiled model.
        cell: Edge of a cell [m].
    """
    for mesh in range(model.nmesh):
        vertices = _rows(model.mesh_vert, model.mesh_vertadr, model.mesh_vertnum, mesh)
        faces = _rows(model.mesh_face, model.mesh_faceadr, model.mesh_facenum, mesh)
        merged = representatives(vertices, cell)[faces]
        kept = distinct_faces(merged, len(vertices))
        first, count = model.mesh_faceadr[mesh], len(kept)
        model.mesh_face[first : first + count] = merged[kept]
        corners = [model.mesh_facenormal]
        if model.mesh_texcoordadr[mesh] >= 0:
            corners.append(model.mesh_facetexcoord)
        for corner in corners:
            corner[first : first + count] = corner[first + kept]
        model.mesh_facenum[mesh] = count


def out_of_view(
    model: mujoco.MjModel, data: Any, camera: int, aspect: float
) -> NDArray[np.bool_]:
    """Return which geoms are entirely outside a camera's view, shape (ngeom,).

    The box around each geom is compared with the view's four sides and the plane of
    the camera. A geom that this cannot exclude, such as an infinite plane, counts as
    visible.

    Args:
        model: The compiled model.
        data: Its state, with current positions.
        camera: Index of a perspective camera.
        aspect: Width over height of the frame.
    """
    up = np.deg2rad(model.cam_fovy[camera]) / 2
    side = np.arctan(np.tan(up) * aspect)
    # Outward normals in the camera's frame: x right, y up, looking along -z.
    normals = np.array(
        [
            [np.cos(side), 0.0, np.sin(side)],
            [-np.cos(side), 0.0, np.sin(side)],
            [0.0, np.cos(up), np.sin(up)],
            [0.0, -np.cos(up), np.sin(up)],
            [0.0, 0.0, 1.0],
        ]
    )
    normals = normals @ data.cam_xmat[camera].reshape(3, 3).T
    axes = data.geom_xmat.reshape(-1, 3, 3)
    boxes = model.geom_aabb  # center and half sizes in the geom's frame
    centers = data.geom_xpos + (axes @ boxes[:, :3, None])[..., 0]
    reach = np.abs(normals @ axes) @ boxes[:, 3:, None]
    outside = (centers - data.cam_xpos[camera]) @ normals.T > reach[..., 0]
    hidden: NDArray[np.bool_] = outside.any(axis=1) & (model.geom_rbound > 0)
    return hidden


def _rows(values: Any, address: Any, number: Any, index: int) -> Any:
    return values[address[index] : address[index] + number[index]]


def representatives(vertices: Any, cell: float) -> NDArray[np.int64]:
    """Return the vertex that represents each vertex, shape (V,)."""
    grid = np.floor(vertices / cell).astype(np.int64)
    grid -= grid.min(axis=0)
    sides = grid.max(axis=0) + 1
    keys = grid @ np.array([sides[1] * sides[2], sides[2], 1])
    _, group, size = np.unique(keys, return_inverse=True, return_counts=True)
    sums = [np.bincount(group, vertices[:, axis]) for axis in range(3)]
    mean = np.stack(sums, axis=1) / size[:, None]
    far = np.linalg.norm(vertices - mean[group], axis=1)
    order = np.lexsort((far, group))
    starts = np.cumsum(size) - size
    stays: NDArray[np.int64] = order[starts][group]
    return stays


def distinct_faces(faces: Any, vertices: int) -> NDArray[np.int64]:
    """Return the triangles with three different corners, without duplicates, (K,)."""
    corners = np.sort(faces, axis=1).astype(np.int64)
    whole = np.flatnonzero((np.diff(corners, axis=1) > 0).all(axis=1))
    keys = corners[whole] @ np.array([vertices**2, vertices, 1])
    _, first = np.unique(keys, return_index=True)
    kept: NDArray[np.int64] = whole[np.sort(first)]
    return kept
