"""Recorded images in the size that a policy reads."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch.nn import functional

from rlco.errors import DataError
from rlco.lerobot_files import LeRobotFolder, iterate_images

#: Images that are made smaller at once: as floats they are four times as large.
ROWS = 256


def resized(images: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """Cut images about their middle to the shape of ``size``, and make them smaller.

    Nothing is stretched: a simulated camera with the real one's vertical field of view
    shows things equally large.

    Args:
        images: uint8 [B, 3, height, width].
        size: height and width wanted, neither greater than the images' [pixels].

    Returns:
        uint8 [B, 3, height, width]; the images themselves where they have that size.

    Example:
        >>> wide = torch.zeros(2, 3, 480, 640, dtype=torch.uint8)
        >>> resized(wide, (64, 64)).shape
        torch.Size([2, 3, 64, 64])
    """
    if tuple(images.shape[-2:]) == tuple(size):
        return images
    cut = _cut(images, size)
    return torch.cat([_smaller(rows, size) for rows in torch.split(cut, ROWS)])


def images_of(
    folder: LeRobotFolder, camera: str, size: tuple[int, int] | None
) -> Iterator[torch.Tensor]:
    """Return one camera's images, an episode at a time.

    Args:
        folder: What `rlco.lerobot_files.read_folder` returned.
        camera: The feature's name.
        size: Height and width wanted [pixels]; None leaves them as they are.

    Returns:
        Of each episode uint8 [T, 3, height, width].

    Raises:
        DataError: The images are smaller than ``size``, or cannot be read.
    """
    episodes = map(torch.from_numpy, iterate_images(folder, camera))
    if size is None:
        return episodes
    _check_large_enough(folder, camera, size)
    return (resized(images, size) for images in episodes)


def _check_large_enough(
    folder: LeRobotFolder, camera: str, size: tuple[int, int]
) -> None:
    feature = folder.feature(camera)
    sides = sorted(feature.shape)[1:]  # channels are fewest, first or last
    if min(sides) < min(size) or max(sides) < max(size):
        raise DataError(
            f"images of {camera!r} of data set {str(folder.path)!r} have shape "
            f"{feature.shape}, too small for image_size={size}; give a smaller "
            "image_size=, or record larger images."
        )


def _smaller(images: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    smooth = functional.interpolate(
        images.float(), size, mode="bilinear", antialias=True, align_corners=False
    )
    return smooth.round().clamp(0, 255).to(torch.uint8)


def _cut(images: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    height, width = images.shape[-2:]
    rows = min(height, round(width * size[0] / size[1]))
    columns = min(width, round(height * size[1] / size[0]))
    top, left = (height - rows) // 2, (width - columns) // 2
    return images[..., top : top + rows, left : left + columns]
