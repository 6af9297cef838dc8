"""CoTrainingLoss is a TorchRL LossModule like any other, on one actor."""

from __future__ import annotations

import pytest
import torch
from loss_cases import (
    assert_same_outputs,
    gradients,
    make_batch,
    make_networks,
    rollout,
    total,
)
from tensordict import TensorDict, TensorDictBase
from torchrl.objectives import ClipPPOLoss, SoftUpdate
from torchrl.objectives.utils import ValueEstimators

from rlco.errors import ConfigError, UnknownNameError
from rlco.losses import CoTrainingLoss, ImitationLoss
from rlco.policies import GaussianPolicy

FUNCTIONAL = [(True, True), (True, False), (False, True), (False, False)]
each_mode = pytest.mark.parametrize(("sim_functional", "real_functional"), FUNCTIONAL)


def make_loss(
    sim_functional: bool = True, real_functional: bool = True, **coefficients: float
) -> tuple[GaussianPolicy, CoTrainingLoss, TensorDictBase]:
    policy, value = make_networks()
    loss = CoTrainingLoss(
        ClipPPOLoss(policy, value, functional=sim_functional),
        ImitationLoss(policy, functional=real_functional),
        **coefficients,
    )
    return policy, loss, make_batch(policy)


def test_coefficients_are_scheduled_in_place_and_survive_to_and_the_state_dict() -> (
    None
):
    _, loss, batch = make_loss(real_coeff=0.2)
    unit = loss(batch)["loss_bc_real"] / 0.2
    buffer = loss.real_coeff
    loss.real_coeff = 0.5
    assert loss.real_coeff is buffer
    torch.testing.assert_close(loss(batch)["loss_bc_real"], 0.5 * unit)
    objective = loss(batch)["loss_objective"]
    loss.sim_coeff = 2.0
    torch.testing.assert_close(loss(batch)["loss_objective"], 2 * objective)
    loss.real_coeff = 0.0
    assert loss(batch)["loss_bc_real"] == 0
    loss.real_coeff = 0.5
    assert loss.double().real_coeff == 0.5
    assert loss.state_dict()["real_coeff"] == 0.5


def test_a_coefficient_fixed_at_zero_cannot_be_raised_later() -> None:
    _, loss, _ = make_loss(real_coeff=0)
    loss.real_coeff = 0.0
    with pytest.raises(ConfigError, match="real_coeff was fixed at 0"):
        loss.real_coeff = 0.1
    with pytest.raises(RuntimeError, match="Unexpected key"):
        loss.load_state_dict(make_loss(real_coeff=0.1)[1].state_dict())


def test_terms_are_differentiable_and_all_else_is_detached() -> None:
    policy, value = make_networks(learn_std=True)
    loss = CoTrainingLoss(ClipPPOLoss(policy, value), ImitationLoss(policy))
    batch = make_batch(policy)
    for name, value in loss(batch).items():
        assert value.requires_grad == name.startswith("loss_")
        assert name.startswith("loss_") or not name.startswith("loss")


def test_forward_leaves_its_input_alone() -> None:
    _, loss, batch = make_loss()
    before = batch.clone()
    loss(batch.lock_())
    assert set(batch.keys(True, True)) == set(before.keys(True, True))
    assert bool((batch == before).all())


@each_mode
def test_keyword_call_gives_what_the_tensordict_call_gives(
    sim_functional: bool, real_functional: bool
) -> None:
    _, loss, batch = make_loss(sim_functional, real_functional)
    expected = loss(batch)
    found = loss(**{"_".join(key): batch[key] for key in loss.in_keys})
    assert_same_outputs(
        TensorDict(dict(zip(loss.out_keys, found, strict=True))), expected
    )


def test_in_keys_suffice_and_name_the_advantage_but_nothing_of_the_next_step() -> None:
    _, loss, batch = make_loss()
    assert ("sim", "advantage") in loss.in_keys
    assert ("sim", "value_target") in loss.in_keys
    assert not any("next" in key for key in loss.in_keys)
    assert_same_outputs(loss(batch.select(*loss.in_keys)), loss(batch))


def test_select_out_keys() -> None:
    _, loss, batch = make_loss()
    expected = loss(batch)["loss_bc_real"]
    loss.select_out_keys("loss_bc_real")
    out = loss(batch)
    assert list(out.keys()) == ["loss_bc_real"]
    assert torch.equal(out["loss_bc_real"], expected)


def test_in_and_out_keys_can_be_set() -> None:
    _, loss, _ = make_loss()
    loss.in_keys, loss.out_keys = [("sim", "x")], ["loss_bc_real"]
    assert loss.in_keys == [("sim", "x")]
    assert loss.out_keys == ["loss_bc_real"]


def test_roots_can_be_renamed_and_reset() -> None:
    _, loss, batch = make_loss()
    expected = loss(batch)
    loss.set_keys(sim="simulation", real=("demos", "robot"))
    renamed = TensorDict(
        {"simulation": batch["sim"], "demos": {"robot": batch["real"]}}
    )
    assert_same_outputs(loss(renamed), expected)
    loss.set_keys(sim=None, real=None)
    assert_same_outputs(loss(batch), expected)


def test_other_keys_are_handed_to_the_sim_loss() -> None:
    _, loss, batch = make_loss()
    expected = loss(batch)
    loss.set_keys(advantage="adv", reward="r", done="d", terminated="t")
    batch["sim"].rename_key_("advantage", "adv")
    assert_same_outputs(loss(batch), expected)
    assert loss.sim_loss.tensor_keys.reward == "r"
    with pytest.raises(UnknownNameError, match="did you mean 'advantage'"):
        loss.set_keys(advantag="adv")


def test_value_estimator_is_the_sim_losss_and_runs_on_a_rollout() -> None:
    policy, loss, _ = make_loss()
    assert loss.make_value_estimator(ValueEstimators.GAE, gamma=0.5) is loss
    assert loss.value_estimator is loss.sim_loss.value_estimator
    td = rollout(policy, 1)
    td = td.exclude("advantage", "value_target", "state_value")
    td["next"] = td.select("observation", "instruction_id")
    td["next", "reward"] = torch.ones(1, 1)
    for name in ("done", "terminated"):
        td["next", name] = torch.ones(1, 1, dtype=torch.bool)
    td = loss.value_estimator(td.unsqueeze(0))
    # Terminated after one step: the target is the reward, whatever gamma is.
    torch.testing.assert_close(td["value_target"], torch.ones(1, 1, 1))


@each_mode
def test_reset_parameters_reaches_actor_and_critic(
    sim_functional: bool, real_functional: bool
) -> None:
    _, loss, _ = make_loss(sim_functional, real_functional)
    weights = [p for p in loss.parameters() if p.ndim > 1]
    before = [weight.clone() for weight in weights]
    loss.reset_parameters_recursive()
    assert len(weights) == 4
    for weight, old in zip(weights, before, strict=True):
        assert not torch.equal(weight, old)
    assert next(p for p in loss.parameters() if p.ndim > 1) is weights[0]


def test_target_parameters_are_updated_through_the_sim_loss() -> None:
    policy, value = make_networks()
    ppo = ClipPPOLoss(policy, value, delay_actor=True)
    loss = CoTrainingLoss(ppo, ImitationLoss(policy))
    updater = SoftUpdate(loss.sim_loss, eps=0.75)
    head = policy.network.head.weight
    old = head.detach().clone()
    with torch.no_grad():
        head.add_(1.0)
    updater.step()
    target = loss.sim_loss.target_actor_network_params["network", "head", "weight"]
    # Three quarters of the old and one of the new, which is old + 1.
    torch.testing.assert_close(target, old + 0.25)
    assert not any(p is target for p in loss.parameters())


def test_what_a_ppo_trainer_asks_for() -> None:
    policy, loss, _ = make_loss()
    assert loss.actor_network is policy
    assert loss.critic_network is loss.sim_loss.critic_network
    loss.set_keys(reward="reward", done="done", terminated="terminated")
    stage_one = CoTrainingLoss(ImitationLoss(policy), ImitationLoss(policy))
    assert stage_one.critic_network is None


@pytest.mark.slow
@pytest.mark.parametrize(
    "functional", [pytest.param(True, marks=pytest.mark.thorough), False]
)
def test_compiles_as_one_graph_with_the_same_gradients(functional: bool) -> None:
    policy, loss, batch = make_loss(functional, functional)
    parameters = list(policy.parameters())
    expected_out = loss(batch)
    expected = gradients(parameters, total(expected_out))
    torch.compiler.reset()
    compiled = torch.compile(loss, fullgraph=True, backend="eager")
    out = compiled(batch)
    assert_same_outputs(out, expected_out)
    found = gradients(parameters, total(out))
    for a, b in zip(found, expected, strict=True):
        torch.testing.assert_close(a, b)


@pytest.mark.parametrize("reduction", ["mean", "sum"])
def test_reductions_of_the_losses_are_kept(reduction: str) -> None:
    policy, value = make_networks()
    batch = make_batch(policy)
    ppo = ClipPPOLoss(policy, value, reduction=reduction)
    imitate = ImitationLoss(policy, reduction=reduction)
    out = CoTrainingLoss(ppo, imitate, sim_coeff=0.5, real_coeff=0.25)(batch)
    torch.testing.assert_close(
        out["loss_critic"], 0.5 * ppo(batch["sim"])["loss_critic"]
    )
    torch.testing.assert_close(
        out["loss_bc_real"], 0.25 * imitate(batch["real"])["loss_bc"]
    )
