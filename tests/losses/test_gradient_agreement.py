"""gradient_agreement: both norms, their ratio and cosine; nothing is touched."""

from __future__ import annotations

import math

import pytest
import torch
from loss_cases import gradients, make_batch, make_networks, total
from tensordict import TensorDict
from torchrl.objectives import ClipPPOLoss

from rlco.losses import CoTrainingLoss, ImitationLoss, gradient_agreement
from rlco.policies import GaussianPolicy


def test_by_hand() -> None:
    # One step of two numbers, mean = head bias (0, 0), l = mean_a (b_a - t_a)^2, so
    # dl/db = -t. Sim target (1, 0), real (.6, .8), coefficients .5 and .25:
    # |g_sim| = .5, |g_real| = .25 * 1, ratio .5, cosine .6.
    policy = GaussianPolicy(1, chunk=1, action_size=2, hidden=(4,))
    policy.network.head.weight.data.zero_()
    for name, parameter in policy.named_parameters():
        parameter.requires_grad_(name == "network.head.bias")

    def demos(target: list[float]) -> TensorDict:
        content = {
            "observation": {"state": torch.ones(1, 1)},
            "vla_action": {"chunk": torch.tensor([[target]])},
        }
        return TensorDict(content, [1])

    loss = CoTrainingLoss(
        ImitationLoss(policy), ImitationLoss(policy), sim_coeff=0.5, real_coeff=0.25
    )
    batch = TensorDict({"sim": demos([1.0, 0.0]), "real": demos([0.6, 0.8])})
    assert gradient_agreement(loss, batch) == pytest.approx(
        {
            "grad_norm_sim": 0.5,
            "grad_norm_real": 0.25,
            "grad_norm_ratio": 0.5,
            "grad_cosine": 0.6,
        }
    )


@pytest.mark.parametrize("sim_functional", [True, False])
@pytest.mark.parametrize("real_functional", [True, False])
def test_against_the_losses_alone_and_nothing_changes(
    sim_functional: bool, real_functional: bool
) -> None:
    policy, value = make_networks(learn_std=True)
    ppo = ClipPPOLoss(policy, value, functional=sim_functional)
    imitate = ImitationLoss(policy, functional=real_functional)
    batch = make_batch(policy)
    parameters = list(policy.parameters())
    sim = torch.cat(
        [g.flatten() for g in gradients(parameters, total(ppo(batch["sim"])))]
    )
    real = gradients(parameters, 0.3 * imitate(batch["real"])["loss_bc"])
    flat = torch.cat([g.flatten() for g in real])

    loss = CoTrainingLoss(ppo, imitate, real_coeff=0.3)
    state = {name: value.clone() for name, value in loss.state_dict().items()}
    random = torch.get_rng_state()
    with torch.no_grad():  # as in an evaluation block
        told = gradient_agreement(loss, batch)
    assert told["grad_norm_sim"] == pytest.approx(float(sim.norm()), rel=1e-5)
    assert told["grad_norm_real"] == pytest.approx(float(flat.norm()), rel=1e-5)
    cosine = float(torch.cosine_similarity(sim, flat, 0))
    assert told["grad_cosine"] == pytest.approx(cosine, abs=1e-5)

    assert all(parameter.grad is None for parameter in loss.parameters())
    assert torch.equal(torch.get_rng_state(), random)
    for name, old in loss.state_dict().items():
        assert torch.equal(old, state[name]), name


def test_a_term_that_is_switched_off_has_no_gradient() -> None:
    policy, value = make_networks()
    loss = CoTrainingLoss(ClipPPOLoss(policy, value), None, real_coeff=0)
    told = gradient_agreement(loss, make_batch(policy))
    assert told["grad_norm_sim"] > 0
    assert told["grad_norm_real"] == told["grad_norm_ratio"] == 0
    assert math.isnan(told["grad_cosine"])
