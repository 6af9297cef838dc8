"""Images as features by strided convolutions and a dense layer."""

from __future__ import annotations

import torch
from torch import nn

#: Features of an image.
FEATURES = 128


class DenseImages(nn.Module):
    """Three strided convolutions, then one dense layer over all of their cells.

    The shape of the network that deep Q-learning made common (Mnih et al., Nature 518,
    2015). A dense layer reads each cell of the last map with weights of its own, so
    that any function of where things are is near at hand. The first stride grows with
    the image, about 8 x 8 cells are left of any size. The features are normalised over
    each image alone (layer normalisation), never over a batch.

    Args:
        size: height and width of an image [pixels].

    Attributes:
        features: dimension of an image's feature vector.

    Example:
        >>> DenseImages((64, 64))(torch.zeros(5, 3, 64, 64)).shape
        torch.Size([5, 128])
    """

    features = FEATURES

    def __init__(self, size: tuple[int, int]) -> None:
        super().__init__()
        stride = min(size) // 32
        self.maps = nn.Sequential(
            nn.Conv2d(3, 16, 2 * stride, stride=stride, padding=stride // 2),
            nn.ReLU(),
            nn.Conv2d(16, 32, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Conv2d(32, 64, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Flatten(),
        )
        with torch.no_grad():
            cells = self.maps(torch.zeros(1, 3, *size)).shape[-1]
        self.dense = nn.Sequential(
            nn.Linear(cells, FEATURES), nn.LayerNorm(FEATURES), nn.ReLU()
        )

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return features [B, 128] of images [B, 3, height, width] in [0, 1]."""
        found: torch.Tensor = self.dense(self.maps(2.0 * images - 1.0))
        return found
