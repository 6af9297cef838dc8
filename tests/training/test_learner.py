"""Training on one rollout: what moves, what is told, what a checkpoint holds."""

from __future__ import annotations

import copy
from typing import Any

import pytest
import torch
from learner_cases import make_learner, rollout

from rlco.errors import NonFiniteError
from rlco.policies import FlowPolicy
from rlco.training import Learner

LOG_PROB = ("vla_action", "log_probs")


def weights(module: Any) -> torch.Tensor:
    return torch.cat([p.detach().flatten().clone() for p in module.parameters()])


def test_the_first_ratio_is_one_however_wrong_the_rollouts_log_probability() -> None:
    learner = make_learner()
    td = rollout(learner)
    td[LOG_PROB] += 0.25
    told = learner.update(td, epochs=2)
    assert told["first_ratio"] == pytest.approx(1.0, abs=1e-5)
    assert told["log_prob_gap"] == pytest.approx(0.25, abs=1e-4)
    # Two epochs of two minibatches moved the policy away from it.
    assert told["max_ratio"] > 1.001
    assert {"grad_norm_ratio", "loss_bc_real", "loss_critic"} <= told.keys()


def test_measuring_the_anchor_changes_no_weight() -> None:
    found = []
    for measure in (False, True):
        learner = make_learner()
        row = learner.update(rollout(learner), epochs=1, measure=measure)
        found.append((weights(learner.policy), row))
    (plain, before), (measured, after) = found
    assert torch.equal(plain, measured)
    names = {"anchor_strength", "anchor_strength_low", "anchor_cosine_high"}
    assert not names & before.keys()
    assert names <= after.keys()


def test_the_critic_can_be_trained_alone() -> None:
    learner = make_learner()
    before = weights(learner.policy), weights(learner.critic)
    told = learner.update(rollout(learner), epochs=1, train_policy=False)
    assert torch.equal(weights(learner.policy), before[0])
    assert not torch.equal(weights(learner.critic), before[1])
    assert told["max_ratio"] == pytest.approx(1.0, abs=1e-5)


def test_a_pass_that_went_too_far_is_the_last_one() -> None:
    def passes(target_kl: float | None, **options: bool) -> float:
        learner = make_learner(target_kl=target_kl)
        return learner.update(rollout(learner), epochs=5, **options)["epochs"]

    free = make_learner()
    one = free.update(rollout(free), epochs=1)["kl_approx"]
    assert one > 1e-3  # after the first step of the first pass
    assert passes(None) == passes(1e3) == 5
    assert passes(one * 0.99) == 1
    assert 1 < passes(one * 1.01) < 5
    # The critic alone moves no policy, and learns from all passes, whatever the limit:
    # by rounding the policy may lie beyond any.
    assert passes(-1.0) == 1
    assert passes(-1.0, train_policy=False) == 5


def test_learning_rates_fall_linearly_and_stay_so_where_a_run_is_resumed() -> None:
    learner = make_learner(lr_final=0.2)

    def rates(one: Learner) -> list[float]:
        both = (one.actor_optimizer, one.critic_optimizer)
        return [part.param_groups[0]["lr"] for part in both if part is not None]

    learner.anneal(0.0)
    assert rates(learner) == pytest.approx([1e-2, 1e-2])
    learner.anneal(0.5)
    assert rates(learner) == pytest.approx([0.6e-2, 0.6e-2])
    resumed = make_learner(lr_final=0.2)
    resumed.load(copy.deepcopy(learner.state()))
    resumed.anneal(0.75)
    learner.anneal(0.75)
    assert rates(resumed) == rates(learner) == pytest.approx([0.4e-2, 0.4e-2])
    constant = make_learner()
    constant.anneal(0.75)
    assert rates(constant) == [1e-2, 1e-2]


def test_what_is_learned_from_again_is_weighted_by_how_likely_it_is_now() -> None:
    learner = make_learner(reuse=1)
    first, second = rollout(learner), rollout(learner)
    assert "reuse_weight" not in learner.update(first, epochs=1)  # the policy moves
    with torch.no_grad():
        now = learner.policy.get_dist(first).log_prob(first["vla_action", "sample"])
    weight = (now - first[LOG_PROB]).exp().clamp(max=1.0).flatten()
    assert 0.2 < weight.min() < 0.99
    assert (weight == 1.0).any()
    row = learner.update(second, epochs=1)
    assert row["reuse_weight"] == pytest.approx(float(weight.mean()), abs=1e-4)
    assert row["first_ratio"] == pytest.approx(1.0, abs=1e-5)
    stored = learner.buffer.sim[:]
    assert len(stored) == 32
    torch.testing.assert_close(
        stored["advantage"][:16], second["advantage"].flatten(0, 1)
    )
    expected = first["advantage"].flatten() * weight
    torch.testing.assert_close(stored["advantage"][16:].flatten(), expected)
    torch.testing.assert_close(stored[LOG_PROB][16:], now.flatten())
    # Only one earlier rollout is kept, as it was played.
    learner.update(rollout(learner), epochs=1)
    assert len(learner.buffer.sim) == 32
    kept = learner.state()["earlier"]
    assert [len(one["advantage"]) for one in kept] == [16]


@pytest.mark.parametrize("level", ["action", "token"])
def test_parts_of_a_decision_with_ratios_of_their_own_are_trained(level: Any) -> None:
    torch.manual_seed(1)
    sizes = {"chunk": 2, "action_size": 2, "num_instructions": 2}
    policy = FlowPolicy(3, hidden=(8,), log_prob_level=level, **sizes)
    learner = make_learner(policy=policy, reuse=1)
    first, second = rollout(learner), rollout(learner)
    told = learner.update(first, epochs=1)
    assert told["first_ratio"] == pytest.approx(1.0, abs=1e-5)
    assert 0 < told["ESS"] <= 1.0 + 1e-6  # one number, of all parts
    with torch.no_grad():
        now = policy.get_dist(first).log_prob(first["vla_action", "sample"])
    # What is learned from again has one weight a decision: all its parts' together.
    change = (now - first[LOG_PROB]).flatten(2).sum(-1)
    weight = change.exp().clamp(max=1.0).flatten()
    assert 0.01 < weight.min() < 0.99
    row = learner.update(second, epochs=1)
    assert row["reuse_weight"] == pytest.approx(float(weight.mean()), abs=1e-4)
    torch.testing.assert_close(
        learner.buffer.sim[16:32]["advantage"].flatten(),
        first["advantage"].flatten() * weight,
    )


def test_without_critic_and_anchor_the_policy_alone_is_trained() -> None:
    learner = make_learner(critic=False, anchored=False)
    before = weights(learner.policy)
    told = learner.update(rollout(learner), epochs=1)
    assert not torch.equal(weights(learner.policy), before)
    assert not {"loss_critic", "loss_bc_real", "grad_cosine"} & told.keys()
    assert learner.state().keys() == {"policy", "actor_optimizer", "buffer"}


@pytest.mark.parametrize("reuse", [0, 2])
def test_a_learner_goes_on_from_its_state_as_if_never_stopped(reuse: int) -> None:
    learner = make_learner(reuse=reuse)
    first, second = rollout(learner), rollout(learner)
    learner.update(first, epochs=1)
    state = copy.deepcopy(learner.state())
    expected = learner.update(second, epochs=1)
    other = make_learner(reuse=reuse)
    for parameter in (*other.policy.parameters(), *other.critic.parameters()):
        parameter.data.zero_()
    other.load(state)
    assert other.update(second, epochs=1) == expected
    assert torch.equal(weights(other.policy), weights(learner.policy))


# -- What is not finite --------------------------------------------------------------


def test_no_step_follows_a_gradient_that_is_not_finite() -> None:
    learner = make_learner()
    td = rollout(learner)
    learner.policy.network.head.bias.register_hook(lambda grad: grad * torch.inf)
    before = weights(learner.policy), weights(learner.critic)
    with pytest.raises(NonFiniteError) as caught:
        learner.update(td, epochs=1)
    assert "the gradient of policy.network.head.bias is " in str(caught.value)
    assert "in update 1 of the rollout, where the loss was finite" in str(caught.value)
    # Neither part has moved, whichever was at fault.
    assert torch.equal(weights(learner.policy), before[0])
    assert torch.equal(weights(learner.critic), before[1])
    assert not learner.actor_optimizer.state


@pytest.mark.parametrize(
    ("key", "name"),
    [("advantage", "loss_objective"), ("value_target", "loss_critic")],
)
def test_a_loss_that_is_not_finite_is_named(key: str, name: str) -> None:
    learner = make_learner()
    td = rollout(learner)
    td[key][1, 2] = torch.nan
    with pytest.raises(NonFiniteError, match=f"{name} became nan in update"):
        learner.update(td, epochs=1)
    assert weights(learner.policy).isfinite().all()
    assert weights(learner.critic).isfinite().all()


@pytest.mark.parametrize(
    ("rows", "when"), [(2, "after update 1"), (4, "before update 2")]
)
def test_a_step_that_spoils_the_weights_is_named(rows: int, when: str) -> None:
    learner = make_learner()
    td = rollout(learner)[:rows]
    learner.actor_optimizer = torch.optim.SGD(
        learner.policy.parameters(), lr=1e38, weight_decay=1e38
    )
    with pytest.raises(NonFiniteError, match=rf"policy\.network\..* {when} .*lower lr"):
        learner.update(td, epochs=1)


def test_a_weight_that_is_frozen_may_be_anything() -> None:
    learner = make_learner()
    learner.policy.register_parameter(
        "unused", torch.nn.Parameter(torch.full((2,), torch.nan), requires_grad=False)
    )
    learner.update(rollout(learner), epochs=1)
