"""A few pixels side by side: what is known of each before it is shaded.

Shading is the same arithmetic for every pixel, so `PIXELS` of them, of any geoms, are
shaded at once: a compiler makes one instruction for several pixels of loops over them,
which has to see that rows of the working space cannot overlap. Hence one flat array,
and rows at constant places.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rlco.physics.mj.compiling import inner
from rlco.physics.rendering.raster.places import LEVEL
from rlco.physics.rendering.raster.scene import HALF, UNWRAPPED
from rlco.physics.rendering.raster.state import (
    GEOM_SIZE,
    MATERIAL,
    REPEAT,
    RGBA,
    TEXTURE,
    UNIFORM,
)

PIXELS = 32
NEXT, LAST = PIXELS, 2 * PIXELS  # from x to y and z of the same pixel
_ONE, _HALF = np.float32(1.0), np.float32(0.5)


class Pixels(NamedTuple):
    """Working space of the pixels that are shaded together."""

    # Row r of pixel i is at PIXELS * r + i, rows as below.
    values: NDArray[np.float32]
    # The same, rows Y to AVERAGED.
    places: NDArray[np.int64]


# Rows of `Pixels.places`: where in the frame, what it shows there, the texture or -1,
# and whether the average colour of it counts.
Y, X, TRIANGLE_OF, GEOM_OF, TEXTURE_OF, AVERAGED = (PIXELS * row for row in range(6))
_PLACE_ROWS = 6


def _rows(*sizes: int) -> list[int]:
    """Return where groups of rows begin, and the size of all."""
    return [PIXELS * int(start) for start in np.cumsum([0, *sizes])]


# Rows of `Pixels.values`, by groups: what is known before ...
(
    RAY,  # x and y of the ray, whose z is 1
    DEPTH,  # along the camera's axis [m]
    FRAME,  # from the geom's frame to the camera's
    CORNER,  # first corner of the triangle, in the geom's frame [m]
    SECOND,  # second corner
    THIRD,  # third corner
    NORMALS,  # of the three corners, in the geom's frame
    OWN_COLOUR,  # the geom's
    SHARES,  # of specular light, and its exponent
    SCALE,  # half sizes that a texture is stretched over, or 1
    TIMES,  # how often a texture repeats
    # ... and what is computed from it.
    COLOUR,
    POINT,  # in the camera's frame [m]
    VIEW,  # towards the camera, of length 1
    LOCAL,  # the point in the geom's frame [m]
    PLANE,  # normal of the triangle, in the geom's frame, of any length
    NORMAL,  # in the camera's frame, of length 1
    LIGHT,  # towards a light, of length 1
    FACING,  # how far a light's axis and the point, or its ray and the surface, face
    # each other, a cosine
    STRENGTH,  # of a light
    BASE,  # of a power
    COUNT,  # its exponent
    POWER,
    ON_TEXTURE,  # a point of the plane for the pixel, and those to its right and below
    SLOPES,  # of the last two points' rays against the plane
    _SIZE,
) = _rows(2, 1, 12, 3, 3, 3, 9, 3, 2, 3, 2, 3, 3, 3, 3, 3, 3, 3, 1, 1, 1, 1, 1, 9, 2)


@inner
def make_pixels() -> Any:
    """Return a working space for `load`."""
    return Pixels(np.empty(_SIZE, np.float32), np.empty(PIXELS * _PLACE_ROWS, np.int64))


@inner
def load(
    count: int,
    scene: Any,
    placed: Any,
    matrix: Any,
    row: Any,
    at: int,
    lens: Any,
    p: Any,
) -> None:
    """Write what the first pixels show to the working space.

    Their places in the frame, triangles, geoms and depths are there already.

    Args:
        count: How many of the pixels.
        scene: `scene.Scene`.
        placed: Levels of detail of geoms, (G, 2), see `places.place`.
        matrix: From each geom's frame to the camera's, (G, 12).
        row: The world's numbers, see `state`.
        at: Where the geoms begin there.
        lens: Focal lengths and centre [pixels], (4,).
        p: `Pixels`, written.
    """
    v, places = p.values, p.places
    points, faces, normals = scene.points, scene.faces, scene.normals
    for i in range(count):
        k, g = places[TRIANGLE_OF + i], places[GEOM_OF + i]
        x, y = np.float32(places[X + i]), np.float32(places[Y + i])
        v[RAY + i] = (x + _HALF - lens[2]) / lens[0]
        v[RAY + PIXELS + i] = (y + _HALF - lens[3]) / lens[1]
        for entry in range(12):
            v[FRAME + PIXELS * entry + i] = matrix[g, entry]
        first = scene.levels[placed[g, LEVEL], 0]
        a, b, c = first + faces[k, 0], first + faces[k, 1], first + faces[k, 2]
        of = at + GEOM_SIZE * g
        places[TEXTURE_OF + i] = np.int64(row[of + TEXTURE])
        places[AVERAGED + i] = scene.geoms[g, UNWRAPPED]
        for axis in range(3):
            to = PIXELS * axis + i
            v[CORNER + to] = points[axis, a]
            v[SECOND + to] = points[axis, b]
            v[THIRD + to] = points[axis, c]
            v[OWN_COLOUR + to] = row[of + RGBA + axis]
            v[COLOUR + to] = row[of + MATERIAL] * row[of + RGBA + axis]
            stretched = row[of + UNIFORM] == 0.0
            v[SCALE + to] = scene.bounds[g, HALF + axis] if stretched else _ONE
        for entry in range(9):
            v[NORMALS + PIXELS * entry + i] = normals[k, entry]
        v[SHARES + i] = row[of + MATERIAL + 1]
        shine = np.float32(row[of + MATERIAL + 2])
        v[SHARES + PIXELS + i] = np.float32(128.0) * shine
        v[TIMES + i] = row[of + REPEAT]
        v[TIMES + PIXELS + i] = row[of + REPEAT + 1]
