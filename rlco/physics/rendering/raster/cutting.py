"""Triangles of which a part is behind the camera, or far outside the frame.

They are cut at the nearest depth and at the sides of a frame a little larger than the
true one (Sutherland and Hodgman 1974). Most are wholly inside or wholly beyond one of
these planes, which their corners' sides tell.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rlco.physics.mj.compiling import inner
from rlco.physics.rendering.raster.filling import STEPS, fill_within

_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
_STEPS, _MARGIN = np.float32(STEPS), np.float32(64.0)


class Cutting(NamedTuple):
    """Working space for geoms that reach behind the camera, or far from the frame."""

    planes: NDArray[np.float32]  # inside: a x + b y + c z + d >= 0, (5, 4)
    seen: NDArray[np.float32]  # vertices in the camera's frame (3, V) [m]
    outside: NDArray[np.uint8]  # a bit for each plane that one is beyond (V,)
    polygon: NDArray[np.float32]  # corners before and after a cut (2, 3, 12) [m]
    corners: NDArray[np.int32]  # of the polygon, on the screen (2, 12)
    inverse: NDArray[np.float32]  # their inverse depths (12,)


@inner
def make_cutting(vertices: int) -> Any:
    """Return the working space for geoms of at most that number of vertices."""
    return Cutting(
        np.zeros((5, 4), np.float32),
        np.empty((3, vertices), np.float32),
        np.empty(vertices, np.uint8),
        np.empty((2, 3, 12), np.float32),
        np.empty((2, 12), np.int32),
        np.empty(12, np.float32),
    )


@inner
def project_some(
    points: Any,
    matrix: Any,
    lens: Any,
    near: Any,
    height: int,
    width: int,
    corners: Any,
    inverse: Any,
    cutting: Any,
) -> None:
    """Project vertices of which some are behind the camera, or far outside the frame.

    Args:
        points: See `triangles.project`.
        matrix: See `triangles.project`.
        lens: See `triangles.project`.
        near: See `triangles.project`.
        height: Of the frame.
        width: Of the frame.
        corners: Written, and only of use where vertices are inside all planes; see
            `triangles.project`.
        inverse: The same.
        cutting: `Cutting`, written.
    """
    planes, seen, outside = cutting.planes, cutting.seen, cutting.outside
    planes[0, 2], planes[0, 3] = _ONE, -near
    for axis in range(2):
        size = np.float32(width if axis == 0 else height)
        planes[1 + axis, axis], planes[3 + axis, axis] = lens[axis], -lens[axis]
        planes[1 + axis, 2] = lens[2 + axis] + _MARGIN
        planes[3 + axis, 2] = size - lens[2 + axis] + _MARGIN
    count = points.shape[1]
    xs, ys, zs = points[0], points[1], points[2]
    for axis in range(3):
        to = seen[axis]
        a, b, c = matrix[4 * axis], matrix[4 * axis + 1], matrix[4 * axis + 2]
        d = matrix[4 * axis + 3]
        for i in range(count):
            to[i] = a * xs[i] + b * ys[i] + c * zs[i] + d
    xs, ys, zs = seen[0], seen[1], seen[2]
    outside[:count] = 0
    for plane in range(5):
        a, b, c, d = (
            planes[plane, 0],
            planes[plane, 1],
            planes[plane, 2],
            planes[plane, 3],
        )
        bit = np.uint8(1 << plane)
        for i in range(count):
            side = d + a * xs[i] + b * ys[i] + c * zs[i]
            outside[i] |= np.uint8(0) if side >= _ZERO else bit
    _to_screen(xs, ys, zs, lens, count, corners, inverse)


@inner
def draw_part(
    i: int,
    j: int,
    n: int,
    two_sided: bool,
    triangle: int,
    geom: int,
    depth: Any,
    shown: Any,
    box: Any,
    lens: Any,
    cutting: Any,
) -> None:
    """Draw the part of a triangle that is inside all planes.

    Arguments as of `triangles.draw_triangles`, with the triangle's corners and
    number.
    """
    polygon, seen, corners = cutting.polygon, cutting.seen, cutting.corners
    for axis in range(3):
        polygon[0, axis, 0] = seen[axis, i]
        polygon[0, axis, 1] = seen[axis, j]
        polygon[0, axis, 2] = seen[axis, n]
    count = _cut(polygon, cutting.planes)
    xs, ys, zs = polygon[0, 0], polygon[0, 1], polygon[0, 2]
    _to_screen(xs, ys, zs, lens, count, corners, cutting.inverse)
    # Numbers as in `faces`: of others, numba would compile `fill` once more.
    first: Any = np.int32(0)
    for corner in range(1, count - 1):
        here: Any = np.int32(corner)
        after: Any = np.int32(corner + 1)
        fill_within(
            first,
            here,
            after,
            corners,
            cutting.inverse,
            two_sided,
            triangle,
            geom,
            depth,
            shown,
            box,
        )


@inner
def _to_screen(
    xs: Any,
    ys: Any,
    zs: Any,
    lens: Any,
    count: int,
    corners: Any,
    inverse: Any,
) -> None:
    """Write where points in the camera's frame are, see `triangles.project`."""
    across, down = corners[0], corners[1]
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    for i in range(count):
        inverse[i] = _ONE / zs[i]
    for i in range(count):
        place = (cx + fx * xs[i] * inverse[i]) * _STEPS + _HALF
        across[i] = np.int32(np.floor(place))
    for i in range(count):
        place = (cy + fy * ys[i] * inverse[i]) * _STEPS + _HALF
        down[i] = np.int32(np.floor(place))


@inner
def _cut(polygon: Any, planes: Any) -> int:
    """Cut the triangle `polygon[0]` at planes; return its number of corners."""
    count = 3
    for plane in range(planes.shape[0]):
        kept = 0
        for corner in range(count):
            after = (corner + 1) % count
            here, there = planes[plane, 3], planes[plane, 3]
            for axis in range(3):
                here += planes[plane, axis] * polygon[0, axis, corner]
                there += planes[plane, axis] * polygon[0, axis, after]
            if here >= _ZERO:
                for axis in range(3):
                    polygon[1, axis, kept] = polygon[0, axis, corner]
                kept += 1
            if (here >= _ZERO) != (there >= _ZERO):
                share = here / (here - there)
                for axis in range(3):
                    start = polygon[0, axis, corner]
                    end = polygon[0, axis, after]
                    polygon[1, axis, kept] = start + share * (end - start)
                kept += 1
        count = kept
        for corner in range(count):
            for axis in range(3):
                polygon[0, axis, corner] = polygon[1, axis, corner]
    return count
