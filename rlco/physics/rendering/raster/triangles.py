"""A geom's triangles to pixels: which triangle each pixel shows, and how far."""

from __future__ import annotations

from typing import Any

import numpy as np

from rlco.physics.mj.compiling import inner
from rlco.physics.rendering.raster.cutting import draw_part
from rlco.physics.rendering.raster.filling import STEPS, fill

_ONE, _HALF, _STEPS = np.float32(1.0), np.float32(0.5), np.float32(STEPS)


@inner
def project(
    points: Any, matrix: Any, lens: Any, near: Any, corners: Any, inverse: Any
) -> None:
    """Project vertices, all in front of the camera.

    Args:
        points: In the frame of their geom, (3, V) [m].
        matrix: From that frame to the camera's (right, down, forward), (12,).
        lens: Focal lengths and centre [pixels], (4,).
        near: Least depth [m].
        corners: Written: places across and down, (2, V or more) [1/256 pixel].
        inverse: Written: inverse depths, (V or more,) [1/m].
    """
    m0, m1, m2, m3 = matrix[0], matrix[1], matrix[2], matrix[3]
    m4, m5, m6, m7 = matrix[4], matrix[5], matrix[6], matrix[7]
    m8, m9, m10, m11 = matrix[8], matrix[9], matrix[10], matrix[11]
    fx, fy = lens[0] * _STEPS, lens[1] * _STEPS
    cx, cy = lens[2] * _STEPS + _HALF, lens[3] * _STEPS + _HALF
    xs, ys, zs = points[0], points[1], points[2]
    across, down = corners[0], corners[1]
    # A loop for each array that is written: of one for all, a compiler cannot tell
    # that they do not overlap, and does not handle several vertices at once.
    for i in range(xs.shape[0]):
        depth = m8 * xs[i] + m9 * ys[i] + m10 * zs[i] + m11
        inverse[i] = _ONE / max(depth, near)
    for i in range(xs.shape[0]):
        x = m0 * xs[i] + m1 * ys[i] + m2 * zs[i] + m3
        across[i] = np.int32(np.floor(cx + fx * x * inverse[i]))
    for i in range(xs.shape[0]):
        y = m4 * xs[i] + m5 * ys[i] + m6 * zs[i] + m7
        down[i] = np.int32(np.floor(cy + fy * y * inverse[i]))


@inner
def draw_triangles(
    faces: Any,
    first: int,
    last: int,
    two_sided: bool,
    geom: int,
    corners: Any,
    inverse: Any,
    depth: Any,
    shown: Any,
    box: Any,
    cut: bool,
    lens: Any,
    cutting: Any,
) -> None:
    """Draw triangles `first` to `last`, whose corners were projected.

    Args:
        faces: Corners of all triangles, (T, 3).
        first: The first triangle.
        last: One after the last.
        two_sided: Whether they are seen from behind.
        geom: What `shown` calls their geom.
        corners: See `project`.
        inverse: See `project`.
        depth: The frame's inverse depths, (height, width) [1/m].
        shown: What its pixels show, (2, height, width).
        box: First and last row, first and last column to draw [pixels], (4,).
        cut: Whether some are cut, after `cutting.project_some`.
        lens: See `project`.
        cutting: `cutting.Cutting`.
    """
    # As in `fill_within`, written out: most triangles end at these lines, and a call
    # for each made a frame take 1.6 times as long.
    xs, ys, outside = corners[0], corners[1], cutting.outside
    top, bottom, left, right = box[0], box[1], box[2], box[3]
    for k in range(first, last):
        i, j, n = faces[k, 0], faces[k, 1], faces[k, 2]
        if cut:
            if outside[i] & outside[j] & outside[n]:
                continue
            if outside[i] | outside[j] | outside[n]:
                draw_part(i, j, n, two_sided, k, geom, depth, shown, box, lens, cutting)
                continue
        ax, bx, cx = xs[i], xs[j], xs[n]
        # Columns whose centre is between the outermost corners.
        x0 = max((min(ax, bx, cx) + 127) >> 8, left)
        x1 = min((max(ax, bx, cx) - 128) >> 8, right)
        if x0 > x1:
            continue
        ay, by, cy = ys[i], ys[j], ys[n]
        y0 = max((min(ay, by, cy) + 127) >> 8, top)
        y1 = min((max(ay, by, cy) - 128) >> 8, bottom)
        if y0 > y1:
            continue
        # Counter-clockwise seen from outside, with y down: negative in front.
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area > 0 and two_sided:
            j, n, area = n, j, -area
        if area < 0:
            fill(i, n, j, corners, inverse, x0, x1, y0, y1, k, geom, depth, shown)
