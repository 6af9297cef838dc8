"""Compiled: where the camera, the lights and the geoms of a row are in a frame."""

from __future__ import annotations

from typing import Any

import numpy as np

from rlco.physics.mj.compiling import inner
from rlco.physics.rendering.raster.scene import FIRST_LEVEL, NEXT_LEVEL, RADIUS
from rlco.physics.rendering.raster.state import (
    CAM_MAT,
    CAM_POS,
    FOCAL,
    GEOM_MAT,
    GEOM_POS,
    LIGHT_DIR,
    LIGHT_POS,
    LIGHT_SIZE,
    LIGHTS,
    RGBA,
)

_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
# Geoms that reach farther than this from the frame are cut to it [pixels].
GUARD = np.float32(4096.0)
LEVEL, CUT = 0, 1  # what `place` writes of a geom


@inner
def look(row: Any, lens: Any, lights: Any) -> None:
    """Turn the camera and the lights of a row into what drawing needs."""
    for i in range(4):
        lens[i] = row[FOCAL + i]
    for axis in range(3):  # MuJoCo's cameras have x right, y up, and look along -z
        for column in range(3):
            sign = 1.0 if column == 0 else -1.0
            lens[4 + 3 * axis + column] = sign * row[CAM_MAT + 3 * axis + column]
    for number in range(lights.shape[0]):
        at = LIGHTS + LIGHT_SIZE * number
        for i in range(LIGHT_SIZE):
            lights[number, i] = row[at + i]
        for axis in range(3):
            turned, place = 0.0, 0.0
            for k in range(3):
                column = row[CAM_MAT + 3 * k + axis]
                turned += column * row[at + LIGHT_DIR + k]
                place += column * (row[at + LIGHT_POS + k] - row[CAM_POS + k])
            sign = 1.0 if axis == 0 else -1.0
            lights[number, LIGHT_SIZE + axis] = sign * turned
            lights[number, LIGHT_SIZE + 3 + axis] = sign * place


@inner
def place(
    geom: Any,
    bounds: Any,
    errors: Any,
    row: Any,
    at: int,
    lens: Any,
    near: Any,
    detail: Any,
    height: int,
    width: int,
    matrix: Any,
    placed: Any,
    box: Any,
) -> Any:
    """Write how one geom is drawn; return its distance from the camera [m].

    Args:
        geom: Its row of `Scene.geoms`.
        bounds: Its row of `Scene.bounds`.
        errors: Detail that each level lacks [m].
        row: The world's numbers.
        at: Where the geom's begin.
        lens: See `frames.Scratch`.
        near: What is closer to the camera is not drawn [m].
        detail: What a level may lack [pixels].
        height: Of the frame.
        width: Of the frame.
        matrix: Written, from its frame to the camera's, (12,).
        placed: Written, (2,): its level of detail, -1 if it is out of view, and
            whether its triangles must be cut.
        box: Written: rows and columns that it may show in, (4,).
    """
    for axis in range(3):
        sign = 1.0 if axis == 0 else -1.0
        shift = 0.0
        for k in range(3):
            place = row[at + GEOM_POS + k] - row[CAM_POS + k]
            shift += row[CAM_MAT + 3 * k + axis] * place
        matrix[4 * axis + 3] = sign * shift
        for column in range(3):
            turned = 0.0
            for k in range(3):
                entry = row[at + GEOM_MAT + 3 * k + column]
                turned += row[CAM_MAT + 3 * k + axis] * entry
            matrix[4 * axis + column] = sign * turned
    radius = bounds[RADIUS]
    placed[LEVEL], placed[CUT] = -1, 0
    box[0], box[1], box[2], box[3] = 0, height - 1, 0, width - 1
    z = matrix[8] * bounds[0] + matrix[9] * bounds[1] + matrix[10] * bounds[2]
    z += matrix[11]
    square = z * z
    visible = z + radius > near and row[at + RGBA + 3] > 0.0
    close = max(z - _HALF * radius, near)
    placed[CUT] = z - radius <= near
    for axis in range(2):
        middle = (
            matrix[4 * axis] * bounds[0]
            + matrix[4 * axis + 1] * bounds[1]
            + matrix[4 * axis + 2] * bounds[2]
            + matrix[4 * axis + 3]
        )
        square += middle * middle
        size = np.float32(width if axis == 0 else height)
        # The sphere's distance from the two sides of the view.
        low, high = lens[2 + axis] / lens[axis], (size - lens[2 + axis]) / lens[axis]
        if middle + low * z < -radius * np.sqrt(_ONE + low * low):
            visible = False
        if middle - high * z > radius * np.sqrt(_ONE + high * high):
            visible = False
        if placed[CUT]:
            continue
        # The box around the sphere, as it is seen.
        nearest, far = z - radius, z + radius
        least, most = middle - radius, middle + radius
        least = (
            least / (nearest if least < _ZERO else far) * lens[axis] + lens[2 + axis]
        )
        most = most / (nearest if most > _ZERO else far) * lens[axis] + lens[2 + axis]
        if least < -GUARD or most > GUARD:
            placed[CUT] = 1
        first = 2 if axis == 0 else 0
        box[first] = np.int64(min(max(least, _ZERO), size))
        box[first + 1] = np.int64(min(max(most, -_ONE), size - _ONE))
    if visible:
        allowed = detail * close / lens[1]
        level = geom[FIRST_LEVEL]
        while level + 1 < geom[NEXT_LEVEL] and errors[level + 1] <= allowed:
            level += 1
        placed[LEVEL] = level
    return np.sqrt(square) - radius
