"""Two ranks learn what one learns from the rows of both."""

from __future__ import annotations

import copy
from typing import Any

import pytest
import torch
from learner_cases import make_learner, rollout
from loss_cases import (
    demonstrations,
    gradients,
    largest_error,
    make_batch,
    make_networks,
    total,
)
from rank_cases import Found, in_two_ranks
from tensordict import TensorDict, TensorDictBase
from torchrl.objectives import ClipPPOLoss

from rlco.collectors.advantages import normalize
from rlco.errors import ConfigError
from rlco.losses import CoTrainingLoss, ImitationLoss
from rlco.training.distributed.joint_loss import JointLoss
from rlco.training.distributed.ranks import Ranks, join_ranks, leave_ranks

pytestmark = pytest.mark.slow

UPDATES = 20
#: Rows of each rank: of PPO 4 and 2, of the anchor 1 and 3.
SIM, REAL = (slice(0, 4), slice(4, 6)), (slice(0, 1), slice(1, 4))


def make_case(*, functional: bool) -> tuple[CoTrainingLoss, TensorDictBase]:
    """Return a loss and a batch; both are the same in each process."""
    torch.manual_seed(0)
    policy, critic = make_networks()
    ppo = ClipPPOLoss(policy, critic, entropy_bonus=False, functional=functional)
    imitation = ImitationLoss(policy, functional=functional)
    batch = make_batch(policy)
    # Of 4 x 2 demonstrated steps the first rank has 2, the second 3.
    batch["real", "action_is_pad"] = torch.tensor(
        [[False, False], [False, True], [True, True], [False, False]]
    )
    return CoTrainingLoss(ppo, imitation, real_coeff=0.7), batch


def trained(loss: CoTrainingLoss) -> list[torch.nn.Parameter]:
    return [p for p in loss.parameters() if p.requires_grad]


def own_rows(batch: TensorDictBase, rank: int) -> TensorDictBase:
    return TensorDict(
        {"sim": batch["sim"][SIM[rank]], "real": batch["real"][REAL[rank]]}
    )


def work() -> dict[str, Any]:
    """What each of two ranks does for all tests."""
    ranks = join_ranks(seed=5)
    found: dict[str, Any] = {}
    loss, batch = make_case(functional=False)
    joint = JointLoss(loss, ranks)
    out = joint(own_rows(batch, ranks.rank))
    total(out).backward()
    found["gradients"] = [p.grad for p in trained(loss)]
    found["reported"] = ranks.mean({k: float(v.detach()) for k, v in out.items()})

    flags = torch.tensor([ranks.rank == 0, True])
    images = torch.full((2, 3), ranks.rank, dtype=torch.uint8)
    joined = ranks.joined(TensorDict({"flag": flags, "o": {"image": images}}, [2]))
    found["joined"], found["own"] = joined, ranks.own(joined)

    advantage = torch.arange(6.0).reshape(3, 2, 1) ** (1 + ranks.rank)
    broken = torch.zeros(3, 2, 1, dtype=torch.bool)
    broken[0, 0] = ranks.rank == 1
    found["advantage"] = advantage, broken, normalize(advantage, broken, ranks)

    found |= learn(ranks)
    leave_ranks()
    return found


def learn(ranks: Ranks) -> dict[str, Any]:
    """Make 20 updates of a learner, and a checkpoint that another goes on from."""
    options: dict[str, Any] = {"ranks": ranks, "functional": False}
    learner = make_learner(**options)
    drawn = []
    sample = learner.buffer.real.sample

    def noted(rows: int) -> TensorDictBase:
        drawn.append(sample(rows))
        return drawn[-1]

    learner.buffer.real.sample = noted
    for iteration in range(1, UPDATES // 4 + 1):  # two passes over two minibatches
        learner.draw_own(iteration)
        row = learner.update(rollout(learner), epochs=2)
    found = {
        "drawn": torch.cat([part["observation", "state"] for part in drawn]),
        "row": row,
        "weights": weights(learner),
    }
    # The first rank's policy moves farther than the limit in a pass, the second's not.
    strict = make_learner(**options, target_kl=1e-3)
    strict.draw_own(1)
    played = rollout(strict)
    played["advantage"] *= 1.0 if ranks.leads else 0.0
    found["epochs"] = strict.update(played, epochs=5)["epochs"]
    again = make_learner(**options, reuse=1)
    again.draw_own(1)
    again.update(rollout(again), epochs=1)
    state = copy.deepcopy(ranks.from_lead(again.state()))  # as a file would hold it
    resumed = make_learner(**options, reuse=1)
    resumed.load(state)
    for one in (again, resumed):
        torch.manual_seed(9)  # a run restores the first rank's, the others draw anew
        one.draw_own(2)
        one.update(rollout(one), epochs=1)
    found["resumed"] = weights(again), weights(resumed)
    return found


def weights(learner: Any) -> dict[str, torch.Tensor]:
    return {
        f"{name}.{key}": value.clone()
        for name, part in learner._modules().items()
        for key, value in part.state_dict().items()
    }


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Found:
    return in_two_ranks(work, tmp_path_factory.mktemp("ranks"))


def test_gradients_of_two_ranks_are_those_of_one_with_the_joined_batch(
    found: Found,
) -> None:
    # As users build it, functional; 4 + 2 rows of PPO, 2 + 3 steps of the anchor.
    loss, batch = make_case(functional=True)
    expected = gradients(trained(loss), total(loss(batch)))
    for one in found:
        assert largest_error(one["gradients"], expected) < 1e-6


def test_reported_numbers_are_means_over_the_rows_of_both(found: Found) -> None:
    loss, batch = make_case(functional=True)
    expected = loss(batch)
    for name in ("loss_objective", "loss_critic", "loss_bc_real", "kl_approx"):
        for one in found:
            assert one["reported"][name] == pytest.approx(float(expected[name]), 1e-5)


def test_ranks_have_equal_weights_to_the_last_bit_after_20_updates(
    found: Found,
) -> None:
    first, second = (one["weights"] for one in found)
    assert first.keys() == second.keys()
    for name, value in first.items():
        assert torch.equal(value, second[name]), name
    started = weights(make_learner())
    assert not torch.equal(
        first["policy.network.head.weight"], started["policy.network.head.weight"]
    )
    assert found[0]["row"] == found[1]["row"]


def test_each_rank_draws_other_real_rows(found: Found) -> None:
    first, second = (one["drawn"] for one in found)
    assert first.shape == second.shape == (4 * UPDATES, 3)
    assert not torch.equal(first, second)


def test_a_pass_is_the_last_one_for_both_or_for_none(found: Found) -> None:
    assert found[0]["epochs"] == found[1]["epochs"] < 5


def test_advantages_are_normalised_over_both(found: Found) -> None:
    advantage = torch.cat([one["advantage"][0] for one in found])
    broken = torch.cat([one["advantage"][1] for one in found])
    together = torch.cat([one["advantage"][2] for one in found])
    torch.testing.assert_close(together, normalize(advantage, broken))


def test_both_resume_from_what_the_first_saved(found: Found) -> None:
    for one in found:
        went_on, resumed = one["resumed"]
        for name, value in went_on.items():
            assert torch.equal(value, resumed[name]), name


def test_rows_are_joined_in_the_order_of_ranks(found: Found) -> None:
    for rank, one in enumerate(found):
        joined = one["joined"]
        assert joined["flag"].tolist() == [True, True, False, True]
        assert joined["flag"].dtype == torch.bool
        assert joined["o", "image"][:, 0].tolist() == [0, 0, 1, 1]
        assert one["own"]["o", "image"].unique().tolist() == [rank]


def test_a_functional_loss_is_refused() -> None:
    loss, _ = make_case(functional=True)
    with pytest.raises(ConfigError, match="functional=False"):
        JointLoss(loss, Ranks(count=2))


def test_of_padding_alone_nothing_is_counted() -> None:
    from rlco.training.distributed.joint_loss import counted

    loss, _ = make_case(functional=False)
    rows = demonstrations(2)
    rows["action_is_pad"] = torch.ones(2, 2, dtype=torch.bool)
    assert counted(loss.real_loss, rows) == 0
    assert counted(loss.sim_loss, rows) == 2  # PPO's mean is over decisions
