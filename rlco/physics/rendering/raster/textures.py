"""A model's textures, each with smaller copies of itself, and how to look one up."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.physics.mj.compiling import inner
from rlco.physics.rendering.raster.same_arrays import SameArrays

# Larger textures are halved until they fit: no picture shows more of them [texels].
LARGEST = 512
FLAT, CUBE, SKY = (
    int(kind)
    for kind in (
        mujoco.mjtTexture.mjTEXTURE_2D,
        mujoco.mjtTexture.mjTEXTURE_CUBE,
        mujoco.mjtTexture.mjTEXTURE_SKYBOX,
    )
)
_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)

# Linear shares of light of sRGB's bytes (IEC 61966-2-1), as bytes: OpenGL decodes them.
_BYTES = np.arange(256) / 255.0
_SHARES = np.where(_BYTES <= 0.04045, _BYTES / 12.92, ((_BYTES + 0.055) / 1.055) ** 2.4)
_LINEAR = np.floor(255.0 * _SHARES + 0.5).astype(np.uint8)


class Textures(NamedTuple):
    """All textures of a model, n of them, in one array of bytes."""

    texels: NDArray[np.uint8]  # RGB of every level, one after the other
    levels: NDArray[np.int64]  # start in `texels`, height and width of a face (L, 3)
    table: NDArray[np.int64]  # kind, number of faces, first and next one's level (n, 4)
    means: NDArray[np.float32]  # average colours, shares of 1 (n, 3)


def read_textures(model: mujoco.MjModel) -> Textures:
    """Return a model's textures."""
    texels: list[NDArray[np.uint8]] = [np.zeros(3, dtype=np.uint8)]
    levels: list[tuple[int, ...]] = []
    table, means, at = [], [], 3
    for index in range(model.ntex):
        found, mean = _levels_and_mean(SameArrays(_images(model, index)))
        first = len(levels)
        for level in found:
            levels.append((at, *level.shape[1:3]))
            texels.append(level.ravel())
            at += level.size
        table.append((model.tex_type[index], len(found[0]), first, len(levels)))
        means.append(mean)
    return Textures(
        texels=np.concatenate(texels),
        levels=np.array(levels, dtype=np.int64).reshape(-1, 3),
        table=np.array(table, dtype=np.int64).reshape(-1, 4),
        means=np.array(means, dtype=np.float32).reshape(-1, 3),
    )


def _images(model: mujoco.MjModel, index: int) -> NDArray[np.uint8]:
    """Return one texture's images, (faces, height, width, 3)."""
    height, width = int(model.tex_height[index]), int(model.tex_width[index])
    channels = int(model.tex_nchannel[index])
    start = int(model.tex_adr[index])
    data = model.tex_data[start : start + height * width * channels]
    image = data.reshape(height, width, channels)
    image = np.repeat(image, 3, axis=2) if channels < 3 else image[..., :3]
    if model.tex_colorspace[index] == mujoco.mjtColorSpace.mjCOLORSPACE_SRGB:
        image = _LINEAR[image]
    faces = 1
    if model.tex_type[index] != FLAT:
        faces = height // width  # one image may stand for all six sides
    return np.ascontiguousarray(image.reshape(faces, height // faces, width, 3))


@functools.lru_cache(maxsize=32)
def _levels_and_mean(image: SameArrays) -> tuple[list[NDArray[np.uint8]], Any]:
    """Return images in sizes that halve, and their average colour, shares of 1 (3,)."""
    levels = _levels(image.arrays[0])
    return levels, levels[0].reshape(-1, 3).mean(axis=0) / 255.0


def _levels(images: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """Return images in sizes that halve down to one texel, from the largest kept."""
    levels, exact = [], images.astype(np.float32)
    while True:
        if max(exact.shape[1:3]) <= LARGEST:
            levels.append(np.floor(exact + 0.5).astype(np.uint8))
        if max(exact.shape[1:3]) == 1:
            return levels
        exact = _halved(_halved(exact, 1), 2)


def _halved(images: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Return images of half the size along an axis, each texel an average."""
    parts = np.moveaxis(images, axis, 0)
    size, half = len(parts), len(parts) // 2
    if size == 1:
        return images
    shape = (half, *([1] * (images.ndim - 1)))
    place = np.arange(half, dtype=np.float32).reshape(shape)
    out: Any
    if size % 2:  # each covers two texels, and parts of one more
        first, last = parts[0:-1:2] * (half - place), parts[2::2] * (place + 1)
        out = (first + parts[1::2] * half + last) / np.float32(size)
    else:
        out = (parts[0::2] + parts[1::2]) / np.float32(2.0)
    return np.moveaxis(out.astype(np.float32), 0, axis)


@inner
def sample(
    textures: Any,
    texture: int,
    face: int,
    u: Any,
    v: Any,
    reach: Any,
) -> Any:
    """Return a texture's red, green and blue at a place, shares of 1.

    Averaged over what a pixel covers.

    Args:
        textures: `Textures`.
        texture: Which of them.
        face: Which of a cube's faces.
        u: Place across the image, one image wide.
        v: The same downwards.
        reach: What a pixel covers, as a share of the image.
    """
    texels, levels, table = textures.texels, textures.levels, textures.table
    level, last = table[texture, 2], table[texture, 3] - 1
    wraps = table[texture, 0] == FLAT
    if table[texture, 1] == 1:
        face = 0
    covered = reach * np.float32(max(levels[level, 1], levels[level, 2]))
    while covered >= np.float32(2.0) and level < last:
        covered *= _HALF
        level += 1
    # Between two levels, the shares of both.
    blend = min(max(covered - _ONE, np.float32(0.0)), _ONE) if level < last else _ZERO
    if not abs(u) + abs(v) < np.float32(1e6):  # of a triangle without an area
        u, v = _HALF, _HALF
    red, green, blue = _ZERO, _ZERO, _ZERO
    for finer in range(2):
        part = blend if finer else _ONE - blend
        if part <= _ZERO:
            continue
        start = levels[level + finer, 0]
        height, width = levels[level + finer, 1], levels[level + finer, 2]
        x, y = u * np.float32(width) - _HALF, v * np.float32(height) - _HALF
        left: Any = np.int64(np.floor(x))
        top: Any = np.int64(np.floor(y))
        across, down = x - np.float32(left), y - np.float32(top)
        right, below = left + 1, top + 1
        if wraps:  # a division takes longer than comparisons
            if left < 0 or left >= width:
                left %= width
            if top < 0 or top >= height:
                top %= height
            right = left + 1 if left + 1 < width else 0
            below = top + 1 if top + 1 < height else 0
        else:
            left, right = min(max(left, 0), width - 1), min(max(right, 0), width - 1)
            top, below = min(max(top, 0), height - 1), min(max(below, 0), height - 1)
        for row in range(2):
            line = start + 3 * width * (face * height + (below if row else top))
            for column in range(2):
                share = part * (down if row else _ONE - down)
                share *= across if column else _ONE - across
                at = line + 3 * (right if column else left)
                red += share * np.float32(texels[at])
                green += share * np.float32(texels[at + 1])
                blue += share * np.float32(texels[at + 2])
    full = np.float32(255.0)
    return red / full, green / full, blue / full


@inner
def cube_face(x: Any, y: Any, z: Any) -> int:
    """Return the face of a cube that a direction meets: +x, -x, +y, -y, +z, -z."""
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        return 0 if x >= _ZERO else 1
    if ay >= az:
        return 2 if y >= _ZERO else 3
    return 4 if z >= _ZERO else 5


@inner
def on_cube(face: int, x: Any, y: Any, z: Any) -> Any:
    """Return where a direction meets a face of a cube, across and down, in [0, 1].

    OpenGL's convention of a cube map's sides.
    """
    if face == 0:
        u, v, major = -z, -y, x
    elif face == 1:
        u, v, major = z, -y, -x
    elif face == 2:
        u, v, major = x, z, y
    elif face == 3:
        u, v, major = x, -z, -y
    elif face == 4:
        u, v, major = x, -y, z
    else:
        u, v, major = -x, -y, -z
    major = max(major, np.float32(1e-9))
    return _HALF * (u / major + _ONE), _HALF * (v / major + _ONE)
