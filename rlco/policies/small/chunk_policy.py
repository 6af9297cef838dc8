"""What the small policies share: what they read, and the units of their actions."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import InteractionType, TensorDictModuleBase
from tensordict.nn.probabilistic import interaction_type

from rlco.errors import ConfigError, DataError
from rlco.keys import (
    ACTION,
    CHUNK,
    DOMAIN,
    DOMAIN_FLAGS,
    IMAGE_FEATURES,
    LOG_PROB,
    REAL,
    SAMPLE,
    is_image,
)
from rlco.physics.spec.actions import LIMIT
from rlco.physics.spec.names import Renderer
from rlco.policies.nets.encoder import ObservationEncoder, Quantiles, read
from rlco.policies.nets.image_encoder import ImageArguments, saved_arguments
from rlco.policies.nets.normalizer import QuantileNormalizer

#: An action number that moved less than this in the demonstrations (raw units; the
#: limits are 2 apart) keeps this range: see :class:`ChunkPolicy`.
MIN_ACTION_RANGE = 0.2
#: The same where actions have no limits, and so no known unit: what is constant stays.
MIN_UNLIMITED_RANGE = 1e-3
_SAMPLED = (None, InteractionType.RANDOM)


class ChunkPolicy(TensorDictModuleBase):
    """Base of the policies that rlco builds itself: an encoder and a normaliser.

    Samples, losses and log-probabilities live in the normalised action space, where
    the 1 % and 99 % quantiles of the demonstrated actions are -1 and 1. Raw actions
    are clipped to the action limits [-1, 1], which every task of the simulator has;
    demonstrations beyond them are refused, as clipped they would be other actions. A
    robot of another kind (joint angles, say) has a policy with ``action_limit=None``.

    An action number that hardly moves in the demonstrations is not squeezed onto its
    one value: its range is widened to ``MIN_ACTION_RANGE`` = 0.2 about that value, so
    that exploration there stays small without being switched off: noise in a rotation
    that no demonstration uses would add up over an episode. This is a tenth of the
    range [-1, 1]; with ``action_limit=None`` no range is known, and only what is
    constant is widened, to ``MIN_UNLIMITED_RANGE`` = 0.001 in the action's own unit.

    With ``guidance`` the policy reads a domain flag beside the observation: ``domain``
    [*B, 1], +1 on the robot, -1 in the simulator, 0 where it is dropped. A batch that
    has none is from the robot, so that no environment has to know of it. What acts is
    ``out(0) + guidance * (out(flag) - out(0))``, classifier-free guidance (Ho and
    Salimans, arXiv 2207.12598, whose w is guidance - 1), where ``out`` is a Gaussian's
    mean, a flow's velocity or a token's logits. Imitation trains ``out(flag)`` itself.

    Args:
        state_size: dimension of the state.
        chunk: steps H of a chunk.
        action_size: action dimensions A.
        environment_state_size: dimension of the environment state; 0: not read.
        num_instructions: instructions to tell apart; 0: not read.
        image: how images are read, see `rlco.policies.ImageArguments`; None: not.
        action_limit: raw actions are clipped to it; None leaves them as they are.
        guidance: weight of guidance by the domain flag, 1 for the flag alone; None: no
            flag is read.

    Raises:
        ConfigError: sizes that are not positive, or a weight that is not finite.
        CheckpointError: the image encoder's weights cannot be loaded.
    """

    kind: ClassVar[str]
    #: What a rollout has to keep to recompute log-probabilities.
    replay_keys: list[Any]

    def __init__(
        self,
        state_size: int,
        *,
        chunk: int,
        action_size: int,
        environment_state_size: int,
        num_instructions: int,
        image: ImageArguments | None = None,
        action_limit: float | None = LIMIT,
        guidance: float | None = None,
    ) -> None:
        super().__init__()
        if action_limit is not None and not action_limit > 0:
            raise ConfigError(
                [f"action_limit={action_limit} must be positive, or None"]
            )
        if chunk < 1 or action_size < 1:
            raise ConfigError(
                [f"chunk={chunk} and action_size={action_size} must be at least 1"]
            )
        self.arguments: dict[str, Any] = {
            "state_size": state_size,
            "chunk": chunk,
            "action_size": action_size,
            "environment_state_size": environment_state_size,
            "num_instructions": num_instructions,
        }
        if image is not None:
            self.arguments["image"] = saved_arguments(image)
        if action_limit != LIMIT:
            self.arguments["action_limit"] = action_limit
        self.guidance: float | None = None
        if guidance is not None:
            self._set_guidance(guidance)
        self.action_limit = action_limit
        self.chunk, self.action_size = chunk, action_size
        self.encoder = ObservationEncoder(
            state_size, environment_state_size, num_instructions, image
        )
        self.action_normalizer = QuantileNormalizer(
            action_size,
            name="action",
            min_range=MIN_UNLIMITED_RANGE if action_limit is None else MIN_ACTION_RANGE,
            limit=action_limit,
        )
        self.in_keys = self.encoder.in_keys
        self.dist_sample_keys: list[Any] = [SAMPLE]
        self.log_prob_keys: list[Any] = [LOG_PROB]
        self.replay_keys = [*self.in_keys, SAMPLE]
        self.out_keys = [SAMPLE, LOG_PROB, CHUNK, ACTION]

    @property
    def feature_size(self) -> int:
        """Dimension of what `features` returns."""
        return self.encoder.size + (self.guidance is not None)

    def set_guidance(self, weight: float) -> None:
        """Guide by another weight from now on; a saved policy keeps it.

        Args:
            weight: 1 for the flag alone, 0 for no flag.

        Raises:
            ConfigError: the policy reads no domain flag, or the weight is not finite.
        """
        if self.guidance is None:
            raise ConfigError(
                [
                    f"guidance={weight} needs a policy that reads a domain flag, and "
                    "this one reads none; train one with sft domain_flag=0.1"
                ]
            )
        self._set_guidance(weight)

    def _set_guidance(self, weight: float) -> None:
        if not math.isfinite(weight):
            raise ConfigError([f"guidance={weight} must be finite"])
        self.guidance = self.arguments["guidance"] = float(weight)

    def set_normalization(
        self,
        *,
        state: Quantiles | None = None,
        environment_state: Quantiles | None = None,
        action: Quantiles | None = None,
    ) -> None:
        """Fix the normalisation, once, before Stage I, from quantiles (low, high).

        Args:
            state: quantiles of the state, each of shape (state_size,), raw units.
            environment_state: quantiles of the environment state.
            action: quantiles of the action dimensions, each of shape (action_size,).

        Raises:
            DataError: quantiles of another size, not finite, of what is not read, or of
                actions beyond the policy's limit.
        """
        self.encoder.set_normalization(state=state, environment_state=environment_state)
        if action is not None:
            self.action_normalizer.set_quantiles(*action)

    @property
    def image_size(self) -> tuple[int, int] | None:
        """Height and width of the images that it reads [pixels]; None: none."""
        return None if self.encoder.image is None else self.encoder.image.size

    @property
    def renderer(self) -> Renderer:
        """What draws the simulator's images for it: ``raster`` or ``opengl``."""
        image = self.encoder.image
        return "opengl" if image is None else image.renderer

    @property
    def cameras(self) -> tuple[str, ...]:
        """The simulator's cameras whose images it reads."""
        return self.encoder.cameras

    def fix_images(self) -> None:
        """Leave the image encoders as they are from now on, and compute images once.

        Their weights are no longer trained. The policy writes what it makes of an
        image, ``("observation", "image_features")``, beside the action; a batch that
        holds this is not asked for images again. Call it before losses are built.

        Raises:
            ConfigError: the policy reads no images.
        """
        if self.encoder.image is None:
            raise ConfigError(["the policy reads no images, so none can be fixed"])
        for encoder in self.encoder.image_encoders():
            encoder.requires_grad_(False)
        self.encoder.reads_stored = True
        images = [key for key in self.replay_keys if is_image(key)]
        kept = [key for key in self.replay_keys if key not in images]
        self.replay_keys = [*kept, IMAGE_FEATURES]
        self.out_keys = [*dict.fromkeys([*self.out_keys, IMAGE_FEATURES])]

    @property
    def images_fixed(self) -> bool:
        """Whether `fix_images` was called."""
        return IMAGE_FEATURES in self.replay_keys

    def store_images(self, tensordict: TensorDictBase) -> None:
        """Write what a fixed encoder makes of the present images; else do nothing.

        What the batch holds of an earlier step is replaced, never read. Rows without
        images bring features instead.
        """
        if self.images_fixed and any(
            tensordict.get(key, None) is not None for key in self.encoder.image_keys
        ):
            with torch.no_grad():
                tensordict.set(IMAGE_FEATURES, self.encoder.image_features(tensordict))

    def features(self, tensordict: TensorDictBase) -> torch.Tensor:
        """Return the encoded observation [*B, F], with the domain flag if it reads one.

        Raises:
            DataError: an entry is missing, or ``domain`` is not [*B, 1].
        """
        found: torch.Tensor = self.encoder(tensordict)
        if self.guidance is None:
            return found
        shape = (*found.shape[:-1], 1)
        flag = tensordict.get(DOMAIN, None)
        if flag is None:
            flag = found.new_full(shape, DOMAIN_FLAGS[REAL])
        if flag.shape != shape:
            raise DataError(
                f"{DOMAIN!r} has shape {tuple(flag.shape)}, the observations "
                f"{shape[:-1]}; give one number a row, of shape {shape}."
            )
        return torch.cat([found, flag.to(found)], -1)

    def acting_features(self, tensordict: TensorDictBase) -> list[torch.Tensor]:
        """Return the features that it acts by; for `guided` also those without a flag.

        One [*B, F], or two of them where the weight of guidance is not 1.
        """
        found = self.features(tensordict)
        if self.guidance in (None, 1.0):
            return [found]
        return [
            found,
            torch.cat([found[..., :-1], torch.zeros_like(found[..., :1])], -1),
        ]

    def guided(self, outputs: Iterable[torch.Tensor]) -> torch.Tensor:
        """Return an output guided by the domain flag, of one for each acting feature.

        Args:
            outputs: what the network makes of `acting_features`, in their order.
        """
        flagged, *others = outputs
        if self.guidance is None or not others:
            return flagged
        (unflagged,) = others
        return unflagged + self.guidance * (flagged - unflagged)

    @property
    def explores(self) -> bool:
        """Whether TorchRL's exploration type asks for a random sample."""
        return interaction_type() in _SAMPLED

    def demonstrated(self, tensordict: TensorDictBase) -> torch.Tensor:
        """Return the demonstrated chunk, normalised, [B, H, A].

        Raises:
            DataError: the chunk is missing or of another shape than the policy's.
        """
        target: torch.Tensor = self.action_normalizer(read(tensordict, CHUNK))
        shape = (*tensordict.batch_size, self.chunk, self.action_size)
        if target.shape != shape:
            raise DataError(
                f"demonstrated chunks have shape {tuple(target.shape)}, the policy's "
                f"{shape}; build both with the same chunk length."
            )
        return target

    def act(self, tensordict: TensorDictBase, normalized: torch.Tensor) -> None:
        """Write the chunk and the action of a normalised chunk [B, H, A]."""
        raw = self.action_normalizer.inverse(normalized)
        if self.action_limit is not None:
            raw = raw.clamp(-self.action_limit, self.action_limit)
        tensordict.set(CHUNK, raw)
        tensordict.set(ACTION, raw)
