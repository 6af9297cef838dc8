"""Camera frames as feature vectors: small networks of its own, or MobileNetV2's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NotRequired, TypedDict, get_args

import torch
from torch import nn

from rlco.errors import ConfigError, DataError, UnknownNameError
from rlco.physics.spec.names import RENDERERS, Renderer
from rlco.policies.nets.dense_images import DenseImages
from rlco.policies.nets.mobilenet import MobileNetMaps

ImageKind = Literal["conv", "dense", "mobilenet"]
IMAGE_KINDS: tuple[str, ...] = get_args(ImageKind)
#: Least and greatest side of an image [pixels].
SIDES = (64, 224)
#: Places that an encoder reports; features are three times as many.
POINTS = 32
#: Logits of places in a new encoder, in units of a channel's deviation over places.
SHARPNESS = 3.0


class ImageArguments(TypedDict):
    """How a policy sees, in types that JSON holds.

    Attributes:
        kind: "conv", "dense" or "mobilenet".
        size: height and width of an image [pixels], each within ``SIDES``.
        weights: mobilenet: file of torchvision's ImageNet weights; "saved": those in
            the policy's own file, which is loaded next.
        frozen: mobilenet: whether its weights stay as they are; by default they do.
        renderer: what draws the simulator's images for it, "raster" or "opengl"; the
            latter by default, as for all policies that say nothing of it.
        camera: the simulator's camera, "agentview" by default.
        cameras: several of them instead; each has an encoder of its own.
    """

    kind: ImageKind
    size: Sequence[int]
    weights: NotRequired[str | None]
    frozen: NotRequired[bool]
    renderer: NotRequired[Renderer]
    camera: NotRequired[str]
    cameras: NotRequired[Sequence[str]]


class SpatialSoftmax(nn.Module):
    """Where each channel of a map is brightest, and how bright it is there.

    Each channel becomes a distribution over places (softmax); its features are the
    mean place, x and y in [-1, 1] from left to right and from above to below, and the
    mean of the channel itself (Levine et al., arXiv 1504.00702).

    Args:
        sharpness: maps are multiplied by it to be logits.

    Example:
        >>> one = torch.zeros(1, 1, 3, 3)
        >>> one[0, 0, 0, 2] = 50.0  # above, on the right
        >>> SpatialSoftmax()(one)
        tensor([[ 1., -1., 50.]])
    """

    def __init__(self, sharpness: float = 1.0) -> None:
        super().__init__()
        self.sharpness = sharpness

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        """Return features [B, 3 C] of maps [B, C, h, w]: all x, all y, all values."""
        share = (self.sharpness * maps).flatten(-2).softmax(-1).view_as(maps)
        height, width = maps.shape[-2:]

        def side(length: int) -> torch.Tensor:
            return torch.linspace(-1, 1, length, dtype=maps.dtype, device=maps.device)

        x = share.sum(-2) @ side(width)
        y = share.sum(-1) @ side(height)
        value = (share * maps).sum((-2, -1))
        return torch.cat([x, y, value], -1)


class ConvMaps(nn.Module):
    """Three convolutions, about 16 places a side whatever the image's size.

    Args:
        size: height and width of an image [pixels].

    Attributes:
        channels: of the map that it returns.
    """

    channels = 32

    def __init__(self, size: tuple[int, int]) -> None:
        super().__init__()
        stride = min(size) // 32
        self.layers = nn.Sequential(
            nn.Conv2d(3, 16, 2 * stride, stride=stride, padding=stride // 2),
            nn.SiLU(),
            nn.Conv2d(16, 32, 3, stride=2, padding=1),
            nn.SiLU(),
            nn.Conv2d(32, self.channels, 3, padding=1),
            nn.SiLU(),
        )

    def forward(self, images: torch.Tensor) -> list[torch.Tensor]:
        """Return one map [B, 32, about 16, about 16] of images in [0, 1]."""
        return [self.layers(2.0 * images - 1.0)]


class ImageEncoder(nn.Module):
    """Images to features: maps of a network, and where each channel is brightest.

    No part of it remembers a batch, and nothing is drawn at random: an image has the
    same features in a rollout and in an update, so that PPO's ratios start at 1. It
    computes in the precision of its weights and returns at least float32.

    - "conv" has three convolutions, whose channels are reduced to the positions of
      their maxima: 16 thousand parameters at 64 x 64.
    - "dense" has three convolutions and a dense layer, `DenseImages`: 550 thousand
      parameters at 64 x 64. It needs more images than a few demonstrations have, and
      learns positions from labelled scenes faster and better.
    - "mobilenet" starts from MobileNetV2 (Sandler et al., arXiv 1801.04381) trained
      on ImageNet, frozen by default; what is learned is which combinations
      of its channels count.

    Args:
        kind: "conv", "dense" or "mobilenet".
        size: height and width of an image [pixels].
        weights: see `ImageArguments`.
        frozen: see `ImageArguments`.
        renderer: see `ImageArguments`.
        camera: see `ImageArguments`.

    Attributes:
        size: height and width of an image.
        renderer: see `ImageArguments`.
        camera: see `ImageArguments`.
        features: dimension of an image's feature vector.

    Raises:
        UnknownNameError: no such kind.
        ConfigError: a size that is not allowed, or mobilenet without weights.
        CheckpointError: weights that cannot be read or are another network's.

    Example:
        >>> encoder = ImageEncoder("conv", (64, 64))
        >>> encoder(torch.zeros(5, 3, 64, 64, dtype=torch.uint8)).shape
        torch.Size([5, 96])
    """

    def __init__(
        self,
        kind: ImageKind,
        size: Sequence[int],
        *,
        weights: str | None = None,
        frozen: bool = True,
        renderer: Renderer = "opengl",
        camera: str = "agentview",
    ) -> None:
        super().__init__()
        check_image(kind, size, weights)
        if renderer not in RENDERERS:
            raise UnknownNameError("renderer", renderer, RENDERERS)
        self.renderer, self.camera = renderer, camera
        height, width = size
        self.size = (int(height), int(width))
        self.network: ConvMaps | DenseImages | MobileNetMaps
        channels: Sequence[int] = ()
        if kind == "conv":
            self.network = ConvMaps(self.size)
            channels = (self.network.channels,)
        elif kind == "dense":
            self.network = DenseImages(self.size)
        else:
            self.network = MobileNetMaps(str(weights), frozen=frozen)
            channels = self.network.channels
        # Each map is normalised over its own places, which no other image changes:
        # otherwise all places would weigh alike at first, and little would be learnt.
        each = POINTS // max(len(channels), 1)
        self.points = nn.ModuleList(
            nn.Sequential(nn.Conv2d(count, each, 1), nn.GroupNorm(each, each))
            for count in channels
        )
        self.pool = SpatialSoftmax(SHARPNESS)
        self.features = 3 * POINTS if channels else DenseImages.features

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Return features [*B, features] of images uint8 [*B, 3, height, width].

        Raises:
            DataError: images of another size or type.
        """
        wanted = (3, *self.size)
        if images.dtype != torch.uint8 or images.shape[-3:] != wanted:
            raise DataError(
                f"images are {images.dtype} of shape {tuple(images.shape[-3:])}, the "
                f"policy was built for torch.uint8 of shape {wanted}; "
                f"{' and '.join(_advice(images, self.size))}."
            )
        batch = images.shape[:-3]
        last = self.network if isinstance(self.network, DenseImages) else self.points
        dtype = next(last.parameters()).dtype
        images = images.reshape(-1, *wanted).to(dtype) / 255.0
        found = self.network(images)
        if not isinstance(self.network, DenseImages):
            pooled = [
                self.pool(points(one))
                for points, one in zip(self.points, found, strict=True)
            ]
            found = torch.cat(pooled, -1)
        out: torch.Tensor = found.view(*batch, self.features)
        return out.to(torch.promote_types(out.dtype, torch.float32))


def _advice(images: torch.Tensor, size: tuple[int, int]) -> list[str]:
    """Say what makes images those that a policy reads, in the order to do it."""
    advice = []
    shape = tuple(images.shape[-3:])
    if images.is_floating_point():
        advice.append("turn fractions to bytes, (255 * image).round().to(torch.uint8)")
    elif images.dtype != torch.uint8:
        advice.append("give bytes, image.to(torch.uint8)")
    if len(shape) == 3 and shape[0] != 3 and shape[-1] == 3:
        advice.append("put colours first, image.movedim(-1, -3)")
        shape = (shape[-1], *shape[:-1])
    if len(shape) < 3 or shape[0] != 3:
        advice.append("give RGB images [*B, 3, height, width]")
    elif shape[1:] != size:
        advice.append(
            f"scale them as the data were, rlco.data.resize.resized(images, {size}) "
            f"(environments and data sets: image_size={size})"
        )
    return advice


def encoders_of(image: ImageArguments) -> list[ImageEncoder]:
    """Return an encoder for each camera, in the order of their names.

    Raises:
        ConfigError: no camera, or one that is named twice, and as `ImageEncoder`.
    """
    shared: dict[str, Any] = {k: v for k, v in image.items() if k != "cameras"}
    if "cameras" not in image:
        return [ImageEncoder(**shared)]
    cameras = list(image["cameras"])
    if not cameras or len(set(cameras)) < len(cameras):
        raise ConfigError([f"cameras={cameras} must be at least one, each once"])
    return [ImageEncoder(**{**shared, "camera": name}) for name in cameras]


def check_image(kind: str, size: Sequence[int], weights: str | None) -> None:
    """Refuse what no encoder can be built from, before anything is built.

    Raises:
        UnknownNameError: no such kind.
        ConfigError: a size that is not allowed, or mobilenet without weights.
    """
    if kind not in IMAGE_KINDS:
        raise UnknownNameError("image", kind, ("none", *IMAGE_KINDS))
    low, high = SIDES
    if len(size) != 2 or not all(low <= side <= high for side in size):
        raise ConfigError(
            [f"image_size={tuple(size)} must be two sides of {low} to {high} pixels"]
        )
    if kind == "mobilenet" and weights is None:
        raise ConfigError(
            [
                "image='mobilenet' needs its ImageNet weights from a file; give "
                "image_weights=mobilenet_v2-b0353104.pth, as torchvision publishes it "
                "(nothing is downloaded), or image='conv'"
            ]
        )


def saved_arguments(image: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of the encoder as a saved policy's description has them.

    Its weights lie in the policy's own file then, wherever they came from.

    Example:
        >>> saved_arguments({"kind": "conv", "size": (64, 64)})
        {'kind': 'conv', 'size': [64, 64]}
    """
    saved = {**image, "size": [int(side) for side in image["size"]]}
    if "cameras" in image:
        saved["cameras"] = list(image["cameras"])
    if image["kind"] == "mobilenet":
        saved["weights"] = "saved"
    return saved
