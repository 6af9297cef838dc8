"""What Stage II puts around a LeRobot checkpoint: data, critic, loss, optimisers."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rlco.errors import DataError

if TYPE_CHECKING:
    from lerobot_co_train import Config

    from rlco.losses.large_learner import LargeLearner


def statistics_of(folder: str | None) -> Any:
    """Return the statistics of a data set's states and actions, None of none."""
    from rlco.lerobot_files import read_columns, read_folder
    from rlco.policies.lerobot_inputs import dataset_stats

    if folder is None:
        return None
    state, action = "observation.state", "action"
    columns = read_columns(read_folder(folder), (state, action))
    return dataset_stats(state=columns[state], action=columns[action])


def load_real(config: Config, task: Any, policy: Any) -> Any:
    """Load the real demonstrations, and keep their prefixes where these are frozen."""
    from rlco.data import load_demos
    from rlco.policies.prefix_cache import with_prefixes

    if config.real_coeff == 0 or config.real_demos is None:
        return None
    demos = load_demos(
        config.real_demos,
        chunk=policy.chunk,
        instructions=task.instructions,
        action_dim=policy.action_size,
        state_dim=policy.inputs.state_size,
        image_key=config.real_camera or policy.inputs.camera,
    )
    if demos.meta.fps != task.control_frequency:
        raise DataError(
            f"data set {config.real_demos!r} has {demos.meta.fps:g} frames a second, "
            f"but {task.name!r} is controlled at {task.control_frequency} Hz; record "
            "or resample it at that rate, as an action chunk counts frames."
        )
    if not policy.keep_prefix:
        return demos
    return with_prefixes(demos.frames(), policy.new_prefix, rows=config.minibatch)


def make_learner(config: Config, policy: Any, real: Any, rows: int) -> LargeLearner:
    """Put critic, loss, buffer and optimisers around a policy."""
    import torch
    from torchrl.data import LazyTensorStorage, ReplayBuffer
    from torchrl.envs.transforms import DeviceCastTransform
    from torchrl.objectives import ClipPPOLoss

    from rlco.data import SimRealReplayBuffer
    from rlco.losses import CoTrainingLoss, ImitationLoss, MasterWeightAdamW
    from rlco.losses.large_learner import LargeLearner
    from rlco.policies.lerobot_export import load_beside
    from rlco.policies.prefix_critic import PrefixCritic

    critic = None
    if config.advantage == "gae":
        critic = PrefixCritic(policy.model.summary_size).to(policy.device)
    for name, module in (("critic", critic), ("noise", policy.noise)):
        saved = load_beside(config.policy, name)
        if module is not None and saved is not None:
            module.load_state_dict(saved)
    sim = ReplayBuffer(storage=LazyTensorStorage(rows))
    for member in (sim, real):
        if member is not None:  # the rows stay in memory, minibatches are moved
            member.append_transform(DeviceCastTransform(policy.device))
    batch_size = config.minibatch + (config.real_rows if real is not None else 0)
    # Not functional: billions of weights are trained where they are.
    ppo = ClipPPOLoss(
        policy,
        critic,
        functional=False,
        clip_epsilon=config.clip,
        entropy_bonus=False,
        critic_coeff=1.0 if critic is not None else None,
        loss_critic_type="l2",
    )
    anchor = ImitationLoss(policy, functional=False) if real is not None else None
    # LeRobot's own, but for weights that are too coarse for steps of this size.
    preset = asdict(policy.policy.config.get_optimizer_preset()) | {"lr": config.lr}
    del preset["grad_clip_norm"]
    beside = [*policy.noise.parameters(), *(critic.parameters() if critic else ())]
    return LargeLearner(
        policy,
        critic,
        CoTrainingLoss(ppo, anchor, real_coeff=config.real_coeff if anchor else 0.0),
        SimRealReplayBuffer(
            sim, real, sim_ratio=config.minibatch / batch_size, batch_size=batch_size
        ),
        MasterWeightAdamW(policy.policy.parameters(), **preset),
        torch.optim.Adam(beside, lr=config.critic_lr),
        minibatch=config.minibatch,
        max_grad_norm=config.max_grad_norm,
        accumulate=config.accumulate,
    )
