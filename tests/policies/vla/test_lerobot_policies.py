"""pi0.5 and SmolVLA as actors: LeRobot's own numbers, ratios, gradients, the cache."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import ClipPPOLoss
from vla_cases import KINDS, actor, rows, slopes, still

from rlco.errors import ConfigError, DataError
from rlco.losses import CoTrainingLoss, ImitationLoss, log_probs
from rlco.policies.vla.lerobot.policy import LeRobotPolicy
from rlco.policies.vla.prefix_cache import PREFIX, SUMMARY
from rlco.policies.vla.prefix_critic import PrefixCritic

pytestmark = pytest.mark.slow

both = pytest.mark.parametrize("kind", KINDS)


def rollout(policy: LeRobotPolicy, count: int = 4) -> TensorDictBase:
    """Return observations with what the policy wrote, as the simulator would."""
    torch.manual_seed(0)
    return policy(rows(count).exclude("vla_action"))


def log_prob(policy: LeRobotPolicy, td: TensorDictBase) -> torch.Tensor:
    return policy.get_dist(td).log_prob(td["vla_action", "sample"])


# -- The same numbers as LeRobot's own code ---------------------------------------


@both
def test_chains_without_noise_are_lerobots_own_sampling(kind: str) -> None:
    policy = still(kind)
    torch.manual_seed(1)
    td = rows(3)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        chain = policy(td)["vla_action", "sample"]
    batch, model = policy.inputs.observe(td), policy.policy.model
    texts = (
        batch["observation.language.tokens"],
        batch["observation.language.attention_mask"],
    )
    with torch.no_grad():
        if kind == "smolvla":
            images = policy.policy.prepare_images(batch)
            state = policy.policy.prepare_state(batch)
            theirs = model.sample_actions(*images, *texts, state, noise=chain[:, 0])
        else:
            images = policy.policy._preprocess_images(batch)
            theirs = model.sample_actions(*images, *texts, noise=chain[:, 0])
    torch.testing.assert_close(chain[:, -1], theirs, atol=2e-6, rtol=1e-5)
    raw = theirs[:, :4, :7].clamp(-1, 1)  # these statistics change nothing
    torch.testing.assert_close(td["action"], raw, atol=2e-6, rtol=1e-5)


@both
def test_imitation_is_lerobots_own_loss(kind: str) -> None:
    policy, td = still(kind), rows(3)
    model = policy.policy.model
    torch.manual_seed(2)
    ours = policy.imitation_loss(td)
    torch.manual_seed(2)
    batch = policy.inputs.observe(td)
    target = torch.nn.functional.pad(td["vla_action", "chunk"], (0, 25))
    noise = model.sample_noise(target.shape, "cpu")
    time = model.sample_time(3, "cpu")
    texts = (
        batch["observation.language.tokens"],
        batch["observation.language.attention_mask"],
    )
    if kind == "smolvla":
        images = policy.policy.prepare_images(batch)
        texts = (*texts, policy.policy.prepare_state(batch))
    else:
        images = policy.policy._preprocess_images(batch)
    theirs = model.forward(*images, *texts, target, noise, time)
    torch.testing.assert_close(ours, theirs[..., :7].mean(-1), atol=1e-5, rtol=1e-4)
    policy.padded_mean = True
    torch.manual_seed(2)
    padded = policy.imitation_loss(td)
    torch.testing.assert_close(padded, theirs.mean(-1), atol=1e-5, rtol=1e-4)


# -- Log-probabilities ---------------------------------------------------------------


@both
@pytest.mark.parametrize("dtype", ["float32", "bfloat16"])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"denoise_reduction": "sum", "log_prob_level": "action"},
        {"method": "flow_sde", "log_prob_level": "token"},
        {"method": "flow_sde", "noisy_steps": "one", "denoise_reduction": "sum"},
        {"noisy_steps": "one"},
    ],
)
def test_the_first_ratio_is_one(kind: str, dtype: str, options: dict[str, Any]) -> None:
    policy = still(kind, dtype=dtype, **options)
    td = rollout(policy, 6)
    old = log_probs(policy, td, rows=3)
    # The first minibatch of a shuffled rollout is rows of every split.
    new = log_prob(policy, td[torch.tensor([5, 0, 2])])
    chosen = old[torch.tensor([5, 0, 2])]
    assert float((new - chosen).exp().sub(1).abs().max()) < 1e-5


@both
def test_a_log_probability_is_that_of_its_gaussian_steps(kind: str) -> None:
    policy = still(kind, steps=2)
    td = rollout(policy, 2)
    chain, prefix = td["vla_action", "sample"], policy.prefix(td)
    normal = torch.distributions.Normal
    terms = [normal(0.0, 1.0).log_prob(chain[:, 0])]
    for k, time in enumerate((1.0, 0.5)):
        velocity, state = policy.model.velocity(
            prefix, chain[:, k], torch.full((2,), time)
        )
        step = normal(chain[:, k] - 0.5 * velocity, policy.noise(state))
        terms.append(step.log_prob(chain[:, k + 1]))
    # Four of eight steps are executed, seven of 32 numbers are real.
    by_hand = sum(term[:, :4, :7].sum((1, 2)) for term in terms) / 3
    torch.testing.assert_close(log_prob(policy, td), by_hand, atol=1e-4, rtol=1e-5)
    torch.testing.assert_close(
        td["vla_action", "log_probs"], by_hand, atol=1e-4, rtol=1e-5
    )


@both
@pytest.mark.parametrize("trained", ["expert", "full"])
def test_gradients_are_those_of_finite_differences(kind: str, trained: Any) -> None:
    policy = actor(kind, trained=trained, denoise_reduction="sum")
    td = rollout(policy, 2)
    td["vla_action", "sample"] = td["vla_action", "sample"] + 0.05
    slope, measured = slopes(policy, lambda: log_prob(policy, td).double().sum())
    assert slope == pytest.approx(measured, rel=1e-3)


# -- The prefix ------------------------------------------------------------------------


@both
@pytest.mark.parametrize("dtype", ["float32", "bfloat16"])
def test_a_kept_prefix_changes_no_log_probability_and_no_gradient(
    kind: str, dtype: str
) -> None:
    policy = still(kind, dtype=dtype)
    td = rollout(policy)
    expert = [p for p in policy.parameters() if p.requires_grad]
    kept = log_prob(policy, td)
    anew = log_prob(policy, td.exclude(PREFIX))
    assert torch.equal(kept, anew)
    first = torch.autograd.grad(kept.sum(), expert, materialize_grads=True)
    second = torch.autograd.grad(anew.sum(), expert, materialize_grads=True)
    assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


@both
def test_an_earlier_decisions_prefix_is_not_taken_for_the_present_one(
    kind: str,
) -> None:
    policy = still(kind)
    td = rollout(policy)
    td["observation", "image"] = 255 - td["observation", "image"]
    fresh = policy(td.select("observation", "instruction_id"))
    again = policy(td)
    assert torch.equal(again[PREFIX, "keys"], fresh[PREFIX, "keys"])


@both
def test_a_kept_prefix_needs_no_observation(kind: str) -> None:
    policy = still(kind)
    td = rollout(policy)
    update = td.select(*policy.replay_keys)
    assert "observation" not in set(update.keys())
    assert torch.equal(log_prob(policy, update), log_prob(policy, td))


@both
def test_experts_alone_are_trained_and_the_prefix_stays(kind: str) -> None:
    policy = actor(kind)
    td = rollout(policy)
    log_prob(policy, td.exclude(PREFIX)).sum().backward()
    for module in policy.model.prefix_modules():
        assert all(p.grad is None for p in module.parameters())
    moved = [p for p in policy.policy.parameters() if p.grad is not None]
    assert sum(float(p.grad.abs().sum() > 0) for p in moved) > 10


@both
def test_training_all_reaches_the_images(kind: str) -> None:
    checkpointed = actor(kind, trained="full")
    # SmolVLA's own configuration freezes its language model.
    for parameter in checkpointed.policy.parameters():
        parameter.requires_grad_(True)
    policy = checkpointed
    policy.keep_prefix = False
    td = rollout(policy)
    assert set(td[PREFIX].keys()) == {"summary"}
    log_prob(policy, td).sum().backward()
    names = ("vision_model", "vision_tower")
    seen = [
        p.grad
        for name, p in policy.policy.named_parameters()
        if any(part in name for part in names) and p.grad is not None
    ]
    assert sum(float(g.abs().sum()) for g in seen) > 0


@both
def test_evaluation_keeps_no_prefix(kind: str) -> None:
    policy = still(kind)
    td = rollout(policy)
    assert "keys" in td[PREFIX]
    # An environment hands back what was written one decision before.
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        policy(td)
    assert set(td[PREFIX].keys()) == {"summary"}
    torch.testing.assert_close(td[SUMMARY], policy.new_summary(td))


@both
def test_a_prefix_of_weights_that_are_trained_is_refused(kind: str) -> None:
    policy = actor(kind)
    td = rollout(policy)
    for module in policy.model.prefix_modules():
        module.requires_grad_(True)
    with pytest.raises(ConfigError, match="keep_prefix=False"):
        log_prob(policy, td)


@both
def test_the_text_and_the_image_matter(kind: str) -> None:
    policy = still(kind)
    td = rollout(policy).exclude(PREFIX)
    before = log_prob(policy, td)
    other = td.clone()
    other["instruction_id"] = 1 - td["instruction_id"]
    assert not torch.allclose(log_prob(policy, other), before, atol=1e-6)
    other = td.clone()
    other["observation", "image"] = 255 - td["observation", "image"]
    assert not torch.allclose(log_prob(policy, other), before, atol=1e-6)


# -- In the losses -----------------------------------------------------------------


@both
def test_co_training_adds_both_gradients(kind: str) -> None:
    policy = actor(kind)
    critic = PrefixCritic(policy.model.summary_size, hidden=(16,))
    td = rollout(policy)
    td["vla_action", "log_probs"] = log_probs(policy, td)
    td["advantage"] = torch.tensor([[1.0], [-1.0], [0.5], [-0.5]])
    td = critic(td)
    td["value_target"] = td["state_value"].detach() + 1.0
    ppo = ClipPPOLoss(policy, critic, functional=False, entropy_bonus=False)
    anchor = ImitationLoss(policy, functional=False)
    loss = CoTrainingLoss(ppo, anchor, real_coeff=0.2)
    real = rows(3)
    expert = [p for p in policy.policy.parameters() if p.requires_grad]

    def gradient(terms: Any) -> torch.Tensor:
        torch.manual_seed(5)
        found = torch.autograd.grad(terms(), expert, materialize_grads=True)
        return torch.cat([g.flatten() for g in found])

    joint = gradient(
        lambda: sum(
            v
            for k, v in loss(TensorDict({"sim": td, "real": real})).items()
            if k.startswith("loss_")
        )
    )
    alone = gradient(lambda: ppo(td)["loss_objective"])
    imitation = gradient(lambda: anchor(real)["loss_bc"])
    assert float(alone.norm()) > 0
    assert float(imitation.norm()) > 0
    torch.testing.assert_close(joint, alone + 0.2 * imitation, atol=1e-6, rtol=1e-4)


@both
def test_critics_read_what_the_policy_wrote_and_do_not_move_it(kind: str) -> None:
    policy = actor(kind)
    td = rollout(policy)
    critic = PrefixCritic(policy.model.summary_size, hidden=(16,))
    critic(td)["state_value"].sum().backward()
    assert all(p.grad is None for p in policy.parameters())
    mask, hidden = td[PREFIX, "mask"], td[SUMMARY]
    assert hidden.shape == (4, policy.model.summary_size)
    assert bool(mask.any(1).all())


# -- What is refused ---------------------------------------------------------------


@both
def test_gradient_checkpointing_is_refused(kind: str) -> None:
    policy = actor(kind)
    model = policy.policy.model
    if kind == "smolvla":  # LeRobot has no switch of its own; transformers has
        model = model.vlm_with_expert.vlm
    model.gradient_checkpointing_enable()
    with pytest.raises(ConfigError, match="gradient_checkpointing=false"):
        policy(rows(2))


@both
def test_chunks_of_another_length_are_refused(kind: str) -> None:
    with pytest.raises(DataError, match="load the data with chunk=8"):
        still(kind).imitation_loss(rows(2, chunk=5))


@both
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"executed": 9}, "executed=9 must be 1 to 8"),
        ({"executed": 0}, "executed=0 must be 1 to 8"),
        ({"steps": 0}, "steps=0 must be at least 1"),
        ({"trained": "half"}, "unknown trained 'half'"),
        ({"method": "fpo2"}, "unknown method 'fpo2'"),
        ({"noise_range": (0.0, 0.1)}, "0 < least <= greatest"),
        ({"instructions": ()}, "without a text"),
        ({"camera": "observation.images.wrist"}, "observation.images.front"),
    ],
)
def test_wrong_options_are_refused(
    kind: str, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        still(kind, **options)


def test_an_instruction_that_is_not_known_is_refused() -> None:
    td = rows(2)
    td["instruction_id"] = torch.tensor([0, 2])
    with pytest.raises(DataError, match="knows 2 instructions"):
        still("smolvla")(td)
