"""Recorded pictures in the size that a policy reads."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch.nn import functional

from rlco.errors import DataError
from rlco.lerobot_files import LeRobotFolder, iterate_images

#: Pictures that are made smaller at once: as floats they are four times as large.
ROWS = 256


def resized(pictures: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """Cut pictures about their middle to the shape of ``size``, and make them smaller.

    Nothing is stretched: a simulated camera with the real one's vertical field of view
    shows things equally large.

    Args:
        pictures: uint8 [B, 3, height, width].
        size: height and width wanted, neither greater than the pictures' [pixels].

    Returns:
        uint8 [B, 3, height, width]; the pictures themselves where they have that size.

    Example:
        >>> wide = torch.zeros(2, 3, 480, 640, dtype=torch.uint8)
        >>> resized(wide, (64, 64)).shape
        torch.Size([2, 3, 64, 64])
    """
    if tuple(pictures.shape[-2:]) == tuple(size):
        return pictures
    cut = _cut(pictures, size)
    return torch.cat([_smaller(rows, size) for rows in torch.split(cut, ROWS)])


def pictures_of(
    folder: LeRobotFolder, camera: str, size: tuple[int, int] | None
) -> Iterator[torch.Tensor]:
    """Return one camera's pictures, an episode at a time.

    Args:
        folder: What `rlco.lerobot_files.read_folder` returned.
        camera: The feature's name.
        size: Height and width wanted [pixels]; None leaves them as they are.

    Returns:
        Of each episode uint8 [T, 3, height, width].

    Raises:
        DataError: The pictures are smaller than ``size``, or cannot be read.
    """
    episodes = map(torch.from_numpy, iterate_images(folder, camera))
    if size is None:
        return episodes
    _check_large_enough(folder, camera, size)
    return (resized(pictures, size) for pictures in episodes)


def _check_large_enough(
    folder: LeRobotFolder, camera: str, size: tuple[int, int]
) -> None:
    feature = folder.feature(camera)
    sides = sorted(feature.shape)[1:]  # channels are fewest, first or last
    if min(sides) < min(size) or max(sides) < max(size):
        raise DataError(
            f"pictures of {camera!r} of data set {str(folder.path)!r} have shape "
            f"{feature.shape}, too small for image_size={size}; give a smaller "
            "image_size=, or record larger pictures."
        )


def _smaller(pictures: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    smooth = functional.interpolate(
        pictures.float(), size, mode="bilinear", antialias=True, align_corners=False
    )
    return smooth.round().clamp(0, 255).to(torch.uint8)


def _cut(pictures: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    height, width = pictures.shape[-2:]
    rows = min(height, round(width * size[0] / size[1]))
    columns = min(width, round(height * size[1] / size[0]))
    top, left = (height - rows) // 2, (width - columns) // 2
    return pictures[..., top : top + rows, left : left + columns]
