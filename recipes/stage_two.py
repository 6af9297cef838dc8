"""What Stage II puts around a policy: critic, loss, buffer and optimisers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rlco import keys

if TYPE_CHECKING:
    from collections.abc import Callable

    from rl_co import Config

    from rlco.losses import Learner


def make_critic(config: Config, policy: Any) -> Any:
    """Return the critic, None where the advantages need none."""
    from rlco.physics.named_task import named_task
    from rlco.policies import ValueHead, ValueNetwork, task_sizes

    if config.advantage == "mc":
        return None
    if config.critic == "head":
        return ValueHead(policy, hidden=config.critic_hidden)
    sizes = task_sizes(named_task(config.task))
    # The simulator knows the poses, whether or not the policy may: no need of pictures.
    seen = bool(sizes["environment_state_size"])
    image = None if seen else policy.arguments.get("image")
    critic = ValueNetwork(hidden=config.critic_hidden, image=image, **sizes)
    # What both read they normalise alike.
    critic.encoder.load_state_dict(policy.encoder.state_dict(), strict=False)
    return critic


def fix_poses(critic: Any, policy: Any) -> Callable[[Any], None] | None:
    """Return what fixes a critic's range of poses by the first rollout it is given.

    None where no critic reads poses, or the policy has brought their range: one that
    sees pictures alone knows none. What the first rollout says is in all checkpoints.
    """
    pose = keys.ENVIRONMENT_STATE
    if critic is None or pose not in critic.in_keys or pose in policy.in_keys:
        return None
    waiting = [critic]

    def fix(rollout: Any) -> None:
        from rlco.data import exact_quantiles

        for one in waiting:
            quantiles = exact_quantiles(rollout[pose].flatten(0, 1).numpy())
            one.set_normalization(environment_state=quantiles)
        waiting.clear()

    return fix


def make_learner(
    config: Config, policy: Any, demos: dict[str, Any], rows: int
) -> Learner:
    """Put critic, loss, buffer and optimisers around a policy."""
    import torch
    from torchrl.data import LazyTensorStorage, ReplayBuffer
    from torchrl.objectives import ClipPPOLoss

    from rlco.data import SimRealReplayBuffer
    from rlco.losses import CoTrainingLoss, ImitationLoss, Learner

    critic = make_critic(config, policy)
    anchored = config.real_coeff > 0
    batch_size = config.minibatch + (config.real_rows if anchored else 0)
    buffer = SimRealReplayBuffer(
        ReplayBuffer(storage=LazyTensorStorage(rows)),
        demos["real_demos"] if anchored else None,
        sim_ratio=config.minibatch / batch_size,
        batch_size=batch_size,
    )
    ppo = ClipPPOLoss(
        policy,
        critic,
        clip_epsilon=config.clip,
        entropy_bonus=False,
        critic_coeff=1.0 if critic is not None else None,
        loss_critic_type="l2",
    )
    anchor = ImitationLoss(policy) if anchored else None
    return Learner(
        policy,
        critic,
        CoTrainingLoss(ppo, anchor, real_coeff=config.real_coeff),
        buffer,
        torch.optim.Adam(policy.parameters(), lr=config.lr),
        None
        if critic is None
        else torch.optim.Adam(critic.own_parameters(), lr=config.critic_lr),
        minibatch=config.minibatch,
        max_grad_norm=config.max_grad_norm,
    )
