"""The anchor's weight follows what RL has forgotten."""

from __future__ import annotations

import copy

import pytest
import torch
from learner_cases import make_learner, rollout
from loss_cases import demonstrations
from tensordict import TensorDictBase

from rlco.errors import DataError
from rlco.training import Learner
from rlco.training.anchor_weight import LEAST, MOST, AnchorWeight


def demonstrated() -> TensorDictBase:
    frames = demonstrations(10)
    frames["action_is_pad"] = torch.zeros(
        frames["vla_action", "chunk"].shape[:2]
    ).bool()
    return frames


def adapting(limit: float) -> Learner:
    learner = make_learner()
    learner.anchor = AnchorWeight(limit, learner.policy, demonstrated())
    return learner


def spoil(learner: Learner) -> None:
    """Let the policy do something else than it did when the anchor was made."""
    with torch.no_grad():
        for parameter in learner.policy.network.head.parameters():
            parameter += 3.0


def test_the_weight_rises_by_a_quarter_where_too_much_is_forgotten() -> None:
    learner = adapting(0.05)
    assert learner.anchor is not None
    spoil(learner)
    row = learner.anchor.adapt(learner.loss)
    assert row["forgotten"] > 0.05
    assert row["real_coeff"] == pytest.approx(0.2)
    assert float(learner.loss.real_coeff) == pytest.approx(0.25)


def test_the_weight_falls_by_a_fifth_where_little_is_and_never_to_nothing() -> None:
    learner = adapting(0.05)
    assert learner.anchor is not None
    assert learner.anchor.adapt(learner.loss)["forgotten"] == 0.0
    assert float(learner.loss.real_coeff) == pytest.approx(0.16)
    for _ in range(40):
        learner.anchor.adapt(learner.loss)
    assert float(learner.loss.real_coeff) == pytest.approx(LEAST)
    spoil(learner)
    for _ in range(60):
        learner.anchor.adapt(learner.loss)
    assert float(learner.loss.real_coeff) == pytest.approx(MOST)


def test_a_limit_of_one_share_differs_from_a_limit_of_none() -> None:
    # What is forgotten lies between the two limits: one raises, the other lowers.
    found = []
    for limit in (0.0, 1e9):
        learner = adapting(limit)
        assert learner.anchor is not None
        spoil(learner)
        learner.anchor.adapt(learner.loss)
        found.append(float(learner.loss.real_coeff))
    assert found == pytest.approx([0.25, 0.16])


def test_only_rollouts_that_move_the_policy_count() -> None:
    learner = adapting(0.05)
    row = learner.update(rollout(learner), epochs=1, train_policy=False)
    assert "forgotten" not in row
    assert float(learner.loss.real_coeff) == pytest.approx(0.2)
    row = learner.update(rollout(learner), epochs=1)
    assert {"forgotten", "real_coeff"} <= row.keys()


def test_a_resumed_learner_goes_on_with_the_weight_it_had() -> None:
    learner = adapting(0.05)
    first, second = rollout(learner), rollout(learner)
    learner.update(first, epochs=1)
    state = copy.deepcopy(learner.state())
    expected = learner.update(second, epochs=1)
    other = adapting(
        0.05
    )  # what was explained before RL is of the policy it starts from
    other.load(state)
    assert other.update(second, epochs=1) == expected
    assert float(other.loss.real_coeff) == float(learner.loss.real_coeff)


def test_demonstrations_in_which_nothing_moves_are_refused_not_nan() -> None:
    still = demonstrated()
    still["vla_action", "chunk"] = torch.full_like(still["vla_action", "chunk"], 0.5)
    with pytest.raises(DataError, match=r"forget_limit=0\.05 .* are the same"):
        AnchorWeight(0.05, make_learner().policy, still)
