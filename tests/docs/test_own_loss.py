"""The loss that the documentation writes works, and does what the page says."""

from __future__ import annotations

import copy

import pytest
import torch
from loss_cases import gradients, make_batch, make_networks, total
from my_loss import HuberLoss
from pages import run_python
from tensordict import TensorDict
from torchrl.objectives import ClipPPOLoss

from rlco.errors import DataError
from rlco.losses import CoTrainingLoss, gradient_agreement


def test_its_gradient_is_added_to_that_of_ppo() -> None:
    policy, value = make_networks()
    ppo = ClipPPOLoss(policy, value, entropy_bonus=False)
    huber = HuberLoss(policy)
    batch = make_batch(policy)
    parameters = list(policy.parameters())
    apart = [
        one + 0.3 * other
        for one, other in zip(
            gradients(parameters, total(ppo(batch["sim"]))),
            gradients(parameters, huber(batch["real"])["loss_huber"]),
            strict=True,
        )
    ]
    loss = CoTrainingLoss(ppo, huber, real_coeff=0.3)
    out = loss(batch)
    assert "loss_huber_real" in out
    for found, expected in zip(gradients(parameters, total(out)), apart, strict=True):
        torch.testing.assert_close(found, expected)
    assert gradient_agreement(loss, batch)["grad_norm_real"] > 0


def test_its_value_worked_out_by_hand() -> None:
    policy, _ = make_networks()
    with torch.no_grad():  # whatever is seen, it answers 0
        policy.network.head.weight.zero_()
        policy.network.head.bias.zero_()
    rows = make_batch(policy)["real"][:1]
    # One step of two numbers, the other is padding. Of 0.5 the loss is
    # 0.1 * (0.5 - 0.05) = 0.045, of 0.02 it is 0.5 * 0.02 ** 2 = 0.0002.
    chunk = torch.tensor([[[0.5, 0.02], [9.0, 9.0]]])
    rows["vla_action", "chunk"] = chunk
    rows["action_is_pad"] = torch.tensor([[False, True]])
    out = HuberLoss(policy)(rows)["loss_huber"]
    torch.testing.assert_close(out, torch.tensor((0.045 + 0.0002) / 2))


def test_a_copy_trains_one_actor() -> None:
    policy, value = make_networks()
    loss = copy.deepcopy(CoTrainingLoss(ClipPPOLoss(policy, value), HuberLoss(policy)))
    before = [p.detach().clone() for p in loss.shared_parameters()]
    batch = make_batch(policy)
    optimizer = torch.optim.SGD(loss.parameters(), lr=0.1)
    loss(batch)["loss_huber_real"].backward()
    optimizer.step()
    after = loss.sim_loss.actor_network_params.values(True, True)
    trained = [
        p for p in after if isinstance(p, torch.nn.Parameter) and p.requires_grad
    ]
    assert any(not torch.equal(a, b) for a, b in zip(trained, before, strict=True))


def test_an_actor_of_torchrl_is_anchored_by_its_own_imitation_loss() -> None:
    made = run_python("own_loss.md", "## With your own actor")
    loss = made["loss"]
    torch.manual_seed(0)
    rollout = made["actor"](TensorDict({"observation": torch.randn(4, 5, 3)}, [4, 5]))
    rollout = rollout.detach()
    rollout["advantage"] = rollout["value_target"] = torch.randn(4, 5, 1)
    frames = TensorDict(
        {
            "observation": {"state": torch.randn(16, 3)},
            "action": torch.full((16, 1), 0.5),
        },
        [16],
    )
    real = made["real_rows"](frames)
    found = made["strength"](rollout, real)
    assert found["anchor_strength_low"] > 0
    out = loss(TensorDict({"sim": rollout.reshape(-1), "real": real}))
    assert out["loss_bc_real"].requires_grad
    del real["action"]
    with pytest.raises(DataError, match="'real' has no 'action', which BCLoss reads"):
        loss(TensorDict({"sim": rollout.reshape(-1), "real": real}))
    # The demonstrations as they come: a TensorDict where the actor reads a tensor.
    with pytest.raises(DataError, match="has entries under 'observation'"):
        loss(TensorDict({"sim": rollout.reshape(-1), "real": frames}))
