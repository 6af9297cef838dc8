"""Whatever cannot be meant is refused, in one sentence."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from loss_cases import assert_same_outputs, make_batch, make_networks
from tensordict import TensorDict, TensorDictBase
from torchrl.objectives import ClipPPOLoss, LossModule, ReinforceLoss

from rlco.errors import ConfigError, DataError
from rlco.losses import CoTrainingLoss, ImitationLoss


def stage_two(**coefficients: float) -> tuple[CoTrainingLoss, TensorDictBase]:
    policy, value = make_networks()
    loss = CoTrainingLoss(
        ClipPPOLoss(policy, value), ImitationLoss(policy), **coefficients
    )
    return loss, make_batch(policy)


@pytest.mark.parametrize("root", ["sim", "real"])
def test_a_missing_root_is_named(root: str) -> None:
    loss, batch = stage_two()
    del batch[root]
    with pytest.raises(DataError, match=f"no root '{root}'.*{root}_coeff=0"):
        loss(batch)


def test_a_root_stays_needed_where_its_coefficient_was_scheduled_to_zero() -> None:
    loss, batch = stage_two()
    loss.real_coeff = 0.0
    del batch["real"]
    with pytest.raises(DataError, match="no root 'real'"):
        loss(batch)


@pytest.mark.parametrize("key", ["advantage", "value_target"])
def test_no_advantage_is_estimated_from_a_minibatch(key: str) -> None:
    loss, batch = stage_two()
    # All that TorchRL's loss would need to run GAE on the shuffled rows.
    sim = batch["sim"]
    sim["next"] = sim.select("observation", "instruction_id")
    sim["next", "reward"] = torch.ones(6, 1)
    for name in ("done", "terminated"):
        sim["next", name] = torch.zeros(6, 1, dtype=torch.bool)
    del sim[key]
    with pytest.raises(DataError, match=f"'sim' has no '{key}'; run an advantage"):
        loss(batch)


def test_without_critic_no_value_target_is_needed() -> None:
    policy, _ = make_networks()
    loss = CoTrainingLoss(ClipPPOLoss(policy, None), ImitationLoss(policy))
    batch = make_batch(policy)
    del batch["sim", "value_target"]
    out = loss(batch)
    assert set(out.keys()) == set(loss.out_keys)
    assert "loss_critic" not in out


@pytest.mark.parametrize("functional", [True, False])
def test_two_actors_are_refused_even_where_they_are_equal(functional: bool) -> None:
    policy, value = make_networks()
    other, _ = make_networks()
    other.load_state_dict(policy.state_dict())
    with pytest.raises(ConfigError, match="do not share an actor"):
        CoTrainingLoss(
            ClipPPOLoss(policy, value, functional=functional),
            ImitationLoss(other, functional=functional),
        )


def test_colliding_output_names_are_refused() -> None:
    class RealNamed(ImitationLoss):
        @property
        def out_keys(self) -> Any:
            return ["loss_bc_real"]

    policy, _ = make_networks()
    with pytest.raises(ConfigError, match="both return loss_bc_real"):
        CoTrainingLoss(RealNamed(policy), ImitationLoss(policy))


def test_colliding_output_names_are_refused_where_only_the_output_shows_them() -> None:
    class RealNamed(ImitationLoss):
        def forward(self, tensordict: Any) -> Any:
            out = super().forward(tensordict)
            return TensorDict({"loss_bc_real": out["loss_bc"]})

    policy, _ = make_networks()
    loss = CoTrainingLoss(RealNamed(policy), ImitationLoss(policy))
    batch = make_batch(policy)
    with pytest.raises(ConfigError, match="both return loss_bc_real"):
        loss(batch)


def test_an_output_that_trainers_would_add_up_by_mistake_is_refused() -> None:
    class Unscaled(ImitationLoss):
        def forward(self, tensordict: Any) -> Any:
            out = super().forward(tensordict)
            return out.set("loss", out["loss_bc"])

    policy, _ = make_networks()
    loss = CoTrainingLoss(Unscaled(policy), ImitationLoss(policy))
    batch = make_batch(policy)
    with pytest.raises(ConfigError, match="Unscaled returns 'loss'"):
        loss(batch)


@pytest.mark.parametrize(
    ("sim", "real", "coefficients", "message"),
    [
        (True, False, {}, "real_loss is None but real_coeff=0.2"),
        (False, True, {}, "sim_loss is None but sim_coeff=1.0"),
        (True, True, {"real_coeff": -0.1}, "real_coeff=-0.1 must be finite"),
        (True, True, {"sim_coeff": float("nan")}, "sim_coeff=nan must be finite"),
        (True, True, {"sim_coeff": 0, "real_coeff": 0}, "nothing is trained"),
    ],
)
def test_impossible_combinations(
    sim: bool, real: bool, coefficients: Any, message: str
) -> None:
    policy, value = make_networks()
    with pytest.raises(ConfigError, match=message):
        CoTrainingLoss(
            ClipPPOLoss(policy, value) if sim else None,
            ImitationLoss(policy) if real else None,
            **coefficients,
        )


def test_a_reduction_that_keeps_rows_is_refused() -> None:
    policy, value = make_networks()
    with pytest.raises(ConfigError, match="sim_loss has reduction='none'"):
        CoTrainingLoss(
            ClipPPOLoss(policy, value, reduction="none"), ImitationLoss(policy)
        )


def test_all_problems_are_reported_at_once() -> None:
    with pytest.raises(ConfigError) as caught:
        CoTrainingLoss(None, None, sim_coeff=-1.0)
    assert len(caught.value.problems) == 3


# -- A loss of one's own ---------------------------------------------------------


class Bare(LossModule):
    """A LossModule that keeps its actor under a name of its own."""

    def __init__(self, actor: Any) -> None:
        super().__init__()
        self.policy = actor


class Unconverted(LossModule):
    """One that calls itself functional and keeps the actor as a submodule."""

    def __init__(self, actor: Any) -> None:
        super().__init__()
        self.actor_network = actor


@pytest.mark.parametrize("side", ["sim_loss", "real_loss"])
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda actor: torch.nn.Linear(1, 1), ["is a Linear", "LossModule is needed"]),
        (Bare, ["a Bare, has no actor_network", "convert_to_functional"]),
        (Unconverted, ["a Unconverted", "no actor_network_params"]),
    ],
)
@pytest.mark.parametrize("alone", [True, False])
def test_what_cannot_share_an_actor_is_named(
    side: str, make: Any, words: list[str], alone: bool
) -> None:
    policy, _ = make_networks()
    other = "real_loss" if side == "sim_loss" else "sim_loss"
    given = {side: make(policy), other: None if alone else ImitationLoss(policy)}
    coefficient = {f"{other.removesuffix('_loss')}_coeff": 0.0} if alone else {}
    with pytest.raises(ConfigError) as caught:
        CoTrainingLoss(**given, **coefficient)
    for word in [side, *words]:
        assert word in str(caught.value)


@pytest.mark.parametrize("value", [-1, float("nan"), float("inf"), torch.tensor(-0.5)])
@pytest.mark.parametrize("name", ["sim_coeff", "real_coeff"])
def test_a_coefficient_cannot_become_what_it_cannot_be(name: str, value: Any) -> None:
    loss, batch = stage_two()
    before = loss(batch)
    with pytest.raises(ConfigError, match=f"{name}=.* must be finite and >= 0"):
        setattr(loss, name, value)
    assert_same_outputs(loss(batch), before)


def test_reinforce_is_taken_and_needs_what_it_would_estimate() -> None:
    policy, value = make_networks()
    loss = CoTrainingLoss(ReinforceLoss(policy, value), ImitationLoss(policy))
    loss.set_keys(
        action=("vla_action", "sample"), sample_log_prob=("vla_action", "log_probs")
    )
    batch = make_batch(policy)
    out = loss(batch)
    assert set(out.keys()) == {"loss_actor", "loss_value", "loss_bc_real"}
    del batch["sim", "advantage"]
    with pytest.raises(DataError, match="'sim' has no 'advantage'"):
        loss(batch)


class Own(ImitationLoss):
    """A loss of one's own; what it returns is changed below."""

    change: Any = staticmethod(lambda term: {"loss_own": term})
    returned: Any = ("loss_own",)

    @property
    def out_keys(self) -> Any:
        return self.returned

    def forward(self, tensordict: Any) -> Any:
        term = super().forward(tensordict)["loss_bc"]
        return TensorDict(self.change(term))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda term: {"own": term}, "returned own and no term loss_"),
        (lambda term: {"loss_own": term.detach()}, "returned loss_own without a grad"),
        (lambda term: {"loss_own": term.expand(4)}, r"shape \(4,\), but a term is one"),
    ],
)
def test_a_loss_of_which_nothing_is_trained_is_refused(
    change: Any, message: str
) -> None:
    policy, value = make_networks()
    own = Own(policy)
    own.change = change
    loss = CoTrainingLoss(ClipPPOLoss(policy, value), own)
    batch = make_batch(policy)
    with pytest.raises(ConfigError, match=f"real_loss, a Own, .*{message}"):
        loss(batch)


def test_one_without_gradients_is_fine_where_none_is_wanted() -> None:
    policy, value = make_networks()
    loss = CoTrainingLoss(ClipPPOLoss(policy, value), ImitationLoss(policy))
    batch = make_batch(policy)
    with torch.no_grad():
        assert not loss(batch)["loss_bc_real"].requires_grad
    for parameter in loss.parameters():
        parameter.requires_grad_(False)
    assert not loss(batch)["loss_bc_real"].requires_grad


@pytest.mark.parametrize(
    ("returned", "message"),
    [(["own"], "returns own by its out_keys and no term loss_"), (None, "no out_keys")],
)
def test_names_that_promise_no_term_are_refused(returned: Any, message: str) -> None:
    policy, value = make_networks()
    own = Own(policy)
    own.returned = returned
    with pytest.raises(ConfigError, match=message):
        CoTrainingLoss(ClipPPOLoss(policy, value), own)


def test_an_entry_that_a_root_lacks_is_named() -> None:
    policy, value = make_networks()
    loss = CoTrainingLoss(ClipPPOLoss(policy, value), ImitationLoss(policy))
    batch = make_batch(policy)
    del batch["sim", "vla_action", "log_probs"]
    with pytest.raises(DataError, match=r"'sim' has no .*log_probs.* ClipPPOLoss"):
        loss(batch)
