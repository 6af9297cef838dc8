"""Stage II of a LeRobot checkpoint: its demonstrations, and what follows its loss."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from torch import nn
    from torchrl.data import ReplayBuffer

    from rlco.losses import CoTrainingLoss
    from rlco.physics.spec.task import Task
    from rlco.policies.vla.lerobot.policy import LeRobotPolicy
    from rlco.training.distributed.ranks import Ranks
    from rlco.training.large_learner import LargeLearner


class LargeOptions(Protocol):
    """Sizes, learning rates and clips of a large model's updates."""

    policy: str
    minibatch: int
    real_rows: int
    accumulate: int
    lr: float
    critic_lr: float
    max_grad_norm: float


def statistics_of(folder: str | None) -> Any:
    """Return the statistics of a data set's states and actions, None of none."""
    from rlco.lerobot_files import LARGEST, read_columns, read_folder
    from rlco.policies.vla.lerobot.inputs import dataset_stats

    if folder is None:
        return None
    state, action = "observation.state", "action"
    columns = read_columns(read_folder(folder), (state, action), largest=LARGEST)
    return dataset_stats(state=columns[state], action=columns[action])


def load_real(
    path: str, task: Task, policy: LeRobotPolicy, *, camera: str | None, rows: int
) -> ReplayBuffer:
    """Load real demonstrations, and keep their prefixes where these are frozen.

    Args:
        path: LeRobot folder.
        task: Gives instructions and the control frequency.
        policy: Says what it reads.
        camera: The data set's name of the camera; None: the policy's.
        rows: Frames whose prefixes are computed at once.

    Raises:
        DataError: The data set does not fit the task or the policy.
    """
    from rlco.data import load_demos
    from rlco.data.task_demos import check_commands
    from rlco.policies.vla.prefix_cache import with_prefixes

    demos = load_demos(
        path,
        chunk=policy.chunk,
        instructions=task.instructions,
        action_dim=policy.action_size,
        state_dim=policy.inputs.state_size,
        image_key=camera or policy.inputs.camera,
    )
    check_commands(demos, task)
    if not policy.keep_prefix:
        return demos
    return with_prefixes(demos.frames(), policy.new_prefix, rows=rows)


def restore_beside(folder: str, **modules: nn.Module | None) -> None:
    """Load what a former Stage II saved beside a checkpoint, where there is some.

    Args:
        folder: The checkpoint's.
        **modules: By their names there: ``critic``, ``noise``; None are left out.
    """
    from rlco.policies.vla.lerobot.export import load_beside

    for name, module in modules.items():
        saved = load_beside(folder, name)
        if module is not None and saved is not None:
            module.load_state_dict(saved)


def make_large_learner(
    options: LargeOptions,
    loss: CoTrainingLoss,
    policy: LeRobotPolicy,
    critic: Any,
    real: ReplayBuffer | None,
    *,
    rows: int,
    ranks: Ranks | None = None,
) -> LargeLearner:
    """Return what follows the loss: minibatches of rollouts, and an optimiser each.

    Args:
        options: Sizes, learning rates and clips.
        loss: PPO on ``sim``, imitation on ``real`` where there is an anchor.
        policy: The actor of the loss.
        critic: Its critic, None with critic-free advantages.
        real: The anchor's demonstrations; None without one.
        rows: Decisions of a rollout.
        ranks: The processes that learn together, of which the options are one's.
    """
    import torch
    from torchrl.data import LazyTensorStorage, ReplayBuffer
    from torchrl.envs.transforms import DeviceCastTransform

    from rlco.data import SimRealReplayBuffer
    from rlco.training.distributed.ranks import Ranks
    from rlco.training.large_learner import LargeLearner
    from rlco.training.master_weights import MasterWeightAdamW

    sim = ReplayBuffer(storage=LazyTensorStorage(rows))
    for member in (sim, real):
        if member is not None:  # the rows stay in memory, minibatches are moved
            member.append_transform(DeviceCastTransform(policy.device))
    batch_size = options.minibatch + (options.real_rows if real is not None else 0)
    # LeRobot's own, but for weights that are too coarse for steps of this size.
    preset = asdict(policy.policy.config.get_optimizer_preset()) | {"lr": options.lr}
    del preset["grad_clip_norm"]
    beside = [*policy.noise.parameters(), *(critic.parameters() if critic else ())]
    return LargeLearner(
        policy,
        critic,
        loss,
        SimRealReplayBuffer(
            sim, real, sim_ratio=options.minibatch / batch_size, batch_size=batch_size
        ),
        MasterWeightAdamW(policy.policy.parameters(), **preset),
        torch.optim.Adam(beside, lr=options.critic_lr),
        minibatch=options.minibatch,
        max_grad_norm=options.max_grad_norm,
        accumulate=options.accumulate,
        ranks=Ranks() if ranks is None else ranks,
    )
