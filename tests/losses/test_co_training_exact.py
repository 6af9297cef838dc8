"""The gradient of CoTrainingLoss is that of its two losses, weighted: to 1e-6."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from loss_cases import (
    demonstrations,
    gradients,
    largest_error,
    make_batch,
    make_networks,
    rollout,
    total,
)
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.modules import (
    IndependentNormal,
    NormalParamExtractor,
    ProbabilisticActor,
)
from torchrl.objectives import BCLoss, ClipPPOLoss, KLPENPPOLoss, PPOLoss

from rlco.losses import CoTrainingLoss, ImitationLoss
from rlco.policies import GaussianPolicy, ValueNetwork

BOTH = [True, False]


@pytest.mark.parametrize("ppo_functional", BOTH)
@pytest.mark.parametrize("real_functional", BOTH)
@pytest.mark.parametrize("imitation", ["mse", "nll"])
@pytest.mark.parametrize("double", BOTH)
def test_gradient_is_ppo_plus_beta_times_imitation(
    ppo_functional: bool, real_functional: bool, imitation: Any, double: bool
) -> None:
    policy, value = make_networks(imitation=imitation, learn_std=True)
    batch = make_batch(policy)
    if double:
        policy, value, batch = policy.double(), value.double(), batch.double()
        batch["sim", "instruction_id"] = batch["sim", "instruction_id"].long()
        batch["real", "instruction_id"] = batch["real", "instruction_id"].long()
        batch["real", "action_is_pad"] = batch["real", "action_is_pad"].bool()
    parameters = [*policy.parameters(), *value.parameters()]
    beta = 0.3

    ppo = ClipPPOLoss(policy, value, functional=ppo_functional)
    imitate = ImitationLoss(policy, functional=real_functional)
    alone = gradients(parameters, total(ppo(batch["sim"])))
    anchor = gradients(parameters, imitate(batch["real"])["loss_bc"])
    loss = CoTrainingLoss(ppo, imitate, real_coeff=beta)
    together = gradients(parameters, total(loss(batch)))

    expected = [a + beta * b for a, b in zip(alone, anchor, strict=True)]
    assert largest_error(together, expected) < 1e-6


@pytest.mark.parametrize("functional", BOTH)
@pytest.mark.parametrize("with_loss", BOTH)
def test_beta_zero_is_ppo_alone_bit_for_bit_and_needs_no_demonstrations(
    functional: bool, with_loss: bool
) -> None:
    policy, value = make_networks()
    parameters = [*policy.parameters(), *value.parameters()]
    batch = TensorDict({"sim": rollout(policy, 6)})
    ppo = ClipPPOLoss(policy, value, functional=functional)
    alone = gradients(parameters, total(ppo(batch["sim"])))
    real = ImitationLoss(policy, functional=functional) if with_loss else None
    loss = CoTrainingLoss(ppo, real, real_coeff=0)
    together = gradients(parameters, total(loss(batch)))
    assert all(torch.equal(a, b) for a, b in zip(together, alone, strict=True))
    assert not any(name.endswith("_real") for name in loss.out_keys)
    assert set(loss(batch).keys()) == set(loss.out_keys)


def test_alpha_zero_is_imitation_of_real_data_alone() -> None:
    policy, _ = make_networks()
    batch = TensorDict({"real": demonstrations(4)})
    loss = CoTrainingLoss(None, ImitationLoss(policy), sim_coeff=0, real_coeff=1)
    out = loss(batch)
    assert list(out.keys()) == ["loss_bc_real"]
    alone = ImitationLoss(policy)(batch["real"])["loss_bc"]
    assert torch.equal(out["loss_bc_real"], alone)


def pencil_policy() -> GaussianPolicy:
    """Return a policy whose mean is its head's bias b = 0, H = A = 1, std 0.2."""
    policy = GaussianPolicy(1, chunk=1, action_size=1, hidden=(4,))
    policy.network.head.weight.data.zero_()
    return policy


def pencil_demos(target: float) -> TensorDict:
    content = {
        "observation": {"state": torch.ones(3, 1)},
        "vla_action": {"chunk": torch.full((3, 1, 1), target)},
    }
    return TensorDict(content, [3])


def bias_gradient(
    policy: GaussianPolicy, loss: CoTrainingLoss, batch: TensorDict
) -> float:
    (gradient,) = gradients([policy.network.head.bias], total(loss(batch)))
    return float(gradient)


def test_removing_a_term_of_stage_one_changes_the_gradient_by_that_term() -> None:
    # l(b) = (b - target)^2, dl/db = 2 (0 - target): sim (target 1) -2, real (-.5) 1.
    # alpha = .75: .75 * -2 + .25 * 1 = -1.25; without real -1.5, without sim .25.
    batch = TensorDict({"sim": pencil_demos(1.0), "real": pencil_demos(-0.5)})
    found = []
    for sim_coeff, real_coeff in ((0.75, 0.25), (0.75, 0.0), (0.0, 0.25)):
        policy = pencil_policy()
        loss = CoTrainingLoss(
            ImitationLoss(policy),
            ImitationLoss(policy),
            sim_coeff=sim_coeff,
            real_coeff=real_coeff,
        )
        found.append(bias_gradient(policy, loss, batch))
    assert found == pytest.approx([-1.25, -1.5, 0.25], abs=1e-6)


def test_removing_a_term_of_stage_two_changes_the_gradient_by_that_term() -> None:
    # At ratio 1, d loss_objective / db = -A d log p / db = -A (x - b) / std^2, with
    # A = 2, x = .1, std = .2: -2 * 2.5 = -5. The anchor: beta * 2 (0 + .5) = .2.
    policy = pencil_policy()
    sim = TensorDict({"observation": {"state": torch.ones(3, 1)}}, [3])
    sim["vla_action", "sample"] = torch.full((3, 1, 1), 0.1)
    sim["vla_action", "log_probs"] = (
        policy.get_dist(sim).log_prob(sim["vla_action", "sample"]).detach()
    )
    sim["advantage"] = torch.full((3, 1), 2.0)
    batch = TensorDict({"sim": sim, "real": pencil_demos(-0.5)})
    found = []
    for sim_coeff, real_coeff in ((1.0, 0.2), (1.0, 0.0), (0.0, 0.2)):
        loss = CoTrainingLoss(
            ClipPPOLoss(policy, None, entropy_bonus=False),
            ImitationLoss(policy),
            sim_coeff=sim_coeff,
            real_coeff=real_coeff,
        )
        found.append(bias_gradient(policy, loss, batch))
    assert found == pytest.approx([-4.8, -5.0, 0.2], abs=1e-5)


def test_the_number_of_rows_never_changes_the_weight_of_a_term() -> None:
    policy, value = make_networks()
    batch = make_batch(policy)
    loss = CoTrainingLoss(ClipPPOLoss(policy, value), ImitationLoss(policy))
    once = loss(batch)
    batch["real"] = torch.cat([batch["real"]] * 5)
    five_times = loss(batch)
    torch.testing.assert_close(five_times["loss_bc_real"], once["loss_bc_real"])
    assert torch.equal(five_times["loss_objective"], once["loss_objective"])


def torchrl_actor() -> tuple[ProbabilisticActor, ValueNetwork]:
    """Return an actor of TorchRL's own on the state, and a critic."""
    net = nn.Sequential(nn.Linear(3, 8), nn.Tanh(), nn.Linear(8, 4))
    module = TensorDictModule(
        nn.Sequential(net, NormalParamExtractor()),
        in_keys=[("observation", "state")],
        out_keys=["loc", "scale"],
    )
    actor = ProbabilisticActor(
        module,
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )
    return actor, ValueNetwork(3, hidden=(8,))


def torchrl_batch(actor: ProbabilisticActor) -> TensorDict:
    sim = TensorDict({"observation": {"state": torch.randn(6, 3)}}, [6])
    with torch.no_grad():
        sim = actor(sim)
    for name in ("advantage", "value_target", "state_value"):
        sim[name] = torch.randn(6, 1)
    real = TensorDict({"observation": {"state": torch.randn(4, 3)}}, [4])
    real["action"] = torch.rand(4, 2)
    return TensorDict({"sim": sim, "real": real})


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        (ClipPPOLoss, {"functional": True}),
        (ClipPPOLoss, {"functional": False, "clip_value": 0.2}),
        (PPOLoss, {"functional": True, "entropy_bonus": False}),
        (PPOLoss, {"functional": False}),
        (KLPENPPOLoss, {"functional": True}),
        (KLPENPPOLoss, {"functional": False}),
    ],
)
def test_torchrl_losses_on_a_torchrl_actor(kind: Any, options: Any) -> None:
    actor, value = torchrl_actor()
    batch = torchrl_batch(actor)
    ppo, imitate = kind(actor, value, **options), BCLoss(actor)
    parameters = [*actor.parameters(), *value.parameters()]
    alone = gradients(parameters, total(ppo(batch["sim"])))
    anchor = gradients(parameters, imitate(batch["real"])["loss_bc"])
    ppo.reset()  # KLPENPPOLoss has adapted its coefficient.
    loss = CoTrainingLoss(ppo, imitate, real_coeff=0.3)
    out = loss(batch)
    expected = [a + 0.3 * b for a, b in zip(alone, anchor, strict=True)]
    assert largest_error(gradients(parameters, total(out)), expected) < 1e-6
    assert set(out.keys()) == set(loss.out_keys)
