"""The pixels of one triangle whose corners are on the screen.

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


@inner
def fill(
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
def fill_within(
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
        fill(i, n, j, corners, inverse, x0, x1, y0, y1, triangle, geom, depth, shown)
