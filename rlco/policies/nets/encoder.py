"""Observations, normalised and encoded, as one feature vector."""

from __future__ import annotations

from typing import Any

import torch
from numpy.typing import ArrayLike
from tensordict import TensorDictBase
from torch import nn
from torch.nn import functional

from rlco.errors import ConfigError, DataError
from rlco.keys import (
    ENVIRONMENT_STATE,
    IMAGE_FEATURES,
    INSTRUCTION_ID,
    STATE,
    image_keys,
)
from rlco.policies.nets.image_encoder import (
    ImageArguments,
    ImageEncoder,
    encoders_of,
)
from rlco.policies.nets.normalizer import QuantileNormalizer

#: The lower and the upper quantile of some features, a number each.
Quantiles = tuple[ArrayLike, ArrayLike]

#: A feature that moved less than this in the data [m] or [rad] is not magnified more.
MIN_OBSERVATION_RANGE = 0.02
#: Normalised observations end here: values beyond occur in no demonstration.
OBSERVATION_CLIP = 10.0


def read(tensordict: TensorDictBase, key: str | tuple[str, ...]) -> torch.Tensor:
    """Return an entry, or say which one is missing.

    Raises:
        DataError: the entry is not there.
    """
    value = tensordict.get(key, None)
    if value is None:
        held = sorted(map(str, tensordict.keys(include_nested=True, leaves_only=True)))
        raise DataError(f"the batch has no {key!r}; it holds {', '.join(held)}.")
    tensor: torch.Tensor = value
    return tensor


class ObservationEncoder(nn.Module):
    """State, object poses, image and instruction, normalised and concatenated.

    Where object poses and an instruction are read, the poses follow once more for each
    instruction, all zero but for the given one (the outer product of both). Which
    object counts is then a matter of weights: without it, a few demonstrations hardly
    teach a perceptron to pick one object out of three. What an image shows is treated
    like the poses.

    Args:
        state_size: numbers in ``("observation", "state")``; 0 leaves it unread.
        environment_state_size: numbers in ``("observation", "environment_state")``;
            0 leaves it unread.
        num_instructions: how many instructions there are; ``instruction_id`` is read
            one-hot. 0 leaves it unread.
        image: how ``("observation", "image")`` is read, see
            `rlco.policies.ImageArguments`; None leaves it unread.

    Attributes:
        in_keys: the entries that it reads.
        size: dimension of the feature vector.
        image: the encoder of images; None where they are not read.
        image_sizes: features of each camera's image.
        reads_stored: whether ``("observation", "image_features")`` is read in place of
            images where a batch has it. False in a new encoder.

    Raises:
        ConfigError: nothing to read, or a negative size.
        DataError: a call lacks an entry, or gives an instruction that there is not.
        CheckpointError: the image encoder's weights cannot be loaded.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> encoder = ObservationEncoder(2, num_instructions=3)
        >>> td = TensorDict(
        ...     {"observation": {"state": torch.tensor([[0.5, -1.0]])},
        ...      "instruction_id": torch.tensor([1])}, [1])
        >>> encoder(td)
        tensor([[ 0.5000, -1.0000,  0.0000,  1.0000,  0.0000]])
    """

    def __init__(
        self,
        state_size: int,
        environment_state_size: int = 0,
        num_instructions: int = 0,
        image: ImageArguments | None = None,
    ) -> None:
        super().__init__()
        sizes = (state_size, environment_state_size, num_instructions)
        if min(sizes) < 0 or (sum(sizes) == 0 and image is None):
            raise ConfigError(
                [
                    "state_size, environment_state_size and num_instructions are "
                    f"{sizes}; none may be negative and one must be positive"
                ]
            )
        self.in_keys: list[Any] = []
        self.state = self._normalizer("state", STATE, state_size)
        self.environment_state = self._normalizer(
            "environment_state", ENVIRONMENT_STATE, environment_state_size
        )
        # The first one alone under this name: so the files of policies have it.
        first, *others = encoders_of(image) if image is not None else [None]
        self.image: ImageEncoder | None = first
        self.other_images = nn.ModuleList(one for one in others if one is not None)
        self.image_keys = image_keys(self.cameras) if first is not None else ()
        self.in_keys += self.image_keys
        self.num_instructions = num_instructions
        if num_instructions:
            self.in_keys.append(INSTRUCTION_ID)
        # Of the objects: what there is once more for each instruction.
        self.image_sizes = [one.features for one in self.image_encoders()]
        self.reads_stored = False
        scene = environment_state_size + sum(self.image_sizes)
        self.size = state_size + num_instructions + scene * (1 + num_instructions)

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the simulator's cameras whose images it reads."""
        return tuple(one.camera for one in self.image_encoders())

    def image_encoders(self) -> list[ImageEncoder]:
        """Return the encoder of each camera."""
        if self.image is None:
            return []
        return [self.image, *self.other_images]

    def _normalizer(
        self, name: str, key: tuple[str, ...], size: int
    ) -> QuantileNormalizer | None:
        if not size:
            return None
        self.in_keys.append(key)
        return QuantileNormalizer(
            size, name=name, min_range=MIN_OBSERVATION_RANGE, clip=OBSERVATION_CLIP
        )

    def set_normalization(
        self,
        *,
        state: Quantiles | None = None,
        environment_state: Quantiles | None = None,
    ) -> None:
        """Fix the normalisation from quantiles (low, high) of the training data.

        Raises:
            DataError: quantiles of what is not read, or of another size.
        """
        for name, quantiles, normalizer in (
            ("state", state, self.state),
            ("environment_state", environment_state, self.environment_state),
        ):
            if quantiles is None:
                continue
            if normalizer is None:
                raise DataError(
                    f"quantiles of {name} were given, but the policy was built with "
                    f"{name}_size=0; leave them out or build it with their size."
                )
            normalizer.set_quantiles(*quantiles)

    def image_features(self, tensordict: TensorDictBase) -> torch.Tensor:
        """Return what the images become, all cameras beside each other [*B, F].

        Raises:
            DataError: an image is missing, or of another size or type.
        """
        encoders = zip(self.image_keys, self.image_encoders(), strict=True)
        found = [encoder(read(tensordict, key)) for key, encoder in encoders]
        return torch.cat(found, -1)

    def forward(self, tensordict: TensorDictBase) -> torch.Tensor:
        """Return the features [*B, size]; float32, or float64 where inputs are."""
        parts, scene = [], []
        if self.state is not None:
            parts.append(self.state(read(tensordict, STATE)))
        if self.environment_state is not None:
            scene.append(self.environment_state(read(tensordict, ENVIRONMENT_STATE)))
        if self.image is not None:
            stored = tensordict.get(IMAGE_FEATURES, None) if self.reads_stored else None
            images = self.image_features(tensordict) if stored is None else stored
            scene += images.split(self.image_sizes, -1)
        parts += scene
        if self.num_instructions:
            chosen = read(tensordict, INSTRUCTION_ID)
            dtype = parts[0].dtype if parts else torch.get_default_dtype()
            one_hot = self._one_hot(chosen).to(dtype)
            parts += [
                (one_hot.unsqueeze(-1) * one.unsqueeze(-2)).flatten(-2) for one in scene
            ]
            parts.append(one_hot)
        return torch.cat(parts, dim=-1)

    def _one_hot(self, chosen: torch.Tensor) -> torch.Tensor:
        try:
            return functional.one_hot(chosen, self.num_instructions)
        except RuntimeError as error:
            count = self.num_instructions
            given = sorted(set(chosen.flatten().tolist()))
            raise DataError(
                f"instruction_id is {', '.join(map(str, given))} ({chosen.dtype}), but "
                f"the policy was built for {count} instructions; give whole numbers "
                f"(torch.int64) from 0 to {count - 1}, the order of the instructions "
                "that were saved with it."
            ) from error
