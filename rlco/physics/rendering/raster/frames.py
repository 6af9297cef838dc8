"""Compiled: whole frames of a range of worlds, without the GIL.

What cannot move before a camera that cannot move is drawn once. Each world compares
the numbers that this background depends on with those it was drawn from, all of them,
and draws it anew where one differs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rlco.physics.mj.compiling import borrowed, inner
from rlco.physics.mj.copying import copy_into, copy_matrix
from rlco.physics.rendering.raster.cutting import (
    Cutting,
    make_cutting,
    project_some,
)
from rlco.physics.rendering.raster.filling import GEOM, TRIANGLE
from rlco.physics.rendering.raster.pixels import Pixels, make_pixels
from rlco.physics.rendering.raster.places import CUT, LEVEL, look, place
from rlco.physics.rendering.raster.scene import ID, STILL, TWO_SIDED, VERTICES
from rlco.physics.rendering.raster.shading import shade
from rlco.physics.rendering.raster.state import (
    GEOM_SIZE,
    LIGHT_SIZE,
    LIGHTS,
    RGBA,
    read_row,
)
from rlco.physics.rendering.raster.triangles import draw_triangles, project

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
# MuJoCo draws what is less opaque than this after the rest, blended over it.
OPAQUE = 0.995
COMMON = 0  # the background that worlds share while they look alike
# Detail that may be lost in a frame, and in a background, which is drawn once [pixels].
DETAIL, FINE = np.float32(1.0), np.float32(0.5)
# Numpy's numbers: for each literal that it gets, numba compiles a function once more.
_FRAME: Any = np.int64(0)  # layers of depth and of what is shown
_GLASS: Any = np.int64(1)
_NO_SKY: Any = np.bool_(False)


class Backgrounds(NamedTuple):
    """What cannot move: one common background, then one of each of N worlds.

    Memory is committed only where it is written.
    """

    rows: NDArray[np.float64]  # the numbers that it was drawn from (N + 1, K)
    drawn: NDArray[np.bool_]  # (N + 1,)
    depth: NDArray[np.float32]  # inverse depth (N + 1, height, width) [1/m]
    geom: NDArray[np.int32]  # among the scene's geoms (N + 1, height, width)
    image: NDArray[np.uint8]  # (N + 1, 3, height, width)


class Scratch(NamedTuple):
    """Working space of one thread."""

    row: NDArray[np.float64]  # the world's numbers
    matrix: NDArray[np.float32]  # from each geom's frame to the camera's (G, 12)
    placed: NDArray[np.int64]  # level of detail or -1, whether it must be cut (G, 2)
    boxes: NDArray[np.int64]  # rows and columns that a geom may show in (G, 4)
    distance: NDArray[np.float32]  # from the camera (G,) [m]
    corners: NDArray[np.int32]  # of one geom, on the screen (2, V)
    inverse: NDArray[np.float32]  # their inverse depth (V,)
    cutting: Cutting  # what a geom that is cut needs besides
    depth: NDArray[np.float32]  # inverse depth of the frame, of one transparent geom
    shown: NDArray[np.int32]  # triangle and geom, of the same two (2, 2, h, w)
    lens: NDArray[np.float32]  # focal lengths, centre [pixels], world from camera (13,)
    lights: NDArray[np.float32]  # see `lighting.light`
    pixels: Pixels  # that are shaded together


@inner
def _scratch(
    numbers: Any, geoms: int, row: int, lights: int, height: int, width: int
) -> Any:
    return Scratch(
        np.empty(row),
        np.empty((geoms, 12), np.float32),
        np.empty((geoms, 2), np.int64),
        np.empty((geoms, 4), np.int64),
        np.empty(geoms, np.float32),
        np.empty((2, numbers[VERTICES]), np.int32),
        np.empty(numbers[VERTICES], np.float32),
        make_cutting(numbers[VERTICES]),
        np.empty((2, height, width), np.float32),
        np.empty((2, 2, height, width), np.int32),
        np.empty(13, np.float32),
        np.empty((lights, LIGHT_SIZE + 6), np.float32),
        make_pixels(),
    )


@inner
def _draw(scene: Any, g: int, layer: int, s: Any) -> None:
    """Draw one geom that is in view."""
    level, box = s.placed[g, LEVEL], s.boxes[g]
    start, end = scene.levels[level, 0], scene.levels[level, 1]
    first, last = scene.levels[level, 2], scene.levels[level, 3]
    two_sided = scene.geoms[g, TWO_SIDED] != 0
    points, depth, shown = scene.points[:, start:end], s.depth[layer], s.shown[layer]
    cut = s.placed[g, CUT] != 0
    if cut:
        height, width = depth.shape
        project_some(
            points,
            s.matrix[g],
            s.lens,
            scene.near,
            height,
            width,
            s.corners,
            s.inverse,
            s.cutting,
        )
    else:
        project(points, s.matrix[g], s.lens, scene.near, s.corners, s.inverse)
    draw_triangles(
        scene.faces,
        first,
        last,
        two_sided,
        g,
        s.corners,
        s.inverse,
        depth,
        shown,
        box,
        cut,
        s.lens,
        s.cutting,
    )


@inner
def _farthest(row: Any, geoms_at: int, placed: Any, distance: Any) -> int:
    """Return the farthest transparent geom that is in view; -1: there is none."""
    found = -1
    for g in range(placed.shape[0]):
        alpha = row[geoms_at + GEOM_SIZE * g + RGBA + 3]
        if placed[g, LEVEL] < 0 or alpha >= OPAQUE:
            continue
        if found < 0 or distance[g] > distance[found]:
            found = g
    return found


@inner
def _same(kept: Any, row: Any) -> bool:
    """Return whether a row begins with these very numbers."""
    for i in range(kept.shape[0]):  # noqa: SIM110 (numba knows no generators)
        if kept[i] != row[i]:
            return False
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def draw_range(
    first: int,
    last: int,
    which: Any,
    scene: Any,
    sizes: Any,
    sources: Any,
    backgrounds: Any,
    images: Any,
    geoms: Any,
    depths: Any,
) -> None:
    """Draw the frames of the worlds `which[first:last]`.

    Args:
        first: First place in `which`.
        last: One after the last.
        which: Indices of worlds; -1 draws the common background as world 0 has it.
        scene: `scene.Scene`.
        sizes: See `state.row_sizes`.
        sources: `state.Sources`.
        backgrounds: `Backgrounds`, empty for a camera that moves.
        images: uint8 (N, 3, height, width); only those of `which` are written.
        geoms: The geoms that pixels show, -1: none, (N, height, width), or (0, 0, 0).
        depths: Their depths, 0: none, of the same shape [m].
    """
    lights = (sizes[0] - LIGHTS) // LIGHT_SIZE
    size = images.shape[2], images.shape[3]
    s = _scratch(scene.numbers, len(scene.geoms), sizes[2], lights, *size)
    _draw_worlds(
        first,
        last,
        which,
        borrowed(scene),
        sizes,
        sources,
        borrowed(backgrounds),
        borrowed(images),
        borrowed(geoms),
        borrowed(depths),
        s,
    )


@inner
def _draw_worlds(
    first: int,
    last: int,
    which: Any,
    scene: Any,
    sizes: Any,
    sources: Any,
    backgrounds: Any,
    images: Any,
    geoms: Any,
    depths: Any,
    owned: Any,
) -> None:
    """Draw worlds, see `draw_range`, in a working space that the caller owns."""
    s = borrowed(owned)
    height, width = images.shape[2], images.shape[3]
    geoms_at, still_end = sizes[0], sizes[1]
    count, still = len(scene.geoms), scene.numbers[STILL]
    whole = np.array([0, height - 1, 0, width - 1])
    kept = backgrounds.drawn.shape[0] > 0
    for number in range(first, last):
        e = max(which[number], 0)
        read_row(
            scene.geoms,
            scene.numbers,
            sources.models[e],
            sources.states[e],
            sources.offsets,
            height,
            width,
            s.row,
        )
        look(s.row, s.lens, s.lights)
        slot = COMMON
        if kept and which[number] >= 0:
            drawn, rows = backgrounds.drawn, backgrounds.rows
            if not (drawn[COMMON] and _same(rows[COMMON], s.row)):
                slot = e + 1
        # First what cannot move, where it has not been drawn from the same numbers;
        # then what moves, and what is transparent.
        for moving in range(2):
            if moving == 0:
                known = not kept or (
                    backgrounds.drawn[slot] and _same(backgrounds.rows[slot], s.row)
                )
                if known and which[number] >= 0:
                    continue
                begin, end, detail = 0, still, FINE
                image = backgrounds.image[slot]
            elif which[number] < 0:
                continue
            else:
                begin, end, detail = still if kept else 0, count, DETAIL
                image = images[e]
            if moving and kept:
                copy_matrix(s.depth[0], backgrounds.depth[slot])
                copy_matrix(s.shown[0, GEOM], backgrounds.geom[slot])
                for c in range(3):
                    copy_matrix(image[c], backgrounds.image[slot, c])
            else:
                s.depth[0] = _ZERO
                s.shown[0, GEOM] = -1
            s.shown[0, TRIANGLE] = -1
            for g in range(count):
                at = geoms_at + GEOM_SIZE * g
                s.placed[g, LEVEL] = -1
                opaque = s.row[at + RGBA + 3] >= OPAQUE
                if (g < begin or g >= end) if opaque else not moving:
                    continue
                s.distance[g] = place(
                    scene.geoms[g],
                    scene.bounds[g],
                    scene.errors,
                    s.row,
                    at,
                    s.lens,
                    scene.near,
                    detail,
                    height,
                    width,
                    s.matrix[g],
                    s.placed[g],
                    s.boxes[g],
                )
                if opaque and s.placed[g, LEVEL] >= 0:
                    _draw(scene, g, _FRAME, s)
            with_sky = not (moving and kept)
            shade(scene, geoms_at, _FRAME, whole, _ONE, with_sky, image, s)
            if not moving:
                copy_matrix(backgrounds.depth[slot], s.depth[0])
                copy_matrix(backgrounds.geom[slot], s.shown[0, GEOM])
                copy_into(backgrounds.rows[slot], 0, s.row[:still_end])
                backgrounds.drawn[slot] = True
        # Transparent geoms are blended over the rest, the farthest first. They have no
        # depth, as in MuJoCo; of each the closest triangles show.
        while which[number] >= 0:
            g = _farthest(s.row, geoms_at, s.placed, s.distance)
            if g < 0:
                break
            top, left = s.boxes[g, 0], s.boxes[g, 2]
            below, beside = s.boxes[g, 1] + 1, s.boxes[g, 3] + 1
            for y in range(top, below):
                for x in range(left, beside):
                    s.depth[1, y, x] = s.depth[0, y, x]
                    s.shown[1, TRIANGLE, y, x] = -1
            _draw(scene, g, _GLASS, s)
            # MuJoCo draws each twice, from the closest and back again.
            alpha = np.float32(s.row[geoms_at + GEOM_SIZE * g + RGBA + 3])
            share = _ONE - (_ONE - alpha) * (_ONE - alpha)
            shade(scene, geoms_at, _GLASS, s.boxes[g], share, _NO_SKY, images[e], s)
            for y in range(top, below):
                for x in range(left, beside):
                    if s.shown[1, TRIANGLE, y, x] >= 0:
                        s.shown[0, GEOM, y, x] = g
            s.placed[g, LEVEL] = -1
        if geoms.shape[0] and which[number] >= 0:
            for y in range(height):
                for x in range(width):
                    g, over = s.shown[0, GEOM, y, x], s.depth[0, y, x]
                    geoms[e, y, x] = scene.geoms[g, ID] if g >= 0 else -1
                    depths[e, y, x] = _ONE / over if over > _ZERO else _ZERO
