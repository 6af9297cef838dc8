"""The colours of a frame's pixels: only what is visible is shaded, once."""

from __future__ import annotations

from typing import Any

import numpy as np

from rlco.physics.mj.compiling import inner
from rlco.physics.rendering.raster.filling import GEOM, TRIANGLE
from rlco.physics.rendering.raster.lighting import light, locate
from rlco.physics.rendering.raster.pixels import (
    COLOUR,
    DEPTH,
    GEOM_OF,
    PIXELS,
    TRIANGLE_OF,
    X,
    Y,
    load,
)
from rlco.physics.rendering.raster.scene import SKY
from rlco.physics.rendering.raster.texturing import sky, texture

_HALF, _ONE = np.float32(0.5), np.float32(1.0)
_NONE: Any = np.int64(0)  # of a literal, numba compiles all that gets it once more


@inner
def shade(
    scene: Any,
    geoms_at: int,
    layer: int,
    box: Any,
    share: Any,
    with_sky: bool,
    image: Any,
    s: Any,
) -> None:
    """Colour the pixels of a box that show a triangle.

    Args:
        scene: `scene.Scene`.
        geoms_at: Where the geoms begin in a row.
        layer: 0 for the frame, 1 for a transparent geom.
        box: First and last row, first and last column, (4,).
        share: Of the colour, over what the image shows.
        with_sky: Colour the pixels that show none, too.
        image: uint8 (3, height, width), written.
        s: `frames.Scratch`.
    """
    lens, p, shown, depth = s.lens, s.pixels, s.shown[layer], s.depth[layer]
    count = _NONE
    for y in range(box[0], box[1] + 1):
        for x in range(box[2], box[3] + 1):
            k = shown[TRIANGLE, y, x]
            if k < 0:
                if with_sky:
                    colour = sky(scene.textures, scene.numbers[SKY], x, y, lens)
                    for c in range(3):
                        _write(image, c, y, x, colour[c], share)
                continue
            p.places[Y + count], p.places[X + count] = y, x
            p.places[TRIANGLE_OF + count] = k
            p.places[GEOM_OF + count] = shown[GEOM, y, x]
            p.values[DEPTH + count] = _ONE / depth[y, x]
            count += 1
            if count == PIXELS:
                _shade_some(scene, geoms_at, count, share, image, s)
                count = _NONE
    if count:
        _shade_some(scene, geoms_at, count, share, image, s)


@inner
def _shade_some(
    scene: Any, geoms_at: int, count: int, share: Any, image: Any, s: Any
) -> None:
    """Colour the first of the pixels in the working space."""
    p = s.pixels
    load(count, scene, s.placed, s.matrix, s.row, geoms_at, s.lens, p)
    locate(count, p.values)
    light(count, s.lights, p.values)
    texture(scene.textures, count, s.lens, p)
    for c in range(3):
        for i in range(count):
            value = p.values[COLOUR + PIXELS * c + i]
            _write(image, c, p.places[Y + i], p.places[X + i], value, share)


@inner
def _write(image: Any, c: int, y: int, x: int, value: Any, share: Any) -> None:
    """Write a colour's share over what the image shows."""
    if share < _ONE:
        behind = np.float32(image[c, y, x]) / np.float32(255.0)
        value = behind + share * (value - behind)
    image[c, y, x] = np.uint8(np.float32(255.0) * value + _HALF)
