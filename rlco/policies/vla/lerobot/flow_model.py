"""What rlco asks of LeRobot's flow-matching models, one file an answer."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Protocol

import torch
from torch import nn

from rlco.errors import CheckpointError, ConfigError
from rlco.policies.densities.flow_chain import Velocity
from rlco.policies.vla.prefix_cache import Prefix

Batch = Mapping[str, Any]

CHECKPOINTING = (
    "gradient checkpointing leaves out the keys and values that the action expert "
    "attends to, so that log-probabilities would ignore images and text; set "
    "gradient_checkpointing=false in the checkpoint's config.json (imitation alone: "
    "lerobot-train)"
)


class FlowModel(Protocol):
    """A LeRobot policy in its two halves.

    Attributes:
        policy: LeRobot's own policy, unchanged.
        model: its network, which both models call ``model`` and denoise by the same
            calls.
        hidden_size: width of the expert's last layer.
        summary_size: width W of a prefix's summary.
        steps: denoising steps of the checkpoint's own sampling.
        steps_option: their name in LeRobot's configuration.
    """

    policy: Any
    model: Any
    hidden_size: int
    summary_size: int
    steps: int
    steps_option: ClassVar[str]

    def prefix(self, batch: Batch) -> Prefix:
        """Pass images and text, processed by LeRobot, through the language model."""

    def velocity(
        self, prefix: Prefix, x: torch.Tensor, time: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return velocities and the expert's last layer, (B, H, width), (B, H, E).

        Args:
            prefix: of the B observations.
            x: noisy actions with padded numbers, shape (B, H, width).
            time: 1 is noise, 0 is action, shape (B,).
        """
        with captured_input(self.model.action_out_proj) as captured:
            velocity = self.model.denoise_step(
                prefix_pad_masks=prefix.mask,
                past_key_values=prefix.cache(),
                x_t=x,
                timestep=time,
            )
        return velocity, captured[0]

    def prefix_modules(self) -> list[nn.Module]:
        """Return what ``prefix`` passes through."""

    def unused_modules(self) -> list[nn.Module]:
        """Return what neither half passes through."""

    def gradient_checkpointing(self) -> bool:
        """Return whether the model drops activations, and with them its cache."""


def velocity_given(model: FlowModel, prefix: Prefix) -> Velocity:
    """Return the flow's velocity at points (B, ..., H, width) of B observations."""
    repeated = {1: prefix}

    def velocity(
        x: torch.Tensor, time: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        shape = x.shape[:-2]
        points, times = x.flatten(0, -3), time.expand(shape).flatten()
        each = len(points) // shape[0]
        if each not in repeated:
            repeated[each] = prefix.repeat(each)
        v, state = model.velocity(repeated[each], points, times.float())
        return v.view(x.shape), state.view(*x.shape[:-1], -1)

    return velocity


@contextlib.contextmanager
def captured_input(module: nn.Module) -> Iterator[list[torch.Tensor]]:
    """Collect what a module is called with, in the order of its calls.

    Example:
        >>> layer = nn.Linear(2, 1)
        >>> with captured_input(layer) as captured:
        ...     out = layer(torch.ones(3, 2))
        >>> captured[0].shape
        torch.Size([3, 2])
    """
    captured: list[torch.Tensor] = []
    handle = module.register_forward_pre_hook(lambda _, x: captured.append(x[0]))
    try:
        yield captured
    finally:
        handle.remove()


def check_trainable(model: FlowModel) -> None:
    """Check that log-probabilities can be computed at all.

    Raises:
        ConfigError: gradient checkpointing is on.
    """
    if model.gradient_checkpointing():
        raise ConfigError([CHECKPOINTING])


def refuse(folder: object, option: str, why: str) -> None:
    """Say that a checkpoint uses what rlco does not support.

    Raises:
        CheckpointError: always.
    """
    raise CheckpointError(
        f"the checkpoint {str(folder)!r} has {option}, {why}; train it with LeRobot's "
        "own commands, or switch that off in its config.json."
    )
