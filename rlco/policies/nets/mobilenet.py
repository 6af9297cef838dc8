"""MobileNetV2's maps, with ImageNet's weights from a local file."""

from __future__ import annotations

import pickle
import warnings
import zipfile
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import nn
from torch.nn import functional

from rlco.errors import CheckpointError
from rlco.files import reading, shown
from rlco.files.sizes import check_declared
from rlco.finite import check_loaded

#: The weights that a policy's own file holds.
SAVED = "saved"
#: Blocks whose maps are read, at an eighth and a sixteenth of the image's side.
BLOCKS = (6, 13)
#: ImageNet's mean and standard deviation of red, green and blue, in [0, 1].
MEAN = (0.485, 0.456, 0.406)
STD = (0.229, 0.224, 0.225)


class _FixedNorm(nn.BatchNorm2d):
    """Batch normalisation by the statistics that it was loaded with, always."""

    def forward(self, maps: torch.Tensor) -> torch.Tensor:
        return functional.batch_norm(
            maps,
            self.running_mean,
            self.running_var,
            self.weight,
            self.bias,
            eps=self.eps,
        )


class MobileNetMaps(nn.Module):
    """Two maps out of MobileNetV2 (Sandler et al., arXiv 1801.04381).

    The pooled output for ImageNet's classes does not say where things are; maps do:
    32 channels at an eighth of the image's side, 96 at a sixteenth. Batch
    normalisation is fixed to ImageNet's statistics, also where the rest is trained: it
    is the same function in a rollout and in an update.

    Args:
        weights: file of torchvision's ``mobilenet_v2`` (.pth or .safetensors), or
            "saved": they come with `load_state_dict`, and are refused until then.
        frozen: whether its weights stay as they are.

    Attributes:
        channels: of each map.

    Raises:
        CheckpointError: the file cannot be read, or is another network's.
    """

    channels = (32, 96)
    mean: torch.Tensor
    std: torch.Tensor

    def __init__(self, weights: str, *, frozen: bool = True) -> None:
        super().__init__()
        from torchvision.models import mobilenet_v2

        whole: Any = mobilenet_v2(norm_layer=_FixedNorm)
        if weights != SAVED:
            _load(whole, Path(weights))
        self.has_weights = weights != SAVED
        self.blocks = whole.features[: BLOCKS[-1] + 1].requires_grad_(not frozen)
        self.frozen = frozen
        for name, value in (("mean", MEAN), ("std", STD)):
            self.register_buffer(name, torch.tensor(value).view(3, 1, 1))

    def forward(self, images: torch.Tensor) -> list[torch.Tensor]:
        """Return the maps [B, 32, h / 8, w / 8] and [B, 96, h / 16, w / 16].

        Raises:
            CheckpointError: its weights were to come from a policy's file, and have
                not come.
        """
        if not self.has_weights:
            raise CheckpointError(
                "this MobileNetV2 has no weights: none were loaded, or they were drawn "
                "anew; use load_policy, or give image_weights= their file."
            )
        maps = []
        # What is not trained needs no memory for a backward pass.
        with torch.set_grad_enabled(torch.is_grad_enabled() and not self.frozen):
            out = (images - self.mean) / self.std
            for index, block in enumerate(self.blocks):
                out = block(out)
                if index in BLOCKS:
                    maps.append(out)
        return maps

    def reset_parameters(self) -> None:
        """Refuse to work from here on: drawn at random, the maps would mean nothing."""
        self.has_weights = False

    def _load_from_state_dict(self, *args: Any, **options: Any) -> None:
        super()._load_from_state_dict(*args, **options)
        self.has_weights = True


#: Where the weights come from, for messages.
_ADVICE = (
    "give image_weights= the file mobilenet_v2-b0353104.pth that torchvision publishes"
)


def _load(network: nn.Module, path: Path) -> None:
    """Copy a file's weights into a whole MobileNetV2."""
    expected, given = network.state_dict(), _read(path)
    wrong = [
        name
        for name in [*expected, *(given.keys() - expected.keys())]
        if not _fits(given.get(name), expected.get(name))
    ]
    if wrong:
        raise CheckpointError(
            f"{str(path)!r} holds no weights of MobileNetV2: {len(wrong)} entries "
            f"differ, first {shown(wrong[0])}; {_ADVICE}."
        )
    check_loaded(str(path), given.items(), advice=_ADVICE)
    network.load_state_dict(given)


def _read(path: Path) -> dict[Any, Any]:
    """Return what a file of weights holds; {} where that is no state of a module.

    Nothing but tensors is unpickled. torch's reader of pickles checks little of their
    order, so that a damaged one raises whatever Python does.
    """
    with reading(
        path,
        SafetensorError,
        what="file of weights",
        advice=_ADVICE,
        error=CheckpointError,
    ):
        if path.suffix == ".safetensors":
            return load_file(path)
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                declared = sum(entry.file_size for entry in archive.infolist())
            check_declared(path, declared)
        try:
            with warnings.catch_warnings(action="ignore"):
                found = torch.load(path, map_location="cpu", weights_only=True)
        except pickle.UnpicklingError as error:  # torch says how to run what is in it
            raise ValueError("it holds something else than tensors") from error
    return found if isinstance(found, dict) else {}


def _fits(given: Any, expected: torch.Tensor | None) -> bool:
    """Return whether a value can be copied into a tensor of the network."""
    return (
        isinstance(given, torch.Tensor)
        and expected is not None
        and given.shape == expected.shape
        and given.layout == torch.strided
        and given.device.type == "cpu"  # not "meta", which holds no numbers
        and given.is_floating_point() == expected.is_floating_point()
        and not given.is_complex()
    )
