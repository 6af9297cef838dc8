"""Where pixels' points are and how they are lit: MuJoCo's lights and materials.

OpenGL's fixed lighting (ambient, diffuse and Blinn's specular light of each source),
per pixel rather than per corner of a triangle. There are no shadows and no reflections.

Innermost loops are over the pixels, without branches, so that several are done at once.
The order of operations is fixed: nothing is fused or reassociated, and processors agree
to the bit.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rlco.physics.mj.compiling import inner
from rlco.physics.rendering.raster.pixels import (
    BASE,
    COLOUR,
    CORNER,
    COUNT,
    DEPTH,
    FACING,
    FRAME,
    LAST,
    LIGHT,
    LOCAL,
    NEXT,
    NORMAL,
    NORMALS,
    OWN_COLOUR,
    PIXELS,
    PLANE,
    POINT,
    POWER,
    RAY,
    SECOND,
    SHARES,
    STRENGTH,
    THIRD,
    VIEW,
)
from rlco.physics.rendering.raster.state import (
    AMBIENT,
    ATTENUATION,
    CUTOFF,
    DIFFUSE,
    EXPONENT,
    LIGHT_ON,
    LIGHT_PLACED,
    LIGHT_SIZE,
    SPECULAR,
)

_ZERO, _ONE, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
_TINY = np.float32(1e-20)
_MOST = np.float32(2.0**31)  # of an exponent: the loop over its bits has to end


@inner
def locate(count: int, v: Any) -> None:
    """Write points, views, planes and normals of pixels, from what was loaded.

    Args:
        count: How many, from the first on.
        v: Values of `pixels.Pixels`.
    """
    for i in range(count):
        rx, ry, depth = v[RAY + i], v[RAY + NEXT + i], v[DEPTH + i]
        v[POINT + i] = rx * depth
        v[POINT + NEXT + i] = ry * depth
        v[POINT + LAST + i] = depth
        scale = _ONE / np.sqrt(rx * rx + ry * ry + _ONE + _TINY)
        v[VIEW + i] = -rx * scale
        v[VIEW + NEXT + i] = -ry * scale
        v[VIEW + LAST + i] = -scale
    for i in range(count):
        px = v[POINT + i] - v[FRAME + 3 * PIXELS + i]
        py = v[POINT + NEXT + i] - v[FRAME + 7 * PIXELS + i]
        pz = v[POINT + LAST + i] - v[FRAME + 11 * PIXELS + i]
        for axis in range(3):
            v[LOCAL + PIXELS * axis + i] = (
                v[FRAME + PIXELS * axis + i] * px
                + v[FRAME + PIXELS * (4 + axis) + i] * py
                + v[FRAME + PIXELS * (8 + axis) + i] * pz
            )
    for i in range(count):
        ax, ay, az = v[CORNER + i], v[CORNER + NEXT + i], v[CORNER + LAST + i]
        ux, uy, uz = (
            v[SECOND + i] - ax,
            v[SECOND + NEXT + i] - ay,
            v[SECOND + LAST + i] - az,
        )
        wx, wy, wz = (
            v[THIRD + i] - ax,
            v[THIRD + NEXT + i] - ay,
            v[THIRD + LAST + i] - az,
        )
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        v[PLANE + i], v[PLANE + NEXT + i], v[PLANE + LAST + i] = nx, ny, nz
        # The shares of the triangle's corners in the point.
        px = v[LOCAL + i] - ax
        py = v[LOCAL + NEXT + i] - ay
        pz = v[LOCAL + LAST + i] - az
        square = max(nx * nx + ny * ny + nz * nz, _TINY)
        second = (
            (py * wz - pz * wy) * nx
            + (pz * wx - px * wz) * ny
            + (px * wy - py * wx) * nz
        ) / square
        third = (
            (uy * pz - uz * py) * nx
            + (uz * px - ux * pz) * ny
            + (ux * py - uy * px) * nz
        ) / square
        second = min(max(second, _ZERO), _ONE)
        third = min(max(third, _ZERO), _ONE - second)
        rest = _ONE - second - third
        at = NORMALS + i
        nx = rest * v[at] + second * v[at + 3 * PIXELS] + third * v[at + 6 * PIXELS]
        at += PIXELS
        ny = rest * v[at] + second * v[at + 3 * PIXELS] + third * v[at + 6 * PIXELS]
        at += PIXELS
        nz = rest * v[at] + second * v[at + 3 * PIXELS] + third * v[at + 6 * PIXELS]
        at = FRAME + i
        x = v[at] * nx + v[at + PIXELS] * ny + v[at + 2 * PIXELS] * nz
        at += 4 * PIXELS
        y = v[at] * nx + v[at + PIXELS] * ny + v[at + 2 * PIXELS] * nz
        at += 4 * PIXELS
        z = v[at] * nx + v[at + PIXELS] * ny + v[at + 2 * PIXELS] * nz
        scale = _ONE / np.sqrt(x * x + y * y + z * z + _TINY)
        v[NORMAL + i] = x * scale
        v[NORMAL + NEXT + i] = y * scale
        v[NORMAL + LAST + i] = z * scale


@inner
def light(count: int, lights: Any, v: Any) -> None:
    """Add the light that pixels' points reflect to `COLOUR`, without textures.

    Args:
        count: How many, from the first on.
        lights: The lights' numbers and, in the camera's frame, their directions and
            positions: (lights, LIGHT_SIZE + 6).
        v: Values of `pixels.Pixels`, after `locate`.
    """
    dark = True
    for number in range(lights.shape[0]):
        if lights[number, LIGHT_ON] != _ZERO:
            dark = False
            if lights[number, LIGHT_PLACED] != _ZERO:
                _from_a_place(count, lights, number, v)
            else:
                for i in range(count):
                    v[STRENGTH + i] = _ONE
                    for axis in range(3):
                        direction = lights[number, LIGHT_SIZE + axis]
                        v[LIGHT + PIXELS * axis + i] = -direction
            _reflected(count, lights, number, v)
    for c in range(3):
        for i in range(count):
            colour = v[COLOUR + PIXELS * c + i]
            if dark:  # MuJoCo's light where there is none
                colour += np.float32(0.3) * v[OWN_COLOUR + PIXELS * c + i]
            v[COLOUR + PIXELS * c + i] = min(max(colour, _ZERO), _ONE)


@inner
def _from_a_place(count: int, lights: Any, number: int, v: Any) -> None:
    """Write direction and strength of a light that has a place."""
    at = LIGHT_SIZE
    dx, dy, dz = lights[number, at], lights[number, at + 1], lights[number, at + 2]
    x, y, z = lights[number, at + 3], lights[number, at + 4], lights[number, at + 5]
    cutoff, exponent = lights[number, CUTOFF], lights[number, EXPONENT]
    constant = lights[number, ATTENUATION]
    linear = lights[number, ATTENUATION + 1]
    quadratic = lights[number, ATTENUATION + 2]
    narrow = cutoff > np.float32(-1.5)
    for i in range(count):
        lx = x - v[POINT + i]
        ly = y - v[POINT + NEXT + i]
        lz = z - v[POINT + LAST + i]
        square = lx * lx + ly * ly + lz * lz
        scale = _ONE / np.sqrt(square + _TINY)
        lx, ly, lz = lx * scale, ly * scale, lz * scale
        v[LIGHT + i], v[LIGHT + NEXT + i], v[LIGHT + LAST + i] = lx, ly, lz
        facing = -(lx * dx + ly * dy + lz * dz)
        v[FACING + i] = facing
        v[BASE + i] = max(facing, _ZERO)
        v[COUNT + i] = exponent
        weaker = constant + linear * np.sqrt(square) + quadratic * square
        v[STRENGTH + i] = max(weaker, np.float32(1e-6))
    if narrow:
        _power(count, v)
    for i in range(count):
        strength = v[POWER + i] if narrow else _ONE
        strength = _ZERO if v[FACING + i] < cutoff else strength
        v[STRENGTH + i] = strength / v[STRENGTH + i]


@inner
def _reflected(count: int, lights: Any, number: int, v: Any) -> None:
    """Add what the first pixels' points reflect of one light."""
    for i in range(count):
        lx, ly, lz = v[LIGHT + i], v[LIGHT + NEXT + i], v[LIGHT + LAST + i]
        nx, ny, nz = v[NORMAL + i], v[NORMAL + NEXT + i], v[NORMAL + LAST + i]
        v[FACING + i] = lx * nx + ly * ny + lz * nz
        hx = lx + v[VIEW + i]
        hy = ly + v[VIEW + NEXT + i]
        hz = lz + v[VIEW + LAST + i]
        scale = _ONE / np.sqrt(hx * hx + hy * hy + hz * hz + _TINY)
        hx, hy, hz = hx * scale, hy * scale, hz * scale
        v[BASE + i] = max(hx * nx + hy * ny + hz * nz, _ZERO)
        v[COUNT + i] = v[SHARES + PIXELS + i]
    _power(count, v)
    for c in range(3):
        ambient, diffuse = lights[number, AMBIENT + c], lights[number, DIFFUSE + c]
        specular = lights[number, SPECULAR + c]
        for i in range(count):
            facing = v[FACING + i]
            shine = v[POWER + i] * v[SHARES + i] if facing > _ZERO else _ZERO
            v[COLOUR + PIXELS * c + i] += v[STRENGTH + i] * (
                v[OWN_COLOUR + PIXELS * c + i]
                * (ambient + max(facing, _ZERO) * diffuse)
                + shine * specular
            )


@inner
def _power(count: int, v: Any) -> None:
    """Write the powers `COUNT` of numbers `BASE` in [0, 1] to `POWER`.

    Without a mathematical library: they differ in the last bit. Between whole exponents
    a power is linear. `BASE` and `COUNT` are used up.
    """
    most = _ZERO
    for i in range(count):
        exponent = min(v[COUNT + i], _MOST)
        whole = np.trunc(exponent)
        v[COUNT + i] = whole
        v[POWER + i] = _ONE + (exponent - whole) * (v[BASE + i] - _ONE)
        most = max(most, whole)
    while most > _ZERO:
        for i in range(count):
            factor, left = v[BASE + i], v[COUNT + i]
            half = np.trunc(_HALF * left)
            odd = left - half - half > _ZERO
            v[POWER + i] *= factor if odd else _ONE
            v[BASE + i] = factor * factor
            v[COUNT + i] = half
        most = np.trunc(_HALF * most)
