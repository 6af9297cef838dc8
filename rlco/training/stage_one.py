"""Stage I: imitation of simulated and real demonstrations, mixed by sim_ratio."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any, NamedTuple

from rlco.errors import ConfigError
from rlco.files.indices import format_indices, index_list
from rlco.runs.options import rename_map
from rlco.training.options import policy_options
from rlco.training.options.domain_flag_options import check_domain_flag
from rlco.training.options.policy_options import camera_list

if TYPE_CHECKING:
    from rlco.data import DemoReplayBuffer, SimRealReplayBuffer
    from rlco.data.recorded_task import RecordedTask
    from rlco.losses import CoTrainingLoss
    from rlco.physics.robosuite.tasks import RobosuiteTask
    from rlco.physics.spec.task import Task
    from rlco.policies import ChunkPolicy
    from rlco.training.options.stage_one_options import StageOneOptions
    from rlco.training.pretraining import PositionTerm
    from rlco.training.run_protocols import TrainingRun


log = logging.getLogger("rlco.training")

#: Which option selects the episodes of which data set.
_EPISODES = {
    "sim_demos": "sim_episodes",
    "real_demos": "episodes",
    "heldout_demos": "heldout_episodes",
}

type AnyTask = Task | RobosuiteTask | RecordedTask


class StageOneDemos(NamedTuple):
    """A task and demonstrations of it for Stage I; None where they have no share."""

    task: AnyTask
    sim: DemoReplayBuffer | None
    real: DemoReplayBuffer | None
    heldout: DemoReplayBuffer | None = None

    def present(self) -> list[DemoReplayBuffer]:
        """Return those that are trained on."""
        return [demos for demos in (self.sim, self.real) if demos is not None]


def task_of(options: StageOneOptions) -> AnyTask:
    """Return the task that the options name, or the one that their data describe.

    Raises:
        UnknownNameError: There is no such task.
        ConfigError: No task is named and there is something to evaluate.
        DataError: The data sets cannot be read, or are not of one robot.
    """
    from rlco.data.recorded_task import recorded_task
    from rlco.lerobot_files import read_folder
    from rlco.physics.tasks.named_task import named_task

    if options.task is not None:
        return named_task(options.task)
    if options.evaluated:
        raise ConfigError(
            [
                f"task=null has no simulator for eval_episodes={options.evaluated}; "
                "leave it out, or give eval_episodes=0"
            ]
        )
    theirs = rename_map(options.rename)
    renames = {"sim_demos": {}, "real_demos": theirs, "heldout_demos": theirs}
    return recorded_task(
        {
            name: read_folder(getattr(options, name), rename=renames[name])
            for name, need in _needs(options).items()
            if need
        }
    )


def new_policy(options: StageOneOptions, task: AnyTask | None = None) -> ChunkPolicy:
    """Return a new policy of the kind and the size that the options give."""
    task = task or task_of(options)
    return policy_options.new_policy(
        options,
        task=task,
        chunk=options.chunk,
        hidden=list(options.hidden),
        guidance=None if options.domain_flag is None else options.guidance,
    )


def check_stage_one(
    options: StageOneOptions, task: AnyTask | None = None
) -> ChunkPolicy:
    """Check what the options say of each other; return a policy that they describe."""
    from rlco.data.sim_real_buffer import batch_problems
    from rlco.training.pretraining_checks import check_pretraining

    policy_options.check_image_options(options)
    check_pretraining(options)
    check_domain_flag(options, options.alpha)
    if problems := batch_problems(options.alpha, options.batch_size):
        raise ConfigError(problems)
    policy = new_policy(options, task)
    policy_options.check_real_camera(options.real_camera, policy.image_size)
    if options.evaluated and options.eval_domains and options.task is not None:
        policy_options.check_rendered(policy, options.task)
    return policy


def load_stage_one(options: StageOneOptions) -> StageOneDemos:
    """Load the demonstrations that sim_ratio asks for, and check all options.

    Raises:
        ConfigError: Options that cannot be, or a data set that is not given.
        DataError: A data set that does not fit the task.
    """
    from rlco.data import load_task_demos
    from rlco.data.image_warnings import say_blind, say_drawn_otherwise
    from rlco.training.pretraining_checks import (
        check_positions,
        say_unlabelled,
    )

    needed = _needs(options)
    task = None if options.task is None else task_of(options)
    problems = [
        f"sim_ratio={options.alpha} needs {name}=FOLDER"
        for name, need in needed.items()
        if need and getattr(options, name) is None
    ]
    if options.heldout_episodes and options.heldout_demos is None:
        problems.append(
            f"heldout_episodes={options.heldout_episodes} needs heldout_demos=FOLDER, "
            "which may be that of real_demos"
        )
    if problems:
        raise ConfigError(problems)
    task = task or task_of(options)
    image_size = check_stage_one(options, task).image_size
    poses = options.use_environment_state and bool(task.environment_state_names)
    labelled = options.position_coeff > 0

    # Before the first of them is read.
    episodes = {
        name: index_list(getattr(options, option), option)
        for name, option in _EPISODES.items()
    }

    check_positions(options, task)
    cameras = camera_list(options.camera)

    def load(name: str, rename: str, camera: str | None) -> DemoReplayBuffer | None:
        if not needed[name]:
            return None
        return load_task_demos(
            getattr(options, name),
            task,
            chunk=options.chunk,
            episodes=episodes[name],
            rename=rename,
            image_size=image_size,
            camera=camera,
            cameras=cameras,
            environment_state=poses or (name == "sim_demos" and labelled),
        )

    # A set that was not recorded by rlco has a camera of another name, or one alone.
    sim_camera = options.camera if options.task is not None else None
    real = (options.rename, options.real_camera)
    demos = StageOneDemos(
        task,
        sim=load("sim_demos", "", sim_camera),
        real=load("real_demos", *real),
        heldout=load("heldout_demos", *real),
    )
    check_held_out(demos)
    if image_size is not None:
        say_drawn_otherwise(demos[1:], options.renderer)
        say_unlabelled(options)
    if image_size is None and not poses:
        say_blind(demos.present(), task.state_names)
    policy_options.augment(options, *demos.present())
    return demos


def check_held_out(demos: StageOneDemos) -> None:
    """Check that no held-out episode is trained on.

    Raises:
        ConfigError: Some are.
    """
    if demos.heldout is None:
        return
    held = demos.heldout.meta
    for one in demos.present():
        both = set(one.meta.episodes) & set(held.episodes)
        if one.meta.path.resolve() == held.path.resolve() and both:
            raise ConfigError(
                [
                    f"episodes {format_indices(both)} of {str(held.path)!r} are both "
                    "trained on and held out; part them by episodes= and "
                    "heldout_episodes="
                ]
            )


def _needs(options: StageOneOptions) -> dict[str, bool]:
    """Return which data sets are read, by their options' names."""
    return {
        "sim_demos": options.alpha > 0,
        "real_demos": options.alpha < 1,
        "heldout_demos": options.heldout_demos is not None,
    }


def train_stage_one(
    options: StageOneOptions, run: TrainingRun, demos: StageOneDemos
) -> ChunkPolicy:
    """Imitate demonstrations, and save the policy to the run's folder ``policy``.

    L = alpha L_BC(sim) + (1 - alpha) L_BC(real), alpha = sim_ratio.
    """
    from rlco.data import SimRealReplayBuffer
    from rlco.losses import CoTrainingLoss, ImitationLoss
    from rlco.policies import save_policy
    from rlco.training.pretraining import PositionTerm, pretrained_head, with_features

    policy = build_policy(options, demos)
    head = pretrained_head(options, run, policy, demos.task, demos.sim)
    positions = None
    if options.image_fixed:
        policy.fix_images()
        read = [one and with_features(policy, one) for one in demos[1:]]
        demos = StageOneDemos(demos.task, *read)
    if options.position_coeff and head is not None:
        positions = PositionTerm(demos.task, policy, head, options.position_coeff)
    # Before the losses copy it: rows then bring what the term made of their images.
    policy.encoder.reads_stored |= positions is not None
    buffer = SimRealReplayBuffer(
        demos.sim,
        demos.real,
        sim_ratio=options.alpha,
        batch_size=options.batch_size,
        domain_flag=options.domain_flag,
    )
    loss = CoTrainingLoss(
        ImitationLoss(policy) if demos.sim is not None else None,
        ImitationLoss(policy) if demos.real is not None else None,
        sim_coeff=options.alpha,
        real_coeff=1.0 - options.alpha,
    )
    imitate(options, run, policy, loss, buffer, demos.heldout, positions)
    policy.encoder.reads_stored = policy.images_fixed
    dropped = options.domain_flag
    flag = {} if dropped is None else {"domain_flag": dropped}
    save_policy(
        policy,
        run.path / "policy",
        extra={"sim_ratio": options.alpha, **flag, **demos.task.description()},
    )
    return policy


def build_policy(options: StageOneOptions, demos: StageOneDemos) -> ChunkPolicy:
    """Return a new policy, its normalisation fixed by the demonstrations."""
    from rlco import keys
    from rlco.data import exact_quantiles

    policy = new_policy(options, demos.task)
    frames = [one.frames() for one in demos.present()]

    def quantiles(key: Any) -> Any:
        return exact_quantiles(*(rows[key].numpy() for rows in frames))

    policy.set_normalization(
        state=quantiles(keys.STATE),
        environment_state=quantiles(keys.ENVIRONMENT_STATE)
        if keys.ENVIRONMENT_STATE in policy.in_keys
        else None,
        action=quantiles(keys.ACTION),
    )
    return policy


def imitate(
    options: StageOneOptions,
    run: TrainingRun,
    policy: ChunkPolicy,
    loss: CoTrainingLoss,
    buffer: SimRealReplayBuffer,
    heldout: DemoReplayBuffer | None = None,
    positions: PositionTerm | None = None,
) -> None:
    """Follow the loss for ``updates`` steps, from the run's last checkpoint on.

    Each row of metrics.csv has ``imitation_error_heldout`` where there is ``heldout``.

    Raises:
        NonFiniteError: The loss, its gradient or a weight is NaN or infinite. No step
            follows such a gradient.
    """
    import torch

    from rlco import keys
    from rlco.finite import check_step, check_weights, gradient_norm
    from rlco.training.imitation_errors import fixed_imitation_error

    trained = list(loss.parameters())
    if positions is not None:
        trained += positions.head.parameters()
    optimizer = torch.optim.AdamW(
        trained, lr=options.lr, weight_decay=options.weight_decay
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, options.updates)
    if (saved := run.load_checkpoint()) is not None:
        loss.load_state_dict(saved["loss"])
        optimizer.load_state_dict(saved["optimizer"])
        schedule.load_state_dict(saved["schedule"])
        buffer.load_state_dict(saved["buffer"])
        if positions is not None:
            positions.head.load_state_dict(saved["head"])
    blocks = -(-options.updates // options.log_every)

    def progress(block: int) -> str:
        done = min(block * options.log_every, options.updates)
        return f"{done} of {options.updates} updates"

    for block in run.iterations(blocks, progress):
        done = (block - 1) * options.log_every
        totals: dict[str, float] = {}
        for index in range(count := min(options.log_every, options.updates - done)):
            update = f"update {done + index + 1}"
            batch = buffer.sample()
            terms: dict[str, Any] = {}
            if positions is not None and keys.SIM in batch:
                terms["loss_position"] = positions(batch[keys.SIM])
            terms |= dict(loss(batch).items())
            optimizer.zero_grad()
            sum(terms.values()).backward()
            norms = [gradient_norm(trained)]
            check_step(update, terms.items(), norms, {"policy": policy})
            optimizer.step()
            schedule.step()
            for name, value in terms.items():
                totals[name] = totals.get(name, 0.0) + float(value.detach()) / count
        check_weights(update, {"policy": policy})
        if heldout is not None:
            error = fixed_imitation_error(policy, heldout.frames())
            totals["imitation_error_heldout"] = error
        run.log_metrics(block, {"updates": done + count, **totals})
        state = {
            "loss": dict(loss.state_dict()),
            "optimizer": optimizer.state_dict(),
            "schedule": schedule.state_dict(),
            "buffer": buffer.state_dict(rows=False),
        }
        if positions is not None:
            state["head"] = dict(positions.head.state_dict())
        run.save_checkpoint(block, state)
