"""The size of images: height and width, as arrays have them."""

from __future__ import annotations

import numpy as np

from rlco.errors import RlcoError


def check_image_size(image_size: tuple[int, int] | None) -> None:
    """Check a size of images, None included; the recipes' one number is none.

    Raises:
        RlcoError: It is no height and width of at least one pixel.

    Example:
        >>> check_image_size((48, 64))
        >>> check_image_size(64)
        Traceback (most recent call last):
        rlco.errors.RlcoError: image_size=64 is not allowed; give (height, width) in
        pixels.
    """
    if image_size is None:
        return
    if np.shape(image_size) != (2,) or min(image_size) < 1:
        raise RlcoError(
            f"image_size={image_size} is not allowed; give (height, width) in pixels."
        )
