"""What a lens and a sensor do to a frame, against numbers worked out by hand."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.typing import NDArray

from rlco.physics.rendering.exposure import expose_range, exposure_row
from rlco.physics.spec.look import Look, View

SIZE = (48, 64)


def exposed(
    look: Look, frames: NDArray[np.uint8], view: View | None = None, first_key: int = 1
) -> NDArray[np.uint8]:
    """Return frames (N, 3, h, w) with a look; their keys count from `first_key`."""
    out, count = frames.copy(), len(frames)
    row = exposure_row(look, view or View(), (frames.shape[2], frames.shape[3]))
    keys = np.arange(first_key, first_key + count, dtype=np.uint64)
    expose_range(0, count, np.arange(count), np.tile(row, (count, 1)), keys, out)
    return out


def flat(value: int, count: int = 1) -> NDArray[np.uint8]:
    return np.full((count, 3, *SIZE), value, np.uint8)


def test_one_stop_doubles_light() -> None:
    # A display's value is the 2.2th root of light: 100 * 2^(1 / 2.2) = 137.04.
    assert set(exposed(Look(exposure=1.0), flat(100)).ravel().tolist()) == {137}
    assert set(exposed(Look(exposure=-1.0), flat(137)).ravel().tolist()) == {100}


def test_white_balance_is_of_red_and_blue() -> None:
    image = exposed(Look(white_balance=(1.5, 0.5)), flat(100))[0]
    # 100 * 1.5^(1 / 2.2) = 120.24 and 100 * 0.5^(1 / 2.2) = 72.97.
    assert image[:, 5, 5].tolist() == [120, 100, 73]


def test_a_corner_loses_the_vignettes_share_and_the_axis_nothing() -> None:
    image = exposed(Look(vignette=0.4), flat(200))[0, 0]
    assert image[24, 32] == 200
    # The corner's pixel has its centre 39.3 of 40 pixels from the middle.
    assert image[0, 0] == round(200 * (1 - 0.4 * (31.5**2 + 23.5**2) / 40**2))
    # By a sensor that is shifted half the frame's height the axis is at the edge.
    moved = exposed(Look(vignette=0.4), flat(200), View(sensor_shift=(0.0, -0.5)))[0, 0]
    assert moved[0, 32] == 200
    assert moved[47, 32] < image[47, 32]
    # Shifts are shares of the height in both directions, right and down.
    aside = exposed(Look(vignette=0.4), flat(200), View(sensor_shift=(0.5, 0.0)))[0, 0]
    assert aside[24, 56] == 200
    assert aside[24, 0] == round(200 * (1 - 0.4 * (55.5**2 + 0.5**2) / 40**2))
    # Of a sensor of which a quarter is read out, the corners are not in the frame.
    cropped = exposed(Look(vignette=0.4), flat(200), View(crop=0.5))[0, 0]
    assert cropped[0, 0] == round(200 * (1 - 0.1 * (31.5**2 + 23.5**2) / 40**2))


def test_blur_spreads_a_point_and_keeps_its_light() -> None:
    frames = flat(0)
    frames[0, :, 24, 32] = 240
    image = exposed(Look(blur=0.02), frames)[0, 1].astype(float)  # 0.96 pixels
    assert image[24, 32] < 60
    assert image.sum() == pytest.approx(240, abs=12)  # each pixel is rounded
    assert image[24, 33] == image[23, 32] == image[24, 31]
    share = np.exp(-0.5 / 0.96**2)
    assert image[24, 33] / image[24, 32] == pytest.approx(share, abs=0.02)
    # Inside a flat surface, and at the frame's edge, nothing changes.
    np.testing.assert_array_equal(exposed(Look(blur=0.02), flat(90)), flat(90))


def test_noise_has_its_deviation_and_no_pattern() -> None:
    noise = exposed(Look(noise=0.04), flat(128, 40)).astype(float) - 128
    # 40 frames of 9216 values: their mean has a deviation of 0.02, and the deviation's
    # own is 0.012; a value's rounding adds a variance of 1 / 12.
    assert abs(noise.mean()) < 0.08
    assert noise.std() == pytest.approx(np.hypot(0.04 * 255, 12**-0.5), abs=0.05)
    flat_noise = noise.reshape(40, -1)
    for one, other in (
        (flat_noise[:-1], flat_noise[1:]),  # from frame to frame
        (flat_noise[:, :-1], flat_noise[:, 1:]),  # from pixel to pixel
        (noise[:, 0], noise[:, 2]),  # from colour to colour
    ):
        # 3.5e5 pairs: the correlation of independent ones has a deviation of 0.0017.
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.01


def test_a_frames_noise_depends_on_its_key_alone() -> None:
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (6, 3, *SIZE), dtype=np.uint8)
    look = Look(noise=0.05, blur=0.01, vignette=0.2, exposure=0.3)
    together = exposed(look, frames)
    for number in range(6):
        alone = exposed(look, frames[number : number + 1], first_key=1 + number)
        np.testing.assert_array_equal(alone[0], together[number])
    rows = np.tile(exposure_row(look, View(), SIZE), (6, 1))
    keys, out = np.arange(1, 7, dtype=np.uint64), frames.copy()
    order = np.array([3, 0, 5, 1, 4, 2])
    with ThreadPoolExecutor(2) as pool:
        for part in ((0, 2), (2, 3), (3, 6)):
            pool.submit(expose_range, *part, order, rows, keys, out)
    np.testing.assert_array_equal(out, together)


def test_only_the_worlds_that_are_named_change() -> None:
    out = flat(100, 3)
    looks = (Look(exposure=-1.0), Look(exposure=2.0), Look(exposure=1.0))
    rows = np.stack([exposure_row(look, View(), SIZE) for look in looks])
    expose_range(0, 1, np.array([2]), rows, np.zeros(3, np.uint64), out)
    assert [int(image[0, 0, 0]) for image in out] == [100, 100, 137]


def test_values_beyond_black_and_white_are_cut() -> None:
    assert exposed(Look(exposure=3.0), flat(200)).min() == 255
    dark = exposed(Look(noise=0.2), flat(0))
    assert dark.min() == 0
    assert (dark == 0).mean() == pytest.approx(0.5, abs=0.05)
