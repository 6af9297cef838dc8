"""Two ranks learn of a large model what one learns from the rows of both."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from loss_cases import gradients, largest_error, total
from rank_cases import Found, in_two_ranks
from tensordict import TensorDict, TensorDictBase
from torchrl.data import LazyTensorStorage, ReplayBuffer
from vla_cases import INSTRUCTIONS, folder, rows

from rlco.losses import CoTrainingLoss, ImitationLoss, log_probs
from rlco.policies.vla.lerobot.checkpoint import load_lerobot
from rlco.policies.vla.lerobot.policy import LeRobotPolicy
from rlco.policies.vla.lerobot.trained_weights import add_expert_lora
from rlco.policies.vla.lora import add_lora
from rlco.policies.vla.openvla.load import load_openvla
from rlco.policies.vla.openvla.policy import OpenVLAPolicy
from rlco.policies.vla.prefix_critic import PrefixCritic
from rlco.training.distributed.joint_loss import JointLoss
from rlco.training.distributed.ranks import Ranks, join_ranks, leave_ranks
from rlco.training.lerobot_stage import make_large_learner
from rlco.training.stage_two import make_ppo

pytestmark = [pytest.mark.slow, pytest.mark.thorough]

UPDATES = 3
#: Two minibatches of one update; of each a rank has 3 and 1 decisions, 1 and 2 rows.
SIM = ((slice(0, 3), slice(3, 4)), (slice(4, 7), slice(7, 8)))
REAL = ((slice(0, 1), slice(1, 3)), (slice(3, 4), slice(4, 6)))
CASES = ("smolvla expert", "smolvla lora", "pi05 full", "openvla lora")
LARGE = CASES[:3]  # those that the recipe trains


def make_policy(case: str, path: Path) -> Any:
    kind, trained = case.split()
    torch.manual_seed(0)
    if kind == "openvla":
        model = load_openvla(path, dtype=torch.float32)
        add_lora(model, [model], rank=2)
        return OpenVLAPolicy(model, instructions=INSTRUCTIONS, tokenizer=path)
    policy = LeRobotPolicy(
        load_lerobot(path),
        instructions=INSTRUCTIONS,
        trained="full" if trained == "full" else "expert",
        steps=2,
        executed=4,
    )
    if trained == "lora":
        add_expert_lora(policy.model, rank=2)
    for name, weights in policy.named_parameters():
        if ".lora_B." in name:  # at 0 the other half has no gradient
            torch.nn.init.normal_(weights, std=0.02)
    return policy


def make_case(case: str, path: Path) -> tuple[Any, Any, CoTrainingLoss, TensorDictBase]:
    """Return policy, critic, loss and rows; they are the same in each process."""
    policy = make_policy(case, path)
    openvla = case.startswith("openvla")
    model = policy.model
    critic = PrefixCritic(model.hidden_size if openvla else model.summary_size)
    loss = CoTrainingLoss(
        make_ppo(policy, critic, clip=0.2, functional=False),
        ImitationLoss(policy, functional=False),
        real_coeff=0.7,
    )
    return (
        policy,
        critic,
        loss,
        TensorDict({"sim": played(policy, 8), "real": shown(policy)}),
    )


def played(policy: Any, count: int, seed: int = 1) -> TensorDictBase:
    """Return decisions with advantages, as the collector would."""
    torch.manual_seed(seed)
    td = policy(rows(count, chunk=policy.chunk).exclude("vla_action"))
    td["vla_action", "log_probs"] = log_probs(policy, td)
    td["advantage"] = torch.linspace(-1, 2, count).unsqueeze(-1)
    td["value_target"] = torch.linspace(0, 1, count).unsqueeze(-1)
    td["state_value"] = torch.zeros(count, 1)
    return td


def shown(policy: Any, count: int = 6) -> TensorDictBase:
    """Return demonstrations, the last steps of which are padding."""
    torch.manual_seed(2)
    td = rows(count, chunk=policy.chunk)
    td["action_is_pad"] = torch.zeros(count, policy.chunk, dtype=torch.bool)
    if policy.chunk > 1:
        for row in range(count):
            td["action_is_pad"][row, policy.chunk - 1 - row :] = True
    return td


def draw_alike(policy: Any, which: slice, part: int) -> None:
    """Let rows have the noise and time that they have in every process."""
    if not hasattr(policy, "policy"):
        return  # tokens are not noisy
    torch.manual_seed(3 + part)
    noise, time = torch.randn(3, policy.chunk, policy.width), torch.rand(3) * 0.9 + 0.05
    policy.policy.model.sample_noise = lambda *_: noise[which]
    policy.policy.model.sample_time = lambda *_: time[which]


def own(which: slice, part: int) -> slice:
    """Return where a rank's rows are among those of one minibatch."""
    start = 3 * part
    return slice(which.start - start, which.stop - start)


def gradients_of(case: str, path: Path, ranks: Ranks) -> list[torch.Tensor]:
    """Return this rank's gradients after two minibatches, as one update has them."""
    policy, _, loss, batch = make_case(case, path)
    joint = JointLoss(loss, ranks)
    for part, (sim, real) in enumerate(zip(SIM, REAL, strict=True)):
        which = real[ranks.rank]
        draw_alike(policy, own(which, part), part)
        mine = {"sim": batch["sim"][sim[ranks.rank]], "real": batch["real"][which]}
        total(joint(TensorDict(mine))).backward()
    return [p.grad for p in trained(loss) if p.grad is not None]


def trained(loss: CoTrainingLoss) -> list[torch.nn.Parameter]:
    return [p for p in loss.parameters() if p.requires_grad]


def learned(case: str, path: Path, ranks: Ranks) -> dict[str, torch.Tensor]:
    """Return the weights after updates from rollouts and rows of this rank's own."""
    policy, critic, loss, _ = make_case(case, path)
    torch.manual_seed(4)
    real = ReplayBuffer(storage=LazyTensorStorage(6))
    real.extend(shown(policy))
    options = SimpleNamespace(
        **{"policy": "", "minibatch": 2, "real_rows": 2, "accumulate": 2},
        **{"lr": 1e-3, "critic_lr": 1e-3, "max_grad_norm": 1.0},
    )
    learner = make_large_learner(
        options, loss, policy, critic, real, rows=4, ranks=ranks
    )
    for iteration in range(1, UPDATES + 1):
        learner.draw_own(iteration)
        rollout = played(policy, 4, seed=10 * iteration + ranks.rank)
        learner.update(rollout, 1)
    return {
        f"{name}.{key}": value.detach().clone()
        for name, part in learner._modules().items()
        for key, value in part.named_parameters()
    }


def work(paths: dict[str, Path]) -> dict[str, Any]:
    ranks = join_ranks(seed=5)
    found: dict[str, Any] = {
        "gradients": {case: gradients_of(case, paths[case], ranks) for case in CASES},
        "weights": {case: learned(case, paths[case], ranks) for case in LARGE},
    }
    leave_ranks()
    return found


@pytest.fixture(scope="module")
def paths() -> dict[str, Path]:
    given = {"openvla": {"action_size": 7}}
    kinds = {case: case.split()[0] for case in CASES}
    return {case: folder(kind, **given.get(kind, {})) for case, kind in kinds.items()}


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory, paths: dict[str, Path]) -> Found:
    return in_two_ranks(work, tmp_path_factory.mktemp("ranks"), paths)


@pytest.mark.parametrize("case", CASES)
def test_gradients_of_two_ranks_are_those_of_one_with_the_joined_batch(
    found: Found, paths: dict[str, Path], case: str
) -> None:
    policy, _, loss, batch = make_case(case, paths[case])
    parameters = trained(loss)
    summed = [torch.zeros_like(p) for p in parameters]
    for part, (sim, real) in enumerate(zip(SIM, REAL, strict=True)):
        draw_alike(policy, slice(0, 3), part)
        joined = {
            "sim": batch["sim"][sim[0].start : sim[1].stop],
            "real": batch["real"][real[0].start : real[1].stop],
        }
        one = gradients(parameters, total(loss(TensorDict(joined))))
        summed = [a + b for a, b in zip(summed, one, strict=True)]
    expected = [g for g in summed if float(g.abs().max()) > 0]
    for one in found:
        got = [g for g in one["gradients"][case] if float(g.abs().max()) > 0]
        assert len(got) == len(expected) > 10
        assert largest_error(got, expected) < 1e-6


@pytest.mark.parametrize("case", LARGE)
def test_ranks_have_equal_weights_to_the_last_bit_after_updates(
    found: Found, paths: dict[str, Path], case: str
) -> None:
    first, second = (one["weights"][case] for one in found)
    assert first.keys() == second.keys()
    for name, value in first.items():
        assert torch.equal(value, second[name]), name
    started = dict(make_policy(case, paths[case]).named_parameters())
    moved = {
        name
        for name, value in started.items()
        if not torch.equal(first[f"policy.{name}"], value)
    }
    named = {name for name, value in started.items() if value.requires_grad}
    assert moved <= named
    assert len(moved) > 0.5 * len(named)
