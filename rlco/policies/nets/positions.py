"""Positions of named things relative to the tool, read from an encoder's features."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import nn
from torch.nn import functional

from rlco.errors import DataError

#: Positions that vary less than this are not magnified further [m].
LEAST_STD = 0.01
#: Error beyond which the loss grows linearly, in units of a label's deviation.
HUBER = 0.1
#: Units of the layer between features and positions.
HIDDEN = 128


def tool_axes(
    state_names: Sequence[str], environment_state_names: Sequence[str]
) -> list[int | None]:
    """Return which number of the state each position is relative to.

    ``cube.x`` is relative to ``tool.x``, and likewise for y and z. What is no position
    along an axis of the tool's (an opening, say) stays as it is: None.

    Example:
        >>> tool_axes(["tool.x", "tool.y"], ["cube.y", "drawer.opening"])
        [1, None]
    """
    index = {name: number for number, name in enumerate(state_names)}
    return [
        index.get(f"tool.{name.rpartition('.')[2]}") for name in environment_state_names
    ]


def relative_positions(
    state: torch.Tensor,
    environment_state: torch.Tensor,
    axes: Sequence[int | None],
) -> torch.Tensor:
    """Return positions relative to the tool [*B, E], along the base's axes [m].

    Args:
        state: state of the robot [*B, S], with the tool's position [m].
        environment_state: positions [*B, E] in the same frame [m].
        axes: see `tool_axes`.

    Example:
        >>> relative_positions(torch.tensor([0.5, 0.1]), torch.tensor([0.3, 0.7]),
        ...                    [1, None])
        tensor([0.2000, 0.7000])
    """
    moved = [
        column if axis is None else column - state[..., axis]
        for column, axis in zip(environment_state.unbind(-1), axes, strict=True)
    ]
    return torch.stack(moved, -1)


class PositionHead(nn.Module):
    """A small perceptron that reads positions from images' features and the state.

    It gives an encoder something to learn that simulators know for nothing (positions
    as auxiliary targets: Levine et al., arXiv 1504.00702). It is no part of a policy:
    labels are absent at run time.

    Args:
        features: dimension F of the images' features.
        state_size: dimension S of the robot's state.
        positions: numbers E to predict.

    Example:
        >>> head = PositionHead(16, state_size=7, positions=4)
        >>> head.set_normalization(torch.rand(8, 7), torch.rand(8, 4))
        >>> head(torch.zeros(5, 16), torch.rand(5, 7)).shape
        torch.Size([5, 4])
    """

    state_mean: torch.Tensor
    state_std: torch.Tensor
    mean: torch.Tensor
    std: torch.Tensor

    def __init__(self, features: int, state_size: int, positions: int) -> None:
        super().__init__()
        for prefix, size in (("state_", state_size), ("", positions)):
            self.register_buffer(f"{prefix}mean", torch.zeros(size))
            self.register_buffer(f"{prefix}std", torch.ones(size))
        self.network = nn.Sequential(
            nn.Linear(features + state_size, HIDDEN),
            nn.SiLU(),
            nn.Linear(HIDDEN, positions),
        )

    def set_normalization(self, state: torch.Tensor, positions: torch.Tensor) -> None:
        """Fix mean and deviation, once, from states [M, S] and positions [M, E].

        Raises:
            DataError: fewer than two rows.
        """
        if len(positions) < 2:
            raise DataError(
                f"{len(positions)} labelled scenes have no deviation; give 2 or more."
            )
        self.state_mean.copy_(state.mean(0))
        self.state_std.copy_(state.std(0).clamp_min(LEAST_STD))
        self.mean.copy_(positions.mean(0))
        self.std.copy_(positions.std(0).clamp_min(LEAST_STD))

    def _standard(self, features: torch.Tensor, state: torch.Tensor) -> torch.Tensor:
        state = (state - self.state_mean) / self.state_std
        found: torch.Tensor = self.network(torch.cat([features, state], -1))
        return found

    def forward(self, features: torch.Tensor, state: torch.Tensor) -> torch.Tensor:
        """Return the predicted positions [*B, E] [m]."""
        return self._standard(features, state) * self.std + self.mean

    def loss(
        self, features: torch.Tensor, state: torch.Tensor, positions: torch.Tensor
    ) -> torch.Tensor:
        """Return the mean Huber loss of the standardised positions, a scalar.

        Args:
            features: of images [*B, F].
            state: of the robot [*B, S].
            positions: the true ones [*B, E] [m].
        """
        wanted = (positions - self.mean) / self.std
        return (
            functional.huber_loss(self._standard(features, state), wanted, delta=HUBER)
            / HUBER
        )
