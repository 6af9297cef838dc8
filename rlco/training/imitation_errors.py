"""How far a policy is from demonstrations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rlco import keys

ROWS = 256  # of demonstrations with images that are evaluated at once


class ImitationErrors(NamedTuple):
    """How far a policy is from the demonstrations of a data set.

    Attributes:
        path: The data set's folder.
        frames: How many frames were compared.
        loss: The policy's own imitation loss a control step.
        actions: Mean absolute difference of each action number, by its name, in the
            data's own unit.
    """

    path: Path
    frames: int
    loss: float
    actions: dict[str, float]


def imitation_error(policy: Any, frames: TensorDictBase) -> float:
    """Return the mean imitation loss a step on demonstrations, padding left out.

    Args:
        policy: Offers ``imitation_loss``.
        frames: Observations, chunks and ``action_is_pad``, batch size (B,).
    """
    # All images at once would need gigabytes inside a network.
    seeing = any(map(keys.is_image, policy.in_keys))
    parts = frames.split(ROWS) if seeing else [frames]
    with torch.no_grad():
        steps = torch.cat([policy.imitation_loss(part) for part in parts])
    return float(steps[~frames[keys.IS_PAD]].mean())


def fixed_imitation_error(policy: Any, frames: TensorDictBase) -> float:
    """Return `imitation_error` with the same random numbers at each call.

    The loss of token and flow policies draws noise. Measured like this it changes with
    the policy alone, and training goes on as if nothing had been measured.
    """
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return imitation_error(policy, frames)


def likely_chunks(policy: Any, frames: TensorDictBase) -> torch.Tensor:
    """Return a policy's most likely chunk at each frame, raw units, (B, chunk, A).

    Computed in parts, and always with the same random numbers, where it takes any:
    training goes on as if nothing had been asked.

    Args:
        policy: Writes the chunk.
        frames: Observations, batch size (B,).
    """
    # Of images that a fixed encoder has read, features are left.
    present = frames.keys(include_nested=True, leaves_only=True)
    wanted = (*policy.in_keys, keys.IMAGE_FEATURES)
    read = frames.select(*(key for key in wanted if key in present))
    with (
        torch.random.fork_rng(),
        torch.no_grad(),
        set_exploration_type(ExplorationType.DETERMINISTIC),
    ):
        torch.manual_seed(0)
        return torch.cat(
            [policy(part.clone())[keys.CHUNK] for part in read.split(ROWS)]
        )


def action_error(policy: Any, frames: TensorDictBase) -> torch.Tensor:
    """Return the mean absolute error of each action number, raw units, shape (A,).

    The policy's most likely actions are compared with the demonstrated ones, over all
    steps of all chunks, padding left out.

    Args:
        policy: Writes the chunk.
        frames: As of `imitation_error`.
    """
    error = (likely_chunks(policy, frames) - frames[keys.CHUNK]).abs()
    mean: torch.Tensor = error[~frames[keys.IS_PAD]].mean(0)
    return mean


def imitation_errors(
    policy: Any, sets: Mapping[str, Any], action_names: Sequence[str]
) -> dict[str, ImitationErrors]:
    """Return how far a policy is from each data set, by the data sets' names.

    Args:
        policy: A policy of this package.
        sets: What `rlco.data.load_demos` returns, by a name; None is left out.
        action_names: Names of the action numbers.
    """
    found = {}
    for name, demos in sets.items():
        if demos is None:
            continue
        frames = demos.frames()
        errors = action_error(policy, frames).tolist()
        found[name] = ImitationErrors(
            demos.meta.path,
            len(frames),
            fixed_imitation_error(policy, frames),
            dict(zip(action_names, errors, strict=True)),
        )
    return found
