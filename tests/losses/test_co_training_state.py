"""One actor in CoTrainingLoss, whatever is done to it: copies, state, casts."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable

import pytest
import torch
from loss_cases import assert_same_outputs, make_batch, make_networks, total
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.modules import IndependentNormal, NormalParamExtractor, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss

from rlco.errors import CheckpointError
from rlco.losses import CoTrainingLoss, ImitationLoss
from rlco.policies import GaussianPolicy

FUNCTIONAL = [(True, True), (True, False), (False, True), (False, False)]
each_mode = pytest.mark.parametrize(("sim_functional", "real_functional"), FUNCTIONAL)
COPIES: dict[str, Callable[[nn.Module], nn.Module]] = {
    "itself": lambda loss: loss,
    "deepcopy": copy.deepcopy,
    "pickle": lambda loss: pickle.loads(pickle.dumps(loss)),
    "double": lambda loss: copy.deepcopy(loss).double(),
    "deepcopy of a parent": lambda loss: copy.deepcopy(nn.Sequential(loss))[0],
}


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


@each_mode
@pytest.mark.parametrize("how", COPIES)
def test_a_copy_has_one_actor_that_both_losses_train(
    sim_functional: bool, real_functional: bool, how: str
) -> None:
    policy, loss, batch = make_loss(sim_functional, real_functional)
    expected = loss(batch)
    twin = COPIES[how](loss)
    # 4 tensors of the policy and 4 of the critic, nothing twice, nothing missing.
    assert len(list(twin.parameters())) == 8
    assert len(list(twin.named_parameters())) == 8
    shared = {id(parameter) for parameter in twin.shared_parameters()}
    assert shared == {id(p) for p in twin.actor_network.parameters()}
    assert shared == {id(p) for p in twin.real_loss.actor_network.parameters()}
    assert shared <= {id(p) for p in twin.parameters()}
    if how != "double":
        assert_same_outputs(twin(batch), expected)
        # A step on the shared parameters moves both terms.
        with torch.no_grad():
            for parameter in twin.shared_parameters():
                parameter.add_(0.1)
        for name in ("loss_objective", "loss_bc_real"):
            assert not torch.equal(twin(batch)[name], expected[name])
    if how != "itself":
        assert shared.isdisjoint({id(p) for p in policy.parameters()})


@each_mode
def test_normalisation_set_later_reaches_both_losses(
    sim_functional: bool, real_functional: bool
) -> None:
    policy, loss, batch = make_loss(sim_functional, real_functional)
    before = loss(batch)
    policy.set_normalization(state=([-3.0] * 3, [2.0] * 3))
    after = loss(batch)
    for name in ("loss_objective", "loss_bc_real"):
        assert not torch.equal(after[name], before[name])


@each_mode
@pytest.mark.parametrize("assign", [False, True])
def test_state_dict_holds_the_actor_once_and_comes_back(
    sim_functional: bool, real_functional: bool, assign: bool
) -> None:
    _, loss, batch = make_loss(sim_functional, real_functional, real_coeff=0.7)
    state = nn.ModuleDict({"loss": loss}).state_dict()
    heads = [name for name in state if name.endswith("network.head.weight")]
    assert len(heads) == 2  # the actor's and the critic's
    torch.manual_seed(1)
    _, other, _ = make_loss(sim_functional, real_functional)
    names = set(state)
    nn.ModuleDict({"loss": other}).load_state_dict(
        {name: value.clone() for name, value in state.items()}, assign=assign
    )
    assert set(state) == names
    assert_same_outputs(other(batch), loss(batch))
    assert len(list(other.parameters())) == 8


def test_a_state_dict_with_a_missing_actor_entry_is_refused() -> None:
    _, loss, _ = make_loss()
    state = loss.state_dict()
    del state["sim_loss.actor_network_params.network.head.weight"]
    with pytest.raises(RuntimeError, match=r"Missing key.*network\.head\.weight"):
        loss.load_state_dict(state)


def test_a_state_dict_of_another_shape_is_refused_and_changes_nothing() -> None:
    policy, loss, _ = make_loss()
    before = policy.network.head.weight.detach().clone()
    state = {name: value.clone() + 1 for name, value in loss.state_dict().items()}
    state["sim_loss.actor_network_params.network.head.weight"] = torch.zeros(4, 9)
    with pytest.raises(CheckpointError, match=r"head\.weight has shape \(4, 9\)"):
        loss.load_state_dict(state)
    assert torch.equal(policy.network.head.weight, before)


@pytest.mark.parametrize("cast", [False, True])
def test_a_critic_on_the_actors_layers_leaves_them_to_the_actor(cast: bool) -> None:
    trunk = TensorDictModule(nn.Linear(3, 8), ["observation"], ["hidden"])
    head = nn.Sequential(nn.Linear(8, 4), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictSequential(
            trunk, TensorDictModule(head, ["hidden"], ["loc", "scale"])
        ),
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )
    value = TensorDictModule(nn.Linear(8, 1), ["hidden"], ["state_value"])
    critic = TensorDictSequential(trunk, value)
    weight = trunk.module.weight
    ppo = ClipPPOLoss(actor, critic, separate_losses=True)
    loss = CoTrainingLoss(ppo, None, real_coeff=0)
    dtype = torch.float64 if cast else torch.float32
    loss = loss.to(dtype)
    assert trunk.module.weight is weight
    assert weight.dtype == dtype

    with torch.no_grad():
        sim = actor(TensorDict({"observation": torch.randn(4, 3, dtype=dtype)}, [4]))
    sim["advantage"] = torch.randn(4, 1, dtype=dtype)
    sim["value_target"] = torch.ones(4, 1, dtype=dtype)
    out = loss(TensorDict({"sim": sim}))
    (from_critic,) = torch.autograd.grad(
        out["loss_critic"], [weight], allow_unused=True, retain_graph=True
    )
    assert from_critic is None
    (from_all,) = torch.autograd.grad(total(out), [weight])
    assert from_all.abs().sum() > 0
