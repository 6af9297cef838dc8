"""Stage II: what reinforcement learning anchored to real demonstrations consists of."""

from __future__ import annotations

import logging
import math
from typing import TYPE_CHECKING, Any, NamedTuple

from rlco import keys
from rlco.errors import ConfigError
from rlco.files.indices import format_indices, index_list
from rlco.training.options.domain_flag_options import refuse_domain_flag
from rlco.training.options.policy_options import (
    augment,
    check_look,
    check_real_camera,
    check_rendered,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from torchrl.objectives import ClipPPOLoss

    from rlco.data import DemoReplayBuffer
    from rlco.losses import CoTrainingLoss
    from rlco.policies import ChunkPolicy
    from rlco.training.distributed.ranks import Ranks
    from rlco.training.learner import Learner
    from rlco.training.options.stage_two_options import (
        AnchoredOptions,
        RolloutOptions,
        StageTwoOptions,
    )


log = logging.getLogger("rlco.training")


class StageTwoDemos(NamedTuple):
    """Real demonstrations of Stage II: the anchor's, and those never trained on."""

    real: DemoReplayBuffer | None
    heldout: DemoReplayBuffer | None


def stage_two_problems(options: AnchoredOptions) -> list[str]:
    """Return what the options contradict each other in."""
    problems = []
    if options.advantage == "mc" and options.num_envs % options.group_size:
        problems.append(
            f"num_envs={options.num_envs} is not a multiple of "
            f"group_size={options.group_size}, as advantage='mc' needs"
        )
    if options.real_coeff > 0 and options.real_demos is None:
        problems.append(
            f"real_coeff={options.real_coeff} needs real_demos=FOLDER; "
            "real_coeff=0 is reinforcement learning alone"
        )
    return problems


def check_stage_two(options: StageTwoOptions) -> None:
    """Check what the options say of each other.

    Raises:
        ConfigError: They contradict each other; every problem is reported.
    """
    problems = stage_two_problems(options)
    if options.forget_limit is not None and options.real_coeff == 0:
        problems.append(
            f"forget_limit={options.forget_limit} adapts the weight of the anchor, but "
            "real_coeff=0 leaves none; give where it begins, such as real_coeff=0.05"
        )
    if options.heldout_episodes and options.heldout_demos is None:
        problems.append(
            f"heldout_episodes={options.heldout_episodes} needs heldout_demos=FOLDER, "
            "which may be that of real_demos"
        )
    if problems:
        raise ConfigError(problems)


def load_stage_two(options: StageTwoOptions) -> tuple[ChunkPolicy, StageTwoDemos]:
    """Load the policy and the demonstrations, and check that they fit the task.

    Raises:
        ConfigError: Options that cannot be, or a policy that reads a domain flag.
        CheckpointError: A policy that cannot be loaded, or is of another task.
        DataError: A data set that does not fit the task.
    """
    from rlco.data import load_task_demos
    from rlco.data.image_warnings import say_drawn_otherwise
    from rlco.physics.spec.domain import FINAL_DOMAINS
    from rlco.physics.tasks.named_task import named_task
    from rlco.policies import load_task_policy
    from rlco.training.pretraining import with_features

    task = named_task(options.task)
    policy = load_task_policy(options.policy, task)
    refuse_domain_flag(policy, options.policy)
    make_critic(options, policy)  # whether such a policy can have it shows here
    check_stage_two(options)
    check_rendered(policy, options.task)
    check_look(options.look, policy.image_size)
    check_real_camera(options.real_camera, policy.image_size)
    if options.look in FINAL_DOMAINS:
        raise ConfigError(
            [
                f"look={options.look} is for final evaluations alone; train with "
                "look=random, or leave it out"
            ]
        )
    check_images(options, policy)

    def load(path: str | None, episodes: list[int] | None) -> DemoReplayBuffer | None:
        if path is None:
            return None
        return load_task_demos(
            path,
            task,
            chunk=policy.chunk,
            episodes=episodes,
            rename=options.rename,
            image_size=policy.image_size,
            camera=options.real_camera,
            cameras=policy.cameras or ("agentview",),
            environment_state=keys.ENVIRONMENT_STATE in policy.in_keys,
        )

    demos = StageTwoDemos(
        load(options.real_demos, index_list(options.episodes)),
        load(
            options.heldout_demos,
            index_list(options.heldout_episodes, "heldout_episodes"),
        ),
    )
    augment(options, demos.real)
    if policy.image_size is not None:
        say_drawn_otherwise(demos, policy.renderer)
    if options.image_fixed:
        policy.fix_images()
        demos = StageTwoDemos(*(one and with_features(policy, one) for one in demos))
    if options.horizon is not None and demos.real is not None:
        warn_of_cut_off(options.horizon, demos.real)
    return policy, demos


def check_images(options: StageTwoOptions, policy: ChunkPolicy) -> None:
    """Check that options of images are those of a policy that reads some.

    Raises:
        ConfigError: They contradict the policy, or each other.
    """
    wanted = {
        "augment=true": options.augment,
        "image_fixed=true": options.image_fixed,
        f"image_lr={options.image_lr}": options.image_lr != 1.0,
    }
    given = [name for name, is_wanted in wanted.items() if is_wanted]
    if given and policy.image_size is None:
        raise ConfigError(
            [
                f"{given[0]} is of images, but policy {options.policy!r} reads none; "
                "leave it out"
            ]
        )
    if options.image_fixed and len(given) > 1:
        other = next(name for name in given if name != "image_fixed=true")
        raise ConfigError(
            [
                f"image_fixed=true reads images once, by an encoder that stays, and "
                f"{other} would change that; give one of them"
            ]
        )


def warn_of_cut_off(horizon: int, demos: DemoReplayBuffer) -> None:
    """Warn where training episodes end before most demonstrations do."""
    lengths = demos.meta.episode_lengths
    longer = sum(length > horizon for length in lengths)
    if longer > len(lengths) / 2:
        log.warning(
            "%d of %d demonstrations in %s last longer than horizon=%d, the longest "
            "%d control steps: RL will not see a task solved that takes as long; give "
            "a longer horizon, or leave it out",
            longer,
            len(lengths),
            demos.meta.path,
            horizon,
            max(lengths),
        )


def warn_of_trained_on(
    real: DemoReplayBuffer | None, heldout: DemoReplayBuffer | None
) -> None:
    """Warn where episodes that are to be held out are the anchor's.

    Args:
        real: Demonstrations of the anchor; None without one.
        heldout: Those that forgetting is measured on, if it is.
    """
    if real is None or heldout is None:
        return
    if real.meta.path.resolve() != heldout.meta.path.resolve():
        return
    if both := set(real.meta.episodes) & set(heldout.meta.episodes):
        log.warning(
            "the anchor is trained on episodes %s of %s, on which forgetting is "
            "measured: its columns _heldout look better than they are; part them by "
            "episodes= and heldout_episodes=",
            format_indices(both),
            heldout.meta.path,
        )


def make_critic(options: StageTwoOptions, policy: ChunkPolicy) -> Any:
    """Return the critic, None where the advantages need none."""
    from rlco.physics.tasks.named_task import named_task
    from rlco.policies import ValueHead, ValueNetwork, task_sizes

    if options.advantage == "mc":
        return None
    hidden, time_left = options.critic_hidden, options.time_left
    if options.critic == "head":
        return ValueHead(policy, hidden=hidden, time_left=time_left)
    sizes: dict[str, Any] = task_sizes(named_task(options.task))
    # The simulator knows the poses, whether or not the policy may: no need of images.
    knows_poses = bool(sizes["environment_state_size"])
    image = None if knows_poses else policy.arguments.get("image")
    critic = ValueNetwork(hidden=hidden, image=image, time_left=time_left, **sizes)
    # What both read they normalise alike.
    critic.encoder.load_state_dict(policy.encoder.state_dict(), strict=False)
    return critic


def fix_pose_range(
    critic: Any, policy: ChunkPolicy, ranks: Ranks | None = None
) -> Callable[[Any], None] | None:
    """Return what fixes a critic's range of poses by the first rollout it is given.

    Of several ranks it is the range of all their rollouts.

    None where no critic reads poses, or the policy has brought their range: one that
    reads images alone knows none. What the first rollout fixes is in all checkpoints.
    """
    pose = keys.ENVIRONMENT_STATE
    if critic is None or pose not in critic.in_keys or pose in policy.in_keys:
        return None
    waiting = [critic]

    def fix(rollout: Any) -> None:
        from rlco.data import exact_quantiles

        for one in waiting:
            poses = rollout[pose].flatten(0, 1)
            if ranks is not None:
                poses = ranks.joined(poses)
            quantiles = exact_quantiles(poses.numpy())
            one.set_normalization(environment_state=quantiles)
        waiting.clear()

    return fix


def rollout_rows(options: RolloutOptions, chunk: int) -> int:
    """Return how many decisions a rollout has, of so many control steps each."""
    from rlco.physics.tasks.named_task import training_horizon

    horizon = training_horizon(options.task, options.horizon)
    return options.num_envs * math.ceil(horizon / chunk)


def make_ppo(
    policy: Any, critic: Any, *, clip: float, functional: bool = True
) -> ClipPPOLoss:
    """Return PPO's clipped loss as all of Stage II has it: no bonus for entropy."""
    from torchrl.objectives import ClipPPOLoss

    return ClipPPOLoss(
        policy,
        critic,
        functional=functional,
        clip_epsilon=clip,
        entropy_bonus=False,
        critic_coeff=1.0 if critic is not None else None,
        loss_critic_type="l2",
    )


def make_learner(
    options: StageTwoOptions,
    loss: CoTrainingLoss,
    policy: ChunkPolicy,
    critic: Any,
    real: DemoReplayBuffer | None,
    *,
    rows: int,
    ranks: Ranks | None = None,
) -> Learner:
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

    from rlco.data import SimRealReplayBuffer
    from rlco.training.anchor_weight import AnchorWeight
    from rlco.training.distributed.ranks import Ranks
    from rlco.training.learner import Learner

    limit = options.forget_limit
    anchor = None
    if limit is not None and real is not None:
        anchor = AnchorWeight(limit, policy, real.frames())
    batch_size = options.minibatch + (options.real_rows if real is not None else 0)
    buffer = SimRealReplayBuffer(
        ReplayBuffer(storage=LazyTensorStorage(rows * (1 + options.reuse))),
        real,
        sim_ratio=options.minibatch / batch_size,
        batch_size=batch_size,
    )
    return Learner(
        policy,
        critic,
        loss,
        buffer,
        torch.optim.Adam(_rates(options, policy), lr=options.lr),
        None
        if critic is None
        else torch.optim.Adam(critic.own_parameters(), lr=options.critic_lr),
        minibatch=options.minibatch,
        max_grad_norm=options.max_grad_norm,
        target_kl=options.target_kl,
        lr_final=options.lr_final,
        reuse=options.reuse,
        anchor=anchor,
        ranks=Ranks() if ranks is None else ranks,
    )


def _rates(options: StageTwoOptions, policy: ChunkPolicy) -> Any:
    """Return the policy's parameters, its images' apart where they learn slower."""
    if options.image_lr == 1.0:
        return policy.parameters()
    images = [p for one in policy.encoder.image_encoders() for p in one.parameters()]
    apart = {id(parameter) for parameter in images}
    others = [p for p in policy.parameters() if id(p) not in apart]
    return [{"params": others}, {"params": images, "lr": options.image_lr * options.lr}]
