"""The colours of textures where pixels look, and of the sky."""

from __future__ import annotations

from typing import Any

import numpy as np

from rlco.physics.mj.compiling import inner
from rlco.physics.rendering.raster.pixels import (
    AVERAGED,
    COLOUR,
    CORNER,
    FRAME,
    LAST,
    LOCAL,
    NEXT,
    ON_TEXTURE,
    PIXELS,
    PLANE,
    RAY,
    SCALE,
    SLOPES,
    TEXTURE_OF,
    TIMES,
)
from rlco.physics.rendering.raster.textures import FLAT, cube_face, on_cube, sample

_ZERO, _ONE, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
_TINY = np.float32(1e-20)
_FIRST: Any = np.int64(0)  # face of a cube
_MOST = np.float32(8.0)  # places of a texture that one pixel averages


@inner
def texture(textures: Any, count: int, lens: Any, p: Any) -> None:
    """Multiply the lit colours of the first pixels with those of their textures.

    Args:
        textures: `textures.Textures`.
        count: How many of the pixels.
        lens: Focal lengths and centre [pixels], (4,).
        p: `pixels.Pixels`, after `lighting.light`.
    """
    v, places = p.values, p.places
    located = False
    for i in range(count):
        number = places[TEXTURE_OF + i]
        if number < 0:
            continue
        if places[AVERAGED + i]:
            for c in range(3):
                v[COLOUR + PIXELS * c + i] *= textures.means[number, c]
            continue
        if not located:
            _locate(count, lens, v)
            located = True
        red, green, blue = _seen(textures, number, i, v)
        v[COLOUR + i] *= red
        v[COLOUR + NEXT + i] *= green
        v[COLOUR + LAST + i] *= blue


@inner
def _locate(count: int, lens: Any, v: Any) -> None:
    """Write where rays of pixels, and of their neighbours, meet the planes."""
    for i in range(count):
        at = LOCAL + i
        x, y, z = v[at], v[at + NEXT], v[at + LAST]
        v[ON_TEXTURE + i] = x / v[SCALE + i]
        v[ON_TEXTURE + NEXT + i] = y / v[SCALE + NEXT + i]
        v[ON_TEXTURE + LAST + i] = z / v[SCALE + LAST + i]
    for step in range(2):
        aside = _ONE / lens[0] if step == 0 else _ZERO
        lower = _ONE / lens[1] if step == 1 else _ZERO
        to = ON_TEXTURE + 3 * PIXELS * (step + 1)
        slopes = SLOPES + PIXELS * step
        for i in range(count):
            at = FRAME + i
            a, b, c, d = v[at], v[at + PIXELS], v[at + 2 * PIXELS], v[at + 3 * PIXELS]
            at += 4 * PIXELS
            e, f, g, h = v[at], v[at + PIXELS], v[at + 2 * PIXELS], v[at + 3 * PIXELS]
            at += 4 * PIXELS
            k, m, n, o = v[at], v[at + PIXELS], v[at + 2 * PIXELS], v[at + 3 * PIXELS]
            # The camera's position in the geom's frame.
            ex, ey, ez = (
                -(a * d + e * h + k * o),
                -(b * d + f * h + m * o),
                -(c * d + g * h + n * o),
            )
            nx, ny, nz = v[PLANE + i], v[PLANE + NEXT + i], v[PLANE + LAST + i]
            height = (
                nx * v[CORNER + i]
                + ny * v[CORNER + NEXT + i]
                + nz * v[CORNER + LAST + i]
            )
            distance = height - (nx * ex + ny * ey + nz * ez)
            across, down = v[RAY + i] + aside, v[RAY + NEXT + i] + lower
            x = a * across + e * down + k
            y = b * across + f * down + m
            z = c * across + g * down + n
            slope = nx * x + ny * y + nz * z
            scale = distance / slope
            v[slopes + i] = slope
            v[to + i] = (ex + x * scale) / v[SCALE + i]
            v[to + NEXT + i] = (ey + y * scale) / v[SCALE + NEXT + i]
            v[to + LAST + i] = (ez + z * scale) / v[SCALE + LAST + i]


@inner
def _seen(textures: Any, texture: int, i: int, v: Any) -> Any:
    """Return the texture's red, green and blue at one pixel, shares of 1."""
    flat = textures.table[texture, 0] == FLAT
    face, u0, v0 = _FIRST, _ZERO, _ZERO
    long_u, long_v, longer, shorter = _ZERO, _ZERO, _ZERO, _ZERO
    for step in range(3):
        if step and abs(v[SLOPES + PIXELS * (step - 1) + i]) < _TINY:
            continue
        at = ON_TEXTURE + 3 * PIXELS * step + i
        x, y, z = v[at], v[at + NEXT], v[at + LAST]
        if flat:
            u1 = _HALF * v[TIMES + i] * x - _HALF
            v1 = -_HALF * v[TIMES + NEXT + i] * y - _HALF
        else:
            if step == 0:
                face = cube_face(x, y, z)
            u1, v1 = on_cube(face, x, y, z)
        if step == 0:
            u0, v0 = u1, v1
            continue
        reach = max(abs(u1 - u0), abs(v1 - v0))
        if reach > longer:
            long_u, long_v, longer, shorter = u1 - u0, v1 - v0, reach, longer
        else:
            shorter = max(shorter, reach)
    # A pixel covers a long strip of a slanting surface: several places along it.
    count = np.int64(min(longer / max(shorter, _TINY) + _HALF, _MOST)) or 1
    reach = max(shorter, longer / np.float32(count))
    red, green, blue = _ZERO, _ZERO, _ZERO
    for part in range(count):
        share = (np.float32(part) + _HALF) / np.float32(count) - _HALF
        across, down = u0 + share * long_u, v0 + share * long_v
        r, g, b = sample(textures, texture, face, across, down, reach)
        red += r / np.float32(count)
        green += g / np.float32(count)
        blue += b / np.float32(count)
    return red, green, blue


@inner
def sky(textures: Any, texture: int, x: int, y: int, lens: Any) -> Any:
    """Return the sky's red, green and blue at a pixel, shares of 1: 0 without one.

    Args:
        textures: `textures.Textures`.
        texture: Which of them it is, or -1.
        x: The pixel's column.
        y: Its row.
        lens: See `frames.Scratch`; from its fifth number on, the rotation from
            the camera's frame (right, down, forward) to the world's.
    """
    if texture < 0:
        return _ZERO, _ZERO, _ZERO
    across = (np.float32(x) + _HALF - lens[2]) / lens[0]
    down = (np.float32(y) + _HALF - lens[3]) / lens[1]
    wx = lens[4] * across + lens[5] * down + lens[6]
    wy = lens[7] * across + lens[8] * down + lens[9]
    wz = lens[10] * across + lens[11] * down + lens[12]
    # The sky's cube is turned by a quarter about x.
    face = cube_face(wx, wz, -wy)
    u, w = on_cube(face, wx, wz, -wy)
    return sample(textures, texture, face, u, w, _ZERO)
