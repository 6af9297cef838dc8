"""Images of demonstrations, changed a little at each draw."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch.nn import functional


@dataclass(frozen=True)
class Augmentation:
    """Shifts images at random, and changes their brightness and contrast.

    For demonstrations alone. The images of a rollout stay as the policy saw them:
    with others its log-probability would be another, and PPO's ratios would not start
    at 1.

    Shifting is DrQ's (Kostrikov et al., arXiv 2004.13649): the edge pixels are
    repeated outwards, and an image of the old size is cut out at random. Colours keep
    their hue, as instructions name them.

    Attributes:
        shift: largest shift, as a share of the image's side.
        brightness: images are multiplied by 1 - brightness to 1 + brightness.
        contrast: distances to the image's mean grey likewise.

    Example:
        >>> images = torch.full((2, 3, 64, 64), 100, dtype=torch.uint8)
        >>> out = Augmentation(brightness=0.5)(images, torch.Generator())
        >>> out.shape, out.dtype, bool((out >= 50).all() and (out <= 150).all())
        (torch.Size([2, 3, 64, 64]), torch.uint8, True)
    """

    shift: float = 0.04
    brightness: float = 0.2
    contrast: float = 0.2

    def __call__(
        self, images: torch.Tensor, generator: torch.Generator | None = None
    ) -> torch.Tensor:
        """Return new images, uint8 [B, 3, h, w]; the given ones stay as they are."""
        moved = self._shifted(images, generator).float()
        grey = moved.mean((-3, -2, -1), keepdim=True)

        def factor(spread: float) -> torch.Tensor:
            drawn = torch.rand(len(images), 1, 1, 1, generator=generator)
            return (1 + spread * (2 * drawn - 1)).to(images.device)

        bright, contrast = factor(self.brightness), factor(self.contrast)
        changed = bright * (grey + contrast * (moved - grey))
        return changed.round_().clamp_(0, 255).to(torch.uint8)

    def _shifted(
        self, images: torch.Tensor, generator: torch.Generator | None
    ) -> torch.Tensor:
        height, width = images.shape[-2:]
        pads = [round(self.shift * side) for side in (height, width)]
        padded = functional.pad(
            images.float(), (pads[1], pads[1], pads[0], pads[0]), mode="replicate"
        ).to(torch.uint8)
        top, left = (
            torch.randint(2 * pad + 1, (len(images), 1), generator=generator)
            for pad in pads
        )
        rows = (top + torch.arange(height))[:, None, :, None].to(images.device)
        columns = (left + torch.arange(width))[:, None, None, :].to(images.device)
        each = torch.arange(len(images), device=images.device)[:, None, None, None]
        channel = torch.arange(3, device=images.device)[None, :, None, None]
        return padded[each, channel, rows, columns]
