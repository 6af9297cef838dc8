"""ImitationLoss: a masked mean that padding cannot reach."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from loss_cases import demonstrations, gradients, make_networks
from torch import nn

from rlco.errors import ConfigError, DataError
from rlco.losses import ImitationLoss

BOTH = [True, False]


@pytest.mark.parametrize("functional", BOTH)
@pytest.mark.parametrize("imitation", ["mse", "nll"])
def test_it_is_the_mean_of_the_steps_that_are_not_padded(
    functional: bool, imitation: Any
) -> None:
    policy, _ = make_networks(imitation=imitation)
    td = demonstrations(4)
    steps = policy.imitation_loss(td)  # [4, 2], the last of the 8 padded
    assert steps.shape == (4, 2)
    expected = steps.flatten()[:7]
    mean = ImitationLoss(policy, functional=functional)(td)["loss_bc"]
    summed = ImitationLoss(policy, functional=functional, reduction="sum")(td)
    torch.testing.assert_close(mean, expected.sum() / 7)
    torch.testing.assert_close(summed["loss_bc"], expected.sum())


@pytest.mark.parametrize("imitation", ["mse", "nll"])
@pytest.mark.parametrize("content", [float("nan"), float("inf"), 1e30])
def test_padding_reaches_neither_value_nor_gradient(
    imitation: Any, content: float
) -> None:
    policy, _ = make_networks(imitation=imitation)
    loss, parameters = ImitationLoss(policy), list(policy.parameters())
    td = demonstrations(4)
    clean = loss(td)["loss_bc"]
    expected = gradients(parameters, clean)
    td["vla_action", "chunk"][-1, -1] = content
    found = loss(td)["loss_bc"]
    assert torch.equal(found, clean)
    for a, b in zip(gradients(parameters, found), expected, strict=True):
        assert torch.equal(a, b)
    # The input keeps what it held.
    assert not torch.equal(td["vla_action", "chunk"][-1, -1], torch.zeros(2))


def test_a_batch_of_padding_alone_gives_zero_and_no_gradient() -> None:
    policy, _ = make_networks()
    td = demonstrations(4)
    td["action_is_pad"][:] = True
    td["vla_action", "chunk"][:] = float("nan")
    loss = ImitationLoss(policy)(td)["loss_bc"]
    assert loss == 0
    for gradient in gradients(list(policy.parameters()), loss):
        assert torch.equal(gradient, torch.zeros_like(gradient))


def test_without_a_mask_nothing_is_padded() -> None:
    policy, _ = make_networks()
    td = demonstrations(4).exclude("action_is_pad")
    loss = ImitationLoss(policy)(td)["loss_bc"]
    torch.testing.assert_close(loss, policy.imitation_loss(td).mean())


def test_two_batch_dimensions_give_the_same_loss() -> None:
    policy, _ = make_networks()
    td = demonstrations(6)
    loss = ImitationLoss(policy)
    torch.testing.assert_close(loss(td.reshape(2, 3))["loss_bc"], loss(td)["loss_bc"])


@pytest.mark.parametrize("functional", BOTH)
def test_keys_can_be_set_and_the_keyword_call_works(functional: bool) -> None:
    policy, _ = make_networks()
    loss, td = ImitationLoss(policy, functional=functional), demonstrations(4)
    expected = loss(td)["loss_bc"]
    found = loss(
        **{"_".join(k) if isinstance(k, tuple) else k: td[k] for k in loss.in_keys}
    )
    assert torch.equal(found, expected)
    loss.set_keys(chunk="expert", is_pad="pad")
    td["expert"] = td["vla_action", "chunk"]
    td["pad"] = td["action_is_pad"]
    td = td.exclude("vla_action", "action_is_pad")
    assert torch.equal(loss(td)["loss_bc"], expected)


@pytest.mark.parametrize("functional", BOTH)
def test_reset_parameters(functional: bool) -> None:
    policy, _ = make_networks()
    loss = ImitationLoss(policy, functional=functional)
    before = policy.network.head.weight.detach().clone()
    loss.reset_parameters_recursive()
    assert not torch.equal(policy.network.head.weight, before)


@pytest.mark.slow
def test_compiles_as_one_graph() -> None:
    policy, _ = make_networks()
    loss, td = ImitationLoss(policy), demonstrations(4)
    torch.compiler.reset()
    compiled = torch.compile(loss, fullgraph=True, backend="eager")
    torch.testing.assert_close(compiled(td)["loss_bc"], loss(td)["loss_bc"])


def test_wrong_use_is_refused() -> None:
    policy, _ = make_networks()
    with pytest.raises(ConfigError, match=r"Linear has no imitation_loss.*BCLoss"):
        ImitationLoss(nn.Linear(2, 2))
    reduction: Any = "none"
    with pytest.raises(ConfigError, match="unknown reduction 'none'"):
        ImitationLoss(policy, reduction=reduction)
    loss = ImitationLoss(policy)
    with pytest.raises(DataError, match=r"no \('vla_action', 'chunk'\) to imitate"):
        loss(demonstrations(4).exclude("vla_action"))
    td = demonstrations(4)
    td["action_is_pad"] = td["action_is_pad"][:, :1]
    with pytest.raises(DataError, match=r"has shape \(4, 1\)"):
        loss(td)
