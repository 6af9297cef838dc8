"""The colour of a pixel: MuJoCo's lights and materials, evaluated where it looks.

OpenGL's fixed lighting (ambient, diffuse and Blinn's specular light of each source),
per pixel rather than per corner of a triangle. A texture multiplies the lit colour, as
in MuJoCo. There are no shadows and no reflections.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rlco.physics.mj.compiling import inner
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


@inner
def _unit(vector: Any) -> None:
    """Scale a vector (3,) to length 1."""
    square = vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]
    scale = _ONE / np.sqrt(square + _TINY)
    for axis in range(3):
        vector[axis] *= scale


@inner
def _dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inner
def shade(
    row: Any,
    lights: Any,
    triangle: Any,
    normals: Any,
    half: Any,
    unwrapped: bool,
    textures: Any,
    matrix: Any,
    lens: Any,
    depth: Any,
    v: Any,
) -> None:
    """Write the colour of one pixel to `v[COLOUR]`, shares of 1.

    Args:
        row: The geom's numbers, see `raster_state`.
        lights: The lights' numbers and, in the camera's frame, their directions and
            positions: (lights, LIGHT_SIZE + 6).
        triangle: Corners of the triangle in the geom's frame, (3, 3) [m].
        normals: Their normals, (9,).
        half: Half sizes that textures are stretched to, (3,) [m].
        unwrapped: Whether the geom has texture coordinates of its own.
        textures: `raster_textures.Textures`.
        matrix: From the geom's frame to the camera's, (12,).
        lens: Focal lengths and centre [pixels], (4,).
        depth: How far it is along the camera's axis [m].
        v: Working space, whose `v[RAY]` is the pixel's ray, of depth 1.
    """
    point, view, local = v[_POINT], v[_VIEW], v[_LOCAL]
    normal, colour, plane = v[_NORMAL], v[COLOUR], v[_PLANE]
    for axis in range(3):
        point[axis] = v[RAY, axis] * depth
        view[axis] = -v[RAY, axis]
    _unit(view)
    for axis in range(3):
        local[axis] = (
            matrix[axis] * (point[0] - matrix[3])
            + matrix[4 + axis] * (point[1] - matrix[7])
            + matrix[8 + axis] * (point[2] - matrix[11])
        )
    # The shares of the triangle's corners there.
    ax, ay, az = triangle[0, 0], triangle[0, 1], triangle[0, 2]
    ux, uy, uz = triangle[1, 0] - ax, triangle[1, 1] - ay, triangle[1, 2] - az
    wx, wy, wz = triangle[2, 0] - ax, triangle[2, 1] - ay, triangle[2, 2] - az
    plane[0] = uy * wz - uz * wy
    plane[1] = uz * wx - ux * wz
    plane[2] = ux * wy - uy * wx
    px, py, pz = local[0] - ax, local[1] - ay, local[2] - az
    square = max(_dot(plane, plane), _TINY)
    second = (
        (py * wz - pz * wy) * plane[0]
        + (pz * wx - px * wz) * plane[1]
        + (px * wy - py * wx) * plane[2]
    ) / square
    third = (
        (uy * pz - uz * py) * plane[0]
        + (uz * px - ux * pz) * plane[1]
        + (ux * py - uy * px) * plane[2]
    ) / square
    second = min(max(second, _ZERO), _ONE)
    third = min(max(third, _ZERO), _ONE - second)
    first = _ONE - second - third
    nx = first * normals[0] + second * normals[3] + third * normals[6]
    ny = first * normals[1] + second * normals[4] + third * normals[7]
    nz = first * normals[2] + second * normals[5] + third * normals[8]
    for axis in range(3):
        normal[axis] = (
            matrix[4 * axis] * nx
            + matrix[4 * axis + 1] * ny
            + matrix[4 * axis + 2] * nz
        )
    _unit(normal)
    _lit(row, lights, v)
    texture: Any = np.int64(row[TEXTURE])
    if texture < 0:
        return
    texel = v[_TEXEL]
    if unwrapped:
        for c in range(3):
            texel[c] = textures.means[texture, c]
    else:
        height = plane[0] * ax + plane[1] * ay + plane[2] * az
        _textured(row, textures, texture, half, height, matrix, lens, v)
    for c in range(3):
        colour[c] *= texel[c]


@inner
def _lit(row: Any, lights: Any, v: Any) -> None:
    """Write the colour of a point under all lights, without a texture."""
    point, view, normal = v[_POINT], v[_VIEW], v[_NORMAL]
    colour, work = v[COLOUR], v[_LIGHT]
    shine = np.float32(128.0) * np.float32(row[MATERIAL + 2])
    dark = True
    for c in range(3):
        colour[c] = np.float32(row[MATERIAL] * row[RGBA + c])
    for number in range(lights.shape[0]):
        light = lights[number]
        if light[LIGHT_ON] == _ZERO:
            continue
        dark = False
        toward, place = light[LIGHT_SIZE : LIGHT_SIZE + 3], light[LIGHT_SIZE + 3 :]
        strength = _ONE
        for axis in range(3):
            work[axis] = -toward[axis]
        if light[LIGHT_PLACED] != _ZERO:
            for axis in range(3):
                work[axis] = place[axis] - point[axis]
            square = _dot(work, work)
            _unit(work)
            facing = -_dot(work, toward)
            if facing < light[CUTOFF]:
                continue
            if light[CUTOFF] > np.float32(-1.5):
                strength = _power(max(facing, _ZERO), light[EXPONENT])
            strength /= max(
                light[ATTENUATION]
                + light[ATTENUATION + 1] * np.sqrt(square)
                + light[ATTENUATION + 2] * square,
                np.float32(1e-6),
            )
        diffuse, specular = _dot(work, normal), _ZERO
        if diffuse > _ZERO:
            for axis in range(3):
                work[axis] += view[axis]
            _unit(work)
            specular = _power(max(_dot(work, normal), _ZERO), shine)
            specular *= np.float32(row[MATERIAL + 1])
        diffuse = max(diffuse, _ZERO)
        for c in range(3):
            colour[c] += strength * (
                np.float32(row[RGBA + c])
                * (light[AMBIENT + c] + diffuse * light[DIFFUSE + c])
                + specular * light[SPECULAR + c]
            )
    for c in range(3):
        if dark:  # MuJoCo's light where there is none
            colour[c] += np.float32(0.3) * np.float32(row[RGBA + c])
        colour[c] = min(max(colour[c], _ZERO), _ONE)


@inner
def _textured(
    row: Any,
    textures: Any,
    texture: int,
    half: Any,
    height: Any,
    matrix: Any,
    lens: Any,
    v: Any,
) -> None:
    """Write the colour of a geom's texture at a pixel to `v[_TEXEL]`.

    `height` is where the triangle's plane is along its normal, as `v[_PLANE]` has it.
    """
    plane, eye, near, local = v[_PLANE], v[_EYE], v[_NEAR], v[_LOCAL]
    table = textures.table[texture]
    flat = table[0] == FLAT
    for axis in range(3):  # the camera's position in the geom's frame
        eye[axis] = -(
            matrix[axis] * matrix[3]
            + matrix[4 + axis] * matrix[7]
            + matrix[8 + axis] * matrix[11]
        )
    face, u0, v0 = 0, _ZERO, _ZERO
    long_u, long_v, longer, shorter = _ZERO, _ZERO, _ZERO, _ZERO
    distance = height - _dot(plane, eye)
    # The pixel itself, then where the rays of its neighbours meet the same plane.
    for step in range(3):
        if step == 0:
            x, y, z = local[0], local[1], local[2]
        else:
            across = v[RAY, 0] + (_ONE / lens[0] if step == 1 else _ZERO)
            down = v[RAY, 1] + (_ONE / lens[1] if step == 2 else _ZERO)
            for axis in range(3):
                near[axis] = (
                    matrix[axis] * across + matrix[4 + axis] * down + matrix[8 + axis]
                )
            slope = _dot(plane, near)
            if abs(slope) < _TINY:
                continue
            scale = distance / slope
            x = eye[0] + near[0] * scale
            y = eye[1] + near[1] * scale
            z = eye[2] + near[2] * scale
        if row[UNIFORM] == 0.0:
            x, y, z = x / half[0], y / half[1], z / half[2]
        if flat:
            u1 = _HALF * np.float32(row[REPEAT]) * x - _HALF
            v1 = -_HALF * np.float32(row[REPEAT + 1]) * y - _HALF
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
    total, texel = v[_SUM], v[_TEXEL]
    total[0], total[1], total[2] = _ZERO, _ZERO, _ZERO
    for i in range(count):
        part = (np.float32(i) + _HALF) / np.float32(count) - _HALF
        across, down = u0 + part * long_u, v0 + part * long_v
        sample(
            textures.texels, textures.levels, table, face, across, down, reach, texel
        )
        for c in range(3):
            total[c] += texel[c] / np.float32(count)
    for c in range(3):
        texel[c] = total[c]


@inner
def sky(textures: Any, texture: int, turn: Any, v: Any) -> None:
    """Write the sky's colour where a pixel looks to `v[COLOUR]`: black without one.

    Args:
        textures: `raster_textures.Textures`.
        texture: Which of them it is, or -1.
        turn: Rotation from the camera's frame (right, down, forward) to the world's,
            (9,).
        v: Working space, whose `v[RAY]` is the pixel's ray.
    """
    if texture < 0:
        v[COLOUR, 0] = v[COLOUR, 1] = v[COLOUR, 2] = _ZERO
        return
    at = v[_NEAR]
    for axis in range(3):
        at[axis] = _dot(turn[3 * axis : 3 * axis + 3], v[RAY])
    # The sky's cube is turned by a quarter about x.
    x, y, z = at[0], at[2], -at[1]
    face = cube_face(x, y, z)
    u, w = on_cube(face, x, y, z)
    table = textures.table[texture]
    sample(textures.texels, textures.levels, table, face, u, w, _ZERO, v[COLOUR])
