"""gradient_signal: the mean's size without the noise, with intervals that hold."""

from __future__ import annotations

import math

import pytest
import torch
from loss_cases import gradients, make_batch, make_networks, total
from tensordict import TensorDict
from torchrl.objectives import ClipPPOLoss

from rlco.errors import DataError
from rlco.losses import CoTrainingLoss, ImitationLoss, gradient_signal
from rlco.losses.gradient_signal import signal_of


def test_by_hand() -> None:
    # Three groups with mean (1, 0): products of different ones are 1 - 9 = -8 and
    # twice 1, so their mean is -2: the noise is larger than what is left.
    noisy = torch.tensor([[1.0, 3.0], [1.0, -3.0], [1.0, 0.0]], dtype=torch.float64)
    anchor = torch.tensor([0.3, 0.4], dtype=torch.float64)
    found = signal_of(noisy, anchor)
    assert math.isnan(found["anchor_strength"])
    assert found["anchor_strength_high"] == math.inf
    # Equal groups have no noise: |h| = .5, |g| = 2, cosine .3 / .5.
    equal = torch.tensor([[2.0, 0.0]] * 4, dtype=torch.float64)
    exact = signal_of(equal, anchor)
    assert exact == pytest.approx(
        {
            **dict.fromkeys(
                ("anchor_strength", "anchor_strength_low", "anchor_strength_high"), 0.25
            ),
            **dict.fromkeys(
                ("anchor_cosine", "anchor_cosine_low", "anchor_cosine_high"), 0.6
            ),
        }
    )


def test_no_anchor_has_no_strength_and_no_direction() -> None:
    found = signal_of(torch.eye(3) + 1.0, torch.zeros(3))
    assert found["anchor_strength"] == found["anchor_strength_high"] == 0.0
    assert math.isnan(found["anchor_cosine"])


def test_noise_ten_times_the_mean_hides_neither_size_nor_direction() -> None:
    # |g| = 1, each group's noise 10 in norm over 4000 parameters; |h| = .5, cosine .6.
    torch.manual_seed(0)
    mean = torch.zeros(4000, dtype=torch.float64)
    mean[0] = 1.0
    anchor = torch.zeros_like(mean)
    anchor[0], anchor[1] = 0.3, 0.4
    covered, strengths, naive = 0, [], []
    for _ in range(200):
        noise = torch.randn(8, 4000, dtype=torch.float64) * 10.0 / math.sqrt(4000)
        found = signal_of(mean + noise, anchor, confidence=0.9)
        naive.append(0.5 / float((mean + noise[0]).norm()))
        if not math.isnan(found["anchor_strength"]):
            strengths.append(found["anchor_strength"])
        low, high = found["anchor_strength_low"], found["anchor_strength_high"]
        covered += low <= 0.5 <= high
    assert torch.tensor(strengths).median() == pytest.approx(0.5, rel=0.15)
    assert covered >= 170  # of 200: nine of ten, and three standard deviations less
    assert max(naive) < 0.06  # what one noisy gradient says


# In parts, which count by their rows, padded steps weigh a little otherwise.
@pytest.mark.parametrize(("rows", "within"), [(512, 1e-3), (3, 0.15)])
def test_against_the_losses_alone_and_nothing_changes(rows: int, within: float) -> None:
    policy, value = make_networks(learn_std=True)
    ppo, imitate = ClipPPOLoss(policy, value), ImitationLoss(policy)
    batch = make_batch(policy)
    parameters = list(policy.parameters())
    loss = CoTrainingLoss(ppo, imitate, real_coeff=0.3)
    groups = [batch["sim"][i::4] for i in range(4)]
    own = torch.stack(
        [
            torch.cat([g.flatten() for g in gradients(parameters, total(ppo(group)))])
            for group in groups
        ]
    ).double()
    real = gradients(parameters, 0.3 * imitate(batch["real"])["loss_bc"])
    expected = signal_of(own, torch.cat([g.flatten() for g in real]).double())
    before = torch.get_rng_state()
    found = gradient_signal(loss, groups, batch["real"], rows=rows)
    assert torch.equal(torch.get_rng_state(), before)
    assert all(parameter.grad is None for parameter in parameters)
    assert found == pytest.approx(expected, rel=within, nan_ok=True)


def test_two_groups_are_refused() -> None:
    policy, value = make_networks()
    batch = make_batch(policy)
    loss = CoTrainingLoss(ClipPPOLoss(policy, value), ImitationLoss(policy))
    with pytest.raises(DataError, match="2 groups of episodes"):
        gradient_signal(loss, [batch["sim"]] * 2, batch["real"])
    with pytest.raises(DataError, match="no root"):
        loss.terms_of("real", TensorDict({"sim": batch["sim"]}))


def test_a_direction_that_noise_hides_is_not_told() -> None:
    # Two of three groups agree: |g|^2 is positive, and its interval contains 0.
    groups = torch.tensor([[3.0, 1.0], [3.0, -1.0], [-1.0, 0.0]], dtype=torch.float64)
    found = signal_of(groups, torch.tensor([1.0, 0.0], dtype=torch.float64))
    # (25 - (10 + 10 + 1)) / 6 = 2 / 3.
    assert found["anchor_strength"] == pytest.approx(1.0 / math.sqrt(2.0 / 3.0))
    assert found["anchor_strength_high"] == math.inf
    assert math.isnan(found["anchor_cosine"])
    # Nearly parallel groups: the unbiased |g| is a little less than g h / |h|.
    groups = torch.tensor([[1.0, 0.1], [1.0, -0.1], [1.0, 0.0]], dtype=torch.float64)
    found = signal_of(groups, torch.tensor([1.0, 0.0], dtype=torch.float64))
    assert found["anchor_cosine"] == found["anchor_cosine_high"] == 1.0


def test_without_an_anchor_its_strength_is_nought() -> None:
    policy, value = make_networks()
    batch = make_batch(policy)
    ppo = ClipPPOLoss(policy, value, entropy_bonus=False)
    alone = CoTrainingLoss(ppo, None, real_coeff=0.0)
    found = gradient_signal(alone, [batch["sim"]] * 3, batch["real"])
    assert found["anchor_strength"] == 0.0
    assert math.isnan(found["anchor_cosine"])


def test_rows_are_asked_for_where_a_batch_is_given() -> None:
    policy, value = make_networks()
    batch = make_batch(policy)
    loss = CoTrainingLoss(ClipPPOLoss(policy, value), ImitationLoss(policy))
    for given in (batch, None):
        with pytest.raises(DataError, match="give the demonstrations themselves"):
            gradient_signal(loss, [batch["sim"]] * 3, given)  # type: ignore[arg-type]
