"""What a lens and a sensor make of a drawn frame: compiled, without the GIL.

One function for the frames of either renderer. A frame's noise depends on nothing but
its key, so that it is the same in any thread, in any batch and on any processor: the
noise is made of whole numbers, and all else of additions, multiplications and divisions
of single precision, which all processors round alike.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rlco.physics.mj.compiling import inner
from rlco.physics.spec.look import Look, View

# A display's values are about the 2.2th root of light (IEC 61966-2-1).
GAMMA = 2.2
REACH = 3  # pixels to each side that a blurred point spreads over, at most
# Places in a row: factors of red, green and blue; the lens's axis, right and down of
# the first pixel's edge [pixels]; light lost a squared pixel from it; deviation of
# noise, of 255; shares of a pixel and of its neighbours in a blurred one.
GAIN, AXIS, LOSS, NOISE, KERNEL = 0, 3, 5, 6, 7
ROW = KERNEL + REACH + 1
_ONE, _HALF, _FULL = np.float32(1.0), np.float32(0.5), np.float32(255.0)
_ZERO = np.float32(0.0)
# The sum of four 16-bit numbers has mean 2 (2^16 - 1) and variance (2^32 - 1) / 3: near
# enough to a normal distribution, and the same everywhere.
_MEAN = 2 * (2**16 - 1)
_SCALE = np.float32(np.sqrt(3.0 / (2.0**32 - 1.0)))


def exposure_row(look: Look, view: View, size: tuple[int, int]) -> NDArray[np.float32]:
    """Return the numbers by which a look changes the frames of a camera, (ROW,).

    Args:
        look: The look.
        view: The camera's part of it.
        size: Height and width of a frame [pixels].

    Example:
        >>> exposure_row(Look(exposure=1.0), View(), (64, 64))[:3].round(3)
        array([1.37, 1.37, 1.37], dtype=float32)
    """
    height, width = size
    row = np.zeros(ROW)
    red, blue = look.white_balance
    gains = 2.0**look.exposure * np.array([red, 1.0, blue])
    row[GAIN : GAIN + 3] = gains ** (1.0 / GAMMA)
    right, down = view.sensor_shift
    row[AXIS : AXIS + 2] = width / 2 + right * height, height / 2 + down * height
    corner = (width**2 + height**2) / 4 / view.crop**2
    row[LOSS] = look.vignette / corner
    row[NOISE] = look.noise * 255.0
    spread = look.blur * height
    places = np.arange(REACH + 1)
    shares = np.exp(-0.5 * (places / spread) ** 2) if spread > 0 else places == 0
    row[KERNEL:] = shares / (2.0 * np.sum(shares) - shares[0])
    # Mathematical libraries differ in the last bit of a power: fewer bits are kept.
    return (np.round(row * 2.0**20) / 2.0**20).astype(np.float32)


@inner
def mixed(number: Any) -> Any:
    """Return a number whose bits depend on all bits of another (Steele et al. 2014)."""
    number = number + np.uint64(0x9E3779B97F4A7C15)
    number = (number ^ (number >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    number = (number ^ (number >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return number ^ (number >> np.uint64(31))


@inner
def _blur(image: Any, row: Any, values: Any, work: Any) -> None:
    """Write a frame, blurred, to `values`; what is outside is as its edge."""
    height, width = image.shape[1], image.shape[2]
    for c in range(3):
        for y in range(height):
            for x in range(width):
                total = row[KERNEL] * np.float32(image[c, y, x])
                for k in range(1, REACH + 1):
                    left, right = max(x - k, 0), min(x + k, width - 1)
                    total += row[KERNEL + k] * (
                        np.float32(image[c, y, left]) + np.float32(image[c, y, right])
                    )
                work[c, y, x] = total
        for y in range(height):
            for x in range(width):
                total = row[KERNEL] * work[c, y, x]
                for k in range(1, REACH + 1):
                    above, below = max(y - k, 0), min(y + k, height - 1)
                    total += row[KERNEL + k] * (work[c, above, x] + work[c, below, x])
                values[c, y, x] = total


@njit(nogil=True, cache=True, error_model="numpy")
def expose_range(
    first: int, last: int, which: Any, rows: Any, keys: Any, images: Any
) -> None:
    """Change the frames of the worlds `which[first:last]` to what a sensor reports.

    Blur, then light (exposure, white balance, vignette), then noise; what is beyond
    black or white is cut.

    Args:
        first: First place in `which`.
        last: One after the last.
        which: Indices of worlds.
        rows: Of each world, see `exposure_row`, (N, ROW).
        keys: Of each world's frame, uint64 (N,): equal keys have equal noise.
        images: uint8 (N, 3, height, width), changed.
    """
    height, width = images.shape[2], images.shape[3]
    values = np.empty((3, height, width), np.float32)
    work = np.empty((3, height, width), np.float32)
    for number in range(first, last):
        e = which[number]
        row, image = rows[e], images[e]
        if row[KERNEL] < _ONE:
            _blur(image, row, values, work)
        else:
            for c in range(3):
                for y in range(height):
                    for x in range(width):
                        values[c, y, x] = np.float32(image[c, y, x])
        start = mixed(keys[e])
        for y in range(height):
            down = np.float32(y) + _HALF - row[AXIS + 1]
            for x in range(width):
                right = np.float32(x) + _HALF - row[AXIS]
                light = _ONE - row[LOSS] * (right * right + down * down)
                light = max(light, _ZERO)
                for c in range(3):
                    value = values[c, y, x] * row[GAIN + c] * light
                    if row[NOISE] > _ZERO:
                        place = np.uint64((y * width + x) * 3 + c)
                        bits = mixed(start + place)
                        total = np.int64(0)
                        for part in range(4):
                            total += np.int64(
                                (bits >> np.uint64(16 * part)) & np.uint64(0xFFFF)
                            )
                        value += row[NOISE] * (_SCALE * np.float32(total - _MEAN))
                    value = min(max(value, _ZERO), _FULL)
                    image[c, y, x] = np.uint8(value + _HALF)
