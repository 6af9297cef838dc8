"""Positions relative to the tool, and what reads them from features."""

from __future__ import annotations

import pytest
import torch

from rlco.errors import DataError
from rlco.physics.tasks.named_task import named_task
from rlco.policies.nets.positions import PositionHead, relative_positions, tool_axes


def test_each_position_is_relative_to_the_tool_along_its_own_axis() -> None:
    axes = tool_axes(["tool.x", "tool.y", "tool.z"], ["cup.z", "cup.x", "lid.angle"])
    state = torch.tensor([[1.0, 2.0, 3.0], [0.0, 0.0, 0.5]])
    environment = torch.tensor([[3.5, 0.0, 0.7], [0.5, 0.25, 0.7]])
    expected = torch.tensor([[0.5, -1.0, 0.7], [0.0, 0.25, 0.7]])
    torch.testing.assert_close(relative_positions(state, environment, axes), expected)


@pytest.mark.parametrize("name", ["push_cube", "pick_and_place", "open_drawer"])
def test_every_number_of_the_tasks_is_relative_to_the_tool(name: str) -> None:
    task = named_task(name)
    axes = tool_axes(task.state_names, task.environment_state_names)
    for axis, of in zip(axes, task.environment_state_names, strict=True):
        assert axis is not None
        assert task.state_names[axis] == f"tool.{of[-1]}"


def test_a_head_that_predicts_the_mean_has_the_huber_loss_of_a_standard_label() -> None:
    head = PositionHead(3, state_size=2, positions=1)
    positions = torch.tensor([[-0.2], [0.2]])
    head.set_normalization(torch.rand(2, 2), positions)
    for parameter in head.parameters():
        torch.nn.init.zeros_(parameter)
    features, state = torch.rand(2, 3), torch.rand(2, 2)
    torch.testing.assert_close(head(features, state), torch.zeros(2, 1))
    # |label| = 1 / sqrt(2) deviations; Huber's loss beyond 0.1, over 0.1: |e| - 0.05.
    expected = torch.tensor(2**-0.5 - 0.05)
    torch.testing.assert_close(head.loss(features, state, positions), expected)


def test_one_scene_has_no_deviation() -> None:
    head = PositionHead(3, state_size=2, positions=1)
    with pytest.raises(DataError, match="give 2 or more"):
        head.set_normalization(torch.rand(1, 2), torch.rand(1, 1))
