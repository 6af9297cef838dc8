"""Rows under rlco's keys as LeRobot's batches, by the checkpoint's own processors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from lerobot.configs import FeatureType, NormalizationMode
from lerobot.processor import NormalizerProcessorStep, TransitionKey
from lerobot.processor.converters import create_transition
from lerobot.utils.constants import (
    OBS_LANGUAGE_ATTENTION_MASK,
    OBS_LANGUAGE_TOKENS,
    OBS_STATE,
)
from numpy.typing import ArrayLike
from tensordict import TensorDictBase
from torch.nn import functional

from rlco.errors import CheckpointError, ConfigError, DataError
from rlco.keys import IMAGE, INSTRUCTION_ID, STATE
from rlco.policies.nets.encoder import read

#: What each of LeRobot's normalisations needs to know.
_NEEDED = {
    NormalizationMode.MEAN_STD: ("mean", "std"),
    NormalizationMode.MIN_MAX: ("min", "max"),
    NormalizationMode.QUANTILES: ("q01", "q99"),
    NormalizationMode.QUANTILE10: ("q10", "q90"),
    NormalizationMode.IDENTITY: (),
}
Stats = dict[str, dict[str, torch.Tensor]]


class LeRobotInputs:
    """A checkpoint's processors, for rows of rlco.

    Args:
        config: the checkpoint's configuration.
        preprocessor: LeRobot's pipeline from raw observations to the model's input.
        postprocessor: LeRobot's pipeline from the model's actions to raw ones.
        instructions: texts in the order of their ids.
        camera: the checkpoint's camera that sees what rlco's images show; None where
            it has one.

    Raises:
        ConfigError: no such camera, or several and none named; no instructions.
    """

    def __init__(
        self,
        config: Any,
        preprocessor: Any,
        postprocessor: Any,
        *,
        instructions: Sequence[str],
        camera: str | None = None,
    ) -> None:
        if not instructions:
            raise ConfigError(["instructions=[] leaves the policy without a text"])
        self.preprocessor, self.postprocessor = preprocessor, postprocessor
        self.instructions = tuple(instructions)
        self.camera = camera_of(config, camera)
        _, height, width = config.image_features[self.camera].shape
        #: Height and width of the frames that the checkpoint was trained on [pixels].
        self.image_size: tuple[int, int] = (height, width)
        self.tokens: int = config.tokenizer_max_length
        #: Numbers of a state, where that is known.
        self.state_size = state_size_of(config, preprocessor)
        self._normalizer = normalizer(preprocessor)

    def observe(self, tensordict: TensorDictBase) -> dict[str, Any]:
        """Return the model's batch of B observations.

        Args:
            tensordict: raw state, image and instruction id, shape (B,).

        Raises:
            DataError: one is missing, or an id is of no instruction.
        """
        ids = read(tensordict, INSTRUCTION_ID).tolist()
        if ids and not 0 <= min(ids) <= max(ids) < len(self.instructions):
            raise DataError(
                f"instruction ids go from {min(ids)} to {max(ids)}, but the policy "
                f"knows {len(self.instructions)} instructions; give all of them."
            )
        batch = {
            OBS_STATE: read(tensordict, STATE).float(),
            self.camera: read(tensordict, IMAGE).float() / 255,
            "task": [self.instructions[i] for i in ids],
        }
        out: dict[str, Any] = self.preprocessor(batch)
        # One length for all batches, so that their prefixes can be stored together.
        for key in (OBS_LANGUAGE_TOKENS, OBS_LANGUAGE_ATTENTION_MASK):
            out[key] = functional.pad(out[key], (0, self.tokens - out[key].shape[1]))
        return out

    def normalize(self, actions: torch.Tensor) -> torch.Tensor:
        """Return raw actions (..., A) in the normalised action space."""
        done = self._normalizer(create_transition(action=actions.float()))
        normalized: torch.Tensor = done[TransitionKey.ACTION]
        return normalized

    def unnormalize(self, actions: torch.Tensor) -> torch.Tensor:
        """Return raw actions of normalised ones (..., A), on the CPU."""
        raw: torch.Tensor = self.postprocessor(actions)
        return raw


def normalizer(preprocessor: Any) -> Any:
    """Return the pipeline's step that normalises.

    Raises:
        CheckpointError: it has none.
    """
    for step in preprocessor.steps:
        if isinstance(step, NormalizerProcessorStep):
            return step
    raise CheckpointError(
        "the checkpoint's preprocessor normalises nothing; write it anew with LeRobot "
        "0.6, which keeps the statistics in the processors."
    )


def state_size_of(config: Any, preprocessor: Any) -> int | None:
    """Return the dimension of the states that a checkpoint was trained on.

    The statistics tell: LeRobot fine-tunes with the state of the data, but leaves in
    ``config.json`` what the base had, whose models pad states anyway.
    """
    for value in (normalizer(preprocessor).stats or {}).get(OBS_STATE, {}).values():
        if np.ndim(value):
            return len(value)
    feature = config.robot_state_feature
    return None if feature is None else feature.shape[0]


def check_statistics(folder: object, config: Any, preprocessor: Any) -> None:
    """Check that states and actions are normalised as the configuration says.

    LeRobot hands on unchanged what it has no statistics for.

    Raises:
        CheckpointError: statistics are missing.
    """
    step = normalizer(preprocessor)
    for key, feature in {**config.input_features, **config.output_features}.items():
        mode = config.normalization_mapping.get(feature.type.value)
        if feature.type is FeatureType.VISUAL or mode is None:
            continue
        held = (step.stats or {}).get(key, {})
        missing = [name for name in _NEEDED[mode] if name not in held]
        if missing:
            raise CheckpointError(
                f"the checkpoint {str(folder)!r} normalises {key!r} by {mode.value} "
                f"but has no {' and '.join(missing)} of it, and LeRobot would use it "
                "raw; give stats=, those of the data that it was trained on (see "
                "dataset_stats)."
            )


def dataset_stats(**features: ArrayLike) -> Stats:
    """Return the statistics that LeRobot's processors may ask for, of whole data.

    Quantiles are those of all frames. LeRobot 0.6.1 stores the mean of its episodes'
    quantiles instead, which cuts off the tails where episodes differ.

    Args:
        **features: ``state`` and ``action``, each of shape (frames, numbers), raw.

    Example:
        >>> stats = dataset_stats(action=[[0.0], [1.0], [2.0]])
        >>> stats["action"]["mean"], stats["action"]["max"]
        (tensor([1.]), tensor([2.]))
    """
    names = {"state": OBS_STATE}
    return {names.get(k, k): _stats(np.asarray(v, float)) for k, v in features.items()}


def _stats(values: np.ndarray[Any, Any]) -> dict[str, torch.Tensor]:
    found = {
        "mean": values.mean(0),
        "std": values.std(0),
        "min": values.min(0),
        "max": values.max(0),
    }
    for name, q in {"q01": 0.01, "q10": 0.1, "q90": 0.9, "q99": 0.99}.items():
        found[name] = np.quantile(values, q, axis=0)
    return {k: torch.as_tensor(v, dtype=torch.float32) for k, v in found.items()}


def camera_of(config: Any, camera: str | None) -> str:
    """Return the camera of a checkpoint that is meant: this one, or its only one.

    Raises:
        ConfigError: it has no such camera, or several where none is named.
    """
    known: Mapping[str, Any] = config.image_features
    names = [name for name in known if ".empty_camera_" not in name]
    if camera is None and len(names) == 1:
        return names[0]
    if camera not in names:
        raise ConfigError(
            [
                f"camera={camera!r} is not the checkpoint's one; its cameras are "
                f"{', '.join(names) or 'none'}: name the one that sees what the "
                "images show, the others stay empty"
            ]
        )
    return camera
