"""How much of demonstrations a policy explains, and whether a probe parts domains."""

from __future__ import annotations

import pytest
import torch
from loss_cases import demonstrations, make_networks, observations

from rlco import keys
from rlco.training.alignment import explained, features, pooled, probe_accuracy


def test_what_is_explained_is_worked_out_by_hand() -> None:
    policy, _ = make_networks()
    policy.network.head.weight.data.zero_()
    policy.network.head.bias.data.copy_(torch.tensor([0.5, 0.0, 0.5, 0.0]))
    frames = demonstrations(3)
    # The second number is never moved; the last step of the last chunk is padding.
    frames[keys.CHUNK] = torch.tensor(
        [[[0.0, 0.2], [1.0, 0.2]], [[0.0, 0.2], [1.0, 0.2]], [[0.5, 0.2], [9.0, 0.2]]]
    )
    found = explained(policy, frames)
    # Always 0.5, the mean: every squared distance is 0.25 but that of 0.5 itself.
    assert found.error.tolist() == pytest.approx([4 * 0.25, 0.0])
    assert found.total.tolist() == pytest.approx([4 * 0.25, 0.0])
    assert found.share == pytest.approx(0.0)
    assert found.shares() == [pytest.approx(0.0), None]
    policy.network.head.bias.data.copy_(torch.tensor([0.0, 0.0, 1.0, 0.0]))
    better = explained(policy, frames)  # right but for 0.5 in the last chunk
    assert better.share == pytest.approx(1 - 0.25 / 1.0)
    assert pooled([found, better]).share == pytest.approx(1 - 1.25 / 2.0)


def test_features_are_what_the_last_layer_turns_into_actions() -> None:
    policy, _ = make_networks()
    frames = observations(5)
    found = features(policy, frames)
    assert found.shape == (5, 8)
    actions = policy.network(policy.encoder(frames))
    torch.testing.assert_close(policy.network.head(found), actions)
    assert not policy.network.head._forward_hooks


def test_a_probe_is_as_right_as_two_gaussians_allow_whatever_their_numbers() -> None:
    def drawn(n: int, place: float) -> torch.Tensor:
        other = 1000.0 + torch.randn(n, 3)  # says nothing, and is far from 0
        return torch.cat([place + torch.randn(n, 1), other], 1)

    train = drawn(4000, 0.0), drawn(400, 2.0)
    # Two deviations apart, cut in the middle: Phi(1) = 0.841.
    assert probe_accuracy(train, (drawn(4000, 0.0), drawn(400, 2.0))) == pytest.approx(
        0.841, abs=0.02
    )
    alike = drawn(4000, 0.0), drawn(400, 0.0)
    held_out = drawn(4000, 0.0), drawn(400, 0.0)
    assert probe_accuracy(alike, held_out) == pytest.approx(0.5, abs=0.06)
