"""The colour of a pixel: MuJoCo's lights and materials, evaluated where it looks.

OpenGL's fixed lighting (ambient, diffuse and Blinn's specular light of each source),
per pixel rather than per corner of a triangle. A texture multiplies the lit colour, as
in MuJoCo. There are no shadows and no reflections.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rlco.physics.mj.compiling import inner
from rlco.physics.rendering.raster_scene import HALF
from rlco.physics.rendering.raster_state import (
    AMBIENT,
    ATTENUATION,
    CUTOFF,
    DIFFUSE,
    EXPONENT,
    LIGHT_ON,
    LIGHT_PLACED,
    LIGHT_SIZE,
    MATERIAL,
    REPEAT,
    RGBA,
    SPECULAR,
    TEXTURE,
    UNIFORM,
)
from rlco.physics.rendering.raster_textures import FLAT, cube_face, on_cube, sample

_ZERO, _ONE, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
_TINY = np.float32(1e-20)
# Rows of a pixel's working space.
RAY, COLOUR = 0, 1
_POINT, _VIEW, _LOCAL, _NORMAL, _LIGHT, _PLANE, _EYE, _NEAR, _TEXEL, _SUM = range(2, 12)
WORK_ROWS = 12
_MOST = np.float32(8.0)  # places of a texture that one pixel averages


@inner
def _power(base: Any, exponent: Any) -> Any:
    """Return a power of a number in [0, 1] without a mathematical library.

    Libraries differ in the last bit. Between whole exponents it is linear.
    """
    count = np.int64(exponent)
    rest = exponent - np.float32(count)
    result, factor = _ONE + rest * (base - _ONE), base
    while count > 0:
        if count & 1:
            result *= factor
        factor *= factor
        count >>= 1
    return result


# A view of an array costs two atomic operations, and shading would need dozens of them
# per pixel: so rows of the working space are given by their numbers.


@inner
def _unit(v: Any, r: int) -> None:
    """Scale a row of the working space to length 1."""
    square = v[r, 0] * v[r, 0] + v[r, 1] * v[r, 1] + v[r, 2] * v[r, 2]
    scale = _ONE / np.sqrt(square + _TINY)
    for axis in range(3):
        v[r, axis] *= scale


@inner
def _dot(v: Any, a: int, b: int) -> Any:
    """Return the product of two rows of the working space."""
    return v[a, 0] * v[b, 0] + v[a, 1] * v[b, 1] + v[a, 2] * v[b, 2]


@inner
def shade(
    row: Any,
    at: int,
    lights: Any,
    points: Any,
    first: Any,
    faces: Any,
    normals: Any,
    k: int,
    bounds: Any,
    matrix: Any,
    g: int,
    unwrapped: bool,
    textures: Any,
    lens: Any,
    depth: Any,
    v: Any,
) -> None:
    """Write the colour of one pixel to `v[COLOUR]`, shares of 1.

    Args:
        row: The world's numbers, see `raster_state`.
        at: Where the geom's begin.
        lights: The lights' numbers and, in the camera's frame, their directions and
            positions: (lights, LIGHT_SIZE + 6).
        points: Vertices in the frames of their geoms, (3, V) [m].
        first: The first vertex of the geom's level of detail.
        faces: Corners of triangles, counted from there, (T, 3).
        normals: Of triangles' corners, (T, 9).
        k: The triangle.
        bounds: `raster_scene.Scene.bounds`.
        matrix: From each geom's frame to the camera's, (G, 12).
        g: The geom.
        unwrapped: Whether the geom has texture coordinates of its own.
        textures: `raster_textures.Textures`.
        lens: Focal lengths and centre [pixels], (4,).
        depth: How far it is along the camera's axis [m].
        v: Working space, whose `v[RAY]` is the pixel's ray, of depth 1.
    """
    for axis in range(3):
        v[_POINT, axis] = v[RAY, axis] * depth
        v[_VIEW, axis] = -v[RAY, axis]
    _unit(v, _VIEW)
    for axis in range(3):
        v[_LOCAL, axis] = (
            matrix[g, axis] * (v[_POINT, 0] - matrix[g, 3])
            + matrix[g, 4 + axis] * (v[_POINT, 1] - matrix[g, 7])
            + matrix[g, 8 + axis] * (v[_POINT, 2] - matrix[g, 11])
        )
    # The shares of the triangle's corners there.
    i, j, n = first + faces[k, 0], first + faces[k, 1], first + faces[k, 2]
    ax, ay, az = points[0, i], points[1, i], points[2, i]
    ux, uy, uz = points[0, j] - ax, points[1, j] - ay, points[2, j] - az
    wx, wy, wz = points[0, n] - ax, points[1, n] - ay, points[2, n] - az
    v[_PLANE, 0] = uy * wz - uz * wy
    v[_PLANE, 1] = uz * wx - ux * wz
    v[_PLANE, 2] = ux * wy - uy * wx
    px, py, pz = v[_LOCAL, 0] - ax, v[_LOCAL, 1] - ay, v[_LOCAL, 2] - az
    square = max(_dot(v, _PLANE, _PLANE), _TINY)
    second = (
        (py * wz - pz * wy) * v[_PLANE, 0]
        + (pz * wx - px * wz) * v[_PLANE, 1]
        + (px * wy - py * wx) * v[_PLANE, 2]
    ) / square
    third = (
        (uy * pz - uz * py) * v[_PLANE, 0]
        + (uz * px - ux * pz) * v[_PLANE, 1]
        + (ux * py - uy * px) * v[_PLANE, 2]
    ) / square
    second = min(max(second, _ZERO), _ONE)
    third = min(max(third, _ZERO), _ONE - second)
    rest = _ONE - second - third
    nx = rest * normals[k, 0] + second * normals[k, 3] + third * normals[k, 6]
    ny = rest * normals[k, 1] + second * normals[k, 4] + third * normals[k, 7]
    nz = rest * normals[k, 2] + second * normals[k, 5] + third * normals[k, 8]
    for axis in range(3):
        v[_NORMAL, axis] = (
            matrix[g, 4 * axis] * nx
            + matrix[g, 4 * axis + 1] * ny
            + matrix[g, 4 * axis + 2] * nz
        )
    _unit(v, _NORMAL)
    _lit(row, at, lights, v)
    texture: Any = np.int64(row[at + TEXTURE])
    if texture < 0:
        return
    if unwrapped:
        for c in range(3):
            v[_TEXEL, c] = textures.means[texture, c]
    else:
        height = v[_PLANE, 0] * ax + v[_PLANE, 1] * ay + v[_PLANE, 2] * az
        _textured(row, at, textures, texture, bounds, height, matrix, g, lens, v)
    for c in range(3):
        v[COLOUR, c] *= v[_TEXEL, c]


@inner
def _lit(row: Any, at: int, lights: Any, v: Any) -> None:
    """Write the colour of a point under all lights, without a texture."""
    shine = np.float32(128.0) * np.float32(row[at + MATERIAL + 2])
    dark = True
    for c in range(3):
        v[COLOUR, c] = np.float32(row[at + MATERIAL] * row[at + RGBA + c])
    for number in range(lights.shape[0]):
        if lights[number, LIGHT_ON] == _ZERO:
            continue
        dark = False
        strength = _ONE
        for axis in range(3):
            v[_LIGHT, axis] = -lights[number, LIGHT_SIZE + axis]
        if lights[number, LIGHT_PLACED] != _ZERO:
            for axis in range(3):
                place = lights[number, LIGHT_SIZE + 3 + axis]
                v[_LIGHT, axis] = place - v[_POINT, axis]
            square = _dot(v, _LIGHT, _LIGHT)
            _unit(v, _LIGHT)
            facing = -(
                v[_LIGHT, 0] * lights[number, LIGHT_SIZE]
                + v[_LIGHT, 1] * lights[number, LIGHT_SIZE + 1]
                + v[_LIGHT, 2] * lights[number, LIGHT_SIZE + 2]
            )
            if facing < lights[number, CUTOFF]:
                continue
            if lights[number, CUTOFF] > np.float32(-1.5):
                strength = _power(max(facing, _ZERO), lights[number, EXPONENT])
            strength /= max(
                lights[number, ATTENUATION]
                + lights[number, ATTENUATION + 1] * np.sqrt(square)
                + lights[number, ATTENUATION + 2] * square,
                np.float32(1e-6),
            )
        diffuse, specular = _dot(v, _LIGHT, _NORMAL), _ZERO
        if diffuse > _ZERO:
            for axis in range(3):
                v[_LIGHT, axis] += v[_VIEW, axis]
            _unit(v, _LIGHT)
            specular = _power(max(_dot(v, _LIGHT, _NORMAL), _ZERO), shine)
            specular *= np.float32(row[at + MATERIAL + 1])
        diffuse = max(diffuse, _ZERO)
        for c in range(3):
            v[COLOUR, c] += strength * (
                np.float32(row[at + RGBA + c])
                * (lights[number, AMBIENT + c] + diffuse * lights[number, DIFFUSE + c])
                + specular * lights[number, SPECULAR + c]
            )
    for c in range(3):
        if dark:  # MuJoCo's light where there is none
            v[COLOUR, c] += np.float32(0.3) * np.float32(row[at + RGBA + c])
        v[COLOUR, c] = min(max(v[COLOUR, c], _ZERO), _ONE)


@inner
def _textured(
    row: Any,
    at: int,
    textures: Any,
    texture: int,
    bounds: Any,
    height: Any,
    matrix: Any,
    g: int,
    lens: Any,
    v: Any,
) -> None:
    """Write the colour of a geom's texture at a pixel to `v[_TEXEL]`.

    `height` is where the triangle's plane is along its normal, as `v[_PLANE]` has it.
    """
    flat = textures.table[texture, 0] == FLAT
    for axis in range(3):  # the camera's position in the geom's frame
        v[_EYE, axis] = -(
            matrix[g, axis] * matrix[g, 3]
            + matrix[g, 4 + axis] * matrix[g, 7]
            + matrix[g, 8 + axis] * matrix[g, 11]
        )
    face, u0, v0 = 0, _ZERO, _ZERO
    long_u, long_v, longer, shorter = _ZERO, _ZERO, _ZERO, _ZERO
    distance = height - _dot(v, _PLANE, _EYE)
    # The pixel itself, then where the rays of its neighbours meet the same plane.
    for step in range(3):
        if step == 0:
            x, y, z = v[_LOCAL, 0], v[_LOCAL, 1], v[_LOCAL, 2]
        else:
            across = v[RAY, 0] + (_ONE / lens[0] if step == 1 else _ZERO)
            down = v[RAY, 1] + (_ONE / lens[1] if step == 2 else _ZERO)
            for axis in range(3):
                v[_NEAR, axis] = (
                    matrix[g, axis] * across
                    + matrix[g, 4 + axis] * down
                    + matrix[g, 8 + axis]
                )
            slope = _dot(v, _PLANE, _NEAR)
            if abs(slope) < _TINY:
                continue
            scale = distance / slope
            x = v[_EYE, 0] + v[_NEAR, 0] * scale
            y = v[_EYE, 1] + v[_NEAR, 1] * scale
            z = v[_EYE, 2] + v[_NEAR, 2] * scale
        if row[at + UNIFORM] == 0.0:
            x, y = x / bounds[g, HALF], y / bounds[g, HALF + 1]
            z = z / bounds[g, HALF + 2]
        if flat:
            u1 = _HALF * np.float32(row[at + REPEAT]) * x - _HALF
            v1 = -_HALF * np.float32(row[at + REPEAT + 1]) * y - _HALF
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
    v[_SUM, 0], v[_SUM, 1], v[_SUM, 2] = _ZERO, _ZERO, _ZERO
    for i in range(count):
        part = (np.float32(i) + _HALF) / np.float32(count) - _HALF
        across, down = u0 + part * long_u, v0 + part * long_v
        sample(textures, texture, face, across, down, reach, v, _TEXEL)
        for c in range(3):
            v[_SUM, c] += v[_TEXEL, c] / np.float32(count)
    for c in range(3):
        v[_TEXEL, c] = v[_SUM, c]


@inner
def sky(textures: Any, texture: int, lens: Any, v: Any) -> None:
    """Write the sky's colour where a pixel looks to `v[COLOUR]`: black without one.

    Args:
        textures: `raster_textures.Textures`.
        texture: Which of them it is, or -1.
        lens: See `raster_frames.Scratch`; from its fifth number on, the rotation from
            the camera's frame (right, down, forward) to the world's.
        v: Working space, whose `v[RAY]` is the pixel's ray.
    """
    if texture < 0:
        v[COLOUR, 0] = v[COLOUR, 1] = v[COLOUR, 2] = _ZERO
        return
    for axis in range(3):
        turn = 4 + 3 * axis
        v[_NEAR, axis] = (
            lens[turn] * v[RAY, 0]
            + lens[turn + 1] * v[RAY, 1]
            + lens[turn + 2] * v[RAY, 2]
        )
    # The sky's cube is turned by a quarter about x.
    x, y, z = v[_NEAR, 0], v[_NEAR, 2], -v[_NEAR, 1]
    face = cube_face(x, y, z)
    u, w = on_cube(face, x, y, z)
    sample(textures, texture, face, u, w, _ZERO, v, COLOUR)
