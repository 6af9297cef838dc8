"""Triangles to pixels: which triangle of which geom each pixel shows, and how far.

Corners are rounded to 1/256 of a pixel, and whole numbers decide which pixels' centres
a triangle contains, so that neighbours leave no gap between them and claim no pixel
twice. A pixel keeps the greatest inverse depth.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rlco.physics.mj.compiling import inner

STEPS = 256  # of a corner's place in a pixel
WIDE = 6  # from this number of pixels on, a row's ends are computed
TRIANGLE, GEOM = 0, 1  # layers of what a frame's pixels show
_ONE, _HALF, _STEPS = np.float32(1.0), np.float32(0.5), np.float32(STEPS)
_ZERO, _MARGIN = np.float32(0.0), np.float32(64.0)


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
    for i in range(xs.shape[0]):
        x, y, z = xs[i], ys[i], zs[i]
        depth = m8 * x + m9 * y + m10 * z + m11
        over = _ONE / max(depth, near)
        inverse[i] = over
        across[i] = np.int32(np.floor(cx + fx * (m0 * x + m1 * y + m2 * z + m3) * over))
        down[i] = np.int32(np.floor(cy + fy * (m4 * x + m5 * y + m6 * z + m7) * over))


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
    """
    # As in `_fill_within`, written out: most triangles end at these lines, and a call
    # for each made a frame take 1.6 times as long.
    xs, ys = corners[0], corners[1]
    top, bottom, left, right = box[0], box[1], box[2], box[3]
    for k in range(first, last):
        i, j, n = faces[k, 0], faces[k, 1], faces[k, 2]
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
            _fill(i, n, j, corners, inverse, x0, x1, y0, y1, k, geom, depth, shown)


@inner
def _fill(
    i: int,
    j: int,
    n: int,
    corners: Any,
    inverse: Any,
    x0: int,
    x1: int,
    y0: int,
    y1: int,
    triangle: int,
    geom: int,
    depth: Any,
    shown: Any,
) -> None:
    """Draw one triangle, its corners clockwise on the screen, in a box of pixels."""
    ax, bx, cx = corners[0, i], corners[0, j], corners[0, n]
    ay, by, cy = corners[1, i], corners[1, j], corners[1, n]
    az, bz, cz = inverse[i], inverse[j], inverse[n]
    px, py = STEPS * x0 + STEPS // 2, STEPS * y0 + STEPS // 2
    # Each corner's weight: twice the area of the triangle opposite to it.
    a = (cx - bx) * (py - by) - (cy - by) * (px - bx)
    b = (ax - cx) * (py - cy) - (ay - cy) * (px - cx)
    c = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
    a_right, b_right, c_right = by - cy, cy - ay, ay - by
    a_down, b_down, c_down = cx - bx, ax - cx, bx - ax
    # Inverse depth is linear on the screen.
    share = 1.0 / (a + b + c)
    here = (a * az + b * bz + c * cz) * share
    right = (a_right * az + b_right * bz + c_right * cz) * share * STEPS
    down = (a_down * az + b_down * bz + c_down * cz) * share * STEPS
    # A centre on an edge belongs to the triangle on one side of it: to the one whose
    # upper or left edge it is.
    if not (cy < by or (cy == by and cx > bx)):
        a -= 1
    if not (ay < cy or (ay == cy and ax > cx)):
        b -= 1
    if not (by < ay or (by == ay and bx > ax)):
        c -= 1
    a_right, b_right, c_right = STEPS * a_right, STEPS * b_right, STEPS * c_right
    a_down, b_down, c_down = STEPS * a_down, STEPS * b_down, STEPS * c_down
    wide = x1 - x0 >= WIDE
    for y in range(y0, y1 + 1):
        low, high = 0, x1 - x0
        if wide:
            for weight, step in ((a, a_right), (b, b_right), (c, c_right)):
                if step > 0:
                    if weight < 0:
                        low = max(low, (step - 1 - weight) // step)
                elif weight < 0:
                    high = -1
                elif step < 0:
                    high = min(high, weight // -step)
        u, v, w = a + low * a_right, b + low * b_right, c + low * c_right
        for x in range(x0 + low, x0 + high + 1):
            if (u | v | w) >= 0:
                over = np.float32(here + (x - x0) * right)
                if over >= depth[y, x]:
                    depth[y, x] = over
                    shown[TRIANGLE, y, x] = triangle
                    shown[GEOM, y, x] = geom
            u += a_right
            v += b_right
            w += c_right
        a += a_down
        b += b_down
        c += c_down
        here += down


@inner
def draw_cut(
    points: Any,
    faces: Any,
    first: int,
    last: int,
    two_sided: bool,
    geom: int,
    matrix: Any,
    lens: Any,
    near: Any,
    corners: Any,
    inverse: Any,
    seen: Any,
    outside: Any,
    depth: Any,
    shown: Any,
    box: Any,
) -> None:
    """Draw triangles of which some are behind the camera, or far outside the frame.

    These are cut at the nearest depth and at the sides of a frame a little larger than
    the true one (Sutherland and Hodgman 1974). Most are wholly inside or wholly beyond
    one of these planes, which their corners' sides tell. Arguments as in `project` and
    `draw_triangles`. Written are also `seen`, the vertices in the camera's frame, (3, V
    or more) [m], and `outside`, a bit for each plane that one is beyond, (V or more,).
    """
    planes = np.zeros((5, 4), np.float32)  # inside: a x + b y + c z + d >= 0
    planes[0, 2], planes[0, 3] = _ONE, -near
    for axis in range(2):
        size = np.float32(depth.shape[1 - axis])
        planes[1 + axis, axis], planes[3 + axis, axis] = lens[axis], -lens[axis]
        planes[1 + axis, 2] = lens[2 + axis] + _MARGIN
        planes[3 + axis, 2] = size - lens[2 + axis] + _MARGIN
    for i in range(points.shape[1]):
        for axis in range(3):
            seen[axis, i] = (
                matrix[4 * axis] * points[0, i]
                + matrix[4 * axis + 1] * points[1, i]
                + matrix[4 * axis + 2] * points[2, i]
                + matrix[4 * axis + 3]
            )
        beyond = 0
        for plane in range(5):
            side = planes[plane, 3]
            for axis in range(3):
                side += planes[plane, axis] * seen[axis, i]
            if not side >= _ZERO:
                beyond |= 1 << plane
        outside[i] = beyond
        if beyond == 0:
            _project_one(seen[0, i], seen[1, i], seen[2, i], lens, i, corners, inverse)
    polygon = np.zeros((2, 12, 3), np.float32)
    cut_corners, cut_inverse = np.zeros((2, 12), np.int32), np.zeros(12, np.float32)
    for k in range(first, last):
        i, j, n = faces[k, 0], faces[k, 1], faces[k, 2]
        if outside[i] & outside[j] & outside[n]:
            continue
        if (outside[i] | outside[j] | outside[n]) == 0:
            _fill_within(
                i, j, n, corners, inverse, two_sided, k, geom, depth, shown, box
            )
            continue
        for corner in range(3):
            for axis in range(3):
                polygon[0, corner, axis] = seen[axis, faces[k, corner]]
        count = _cut(polygon, planes)
        for corner in range(count):
            x, y, z = (
                polygon[0, corner, 0],
                polygon[0, corner, 1],
                polygon[0, corner, 2],
            )
            _project_one(x, y, z, lens, corner, cut_corners, cut_inverse)
        for corner in range(1, count - 1):
            _fill_within(
                0,
                corner,
                corner + 1,
                cut_corners,
                cut_inverse,
                two_sided,
                k,
                geom,
                depth,
                shown,
                box,
            )


@inner
def _project_one(
    x: Any, y: Any, z: Any, lens: Any, i: int, corners: Any, inverse: Any
) -> None:
    """Write where one point in the camera's frame is, see `project`."""
    over = _ONE / z
    inverse[i] = over
    corners[0, i] = np.int32(np.floor((lens[2] + lens[0] * x * over) * _STEPS + _HALF))
    corners[1, i] = np.int32(np.floor((lens[3] + lens[1] * y * over) * _STEPS + _HALF))


@inner
def _fill_within(
    i: int,
    j: int,
    n: int,
    corners: Any,
    inverse: Any,
    two_sided: bool,
    triangle: int,
    geom: int,
    depth: Any,
    shown: Any,
    box: Any,
) -> None:
    """Draw one triangle, its corners in any order, within a box of pixels."""
    low_x = min(corners[0, i], corners[0, j], corners[0, n])
    high_x = max(corners[0, i], corners[0, j], corners[0, n])
    low_y = min(corners[1, i], corners[1, j], corners[1, n])
    high_y = max(corners[1, i], corners[1, j], corners[1, n])
    x0 = max((low_x + 127) >> 8, box[2])
    x1 = min((high_x - 128) >> 8, box[3])
    y0 = max((low_y + 127) >> 8, box[0])
    y1 = min((high_y - 128) >> 8, box[1])
    if x0 > x1 or y0 > y1:
        return
    area = (corners[0, j] - corners[0, i]) * (corners[1, n] - corners[1, i]) - (
        corners[1, j] - corners[1, i]
    ) * (corners[0, n] - corners[0, i])
    if area > 0 and two_sided:
        j, n, area = n, j, -area
    if area < 0:
        _fill(i, n, j, corners, inverse, x0, x1, y0, y1, triangle, geom, depth, shown)


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
                here += planes[plane, axis] * polygon[0, corner, axis]
                there += planes[plane, axis] * polygon[0, after, axis]
            if here >= _ZERO:
                for axis in range(3):
                    polygon[1, kept, axis] = polygon[0, corner, axis]
                kept += 1
            if (here >= _ZERO) != (there >= _ZERO):
                share = here / (here - there)
                for axis in range(3):
                    start = polygon[0, corner, axis]
                    end = polygon[0, after, axis]
                    polygon[1, kept, axis] = start + share * (end - start)
                kept += 1
        count = kept
        for corner in range(count):
            for axis in range(3):
                polygon[0, corner, axis] = polygon[1, corner, axis]
    return count
