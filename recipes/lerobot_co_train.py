"""Stage II on a LeRobot checkpoint of pi0.5 or SmolVLA: load, co-train, save it back.

    uv run recipes/lerobot_co_train.py policy=outputs/train/RUN/checkpoints/last/\
pretrained_model task=push_cube real_demos=demos/real
    lerobot-eval --policy.path=outputs/lerobot_co_train/RUN/lerobot/checkpoints/last/\
pretrained_model --env.type=rlco --env.task=push_cube --env.camera=front
    uv run torchrun --nproc-per-node=2 recipes/lerobot_co_train.py ... launch=torchrun

L = L_PPO(sim) + beta L_BC(D_real), beta = real_coeff (RL-Co, arXiv 2602.12628). The
checkpoint must solve the task now and then in the simulator before this can help:
train it on both kinds of demonstrations first (docs/vla.md says how).
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from rlco.errors import ConfigError
from rlco.run import Run, run_recipe
from rlco.runs.config import REQUIRED, folder_name, none_twice, option
from rlco.training.distributed.launch import LearnersOptions
from rlco.training.options.limits import (
    LARGEST_LR,
    LONGEST_EPISODE,
    MOST_ENVS,
    MOST_ROWS,
)
from rlco.training.options.training_domain_options import TrainingDomainOptions

if TYPE_CHECKING:
    from rlco.physics.spec.domain import Domain
    from rlco.policies.vla.lerobot.policy import LeRobotPolicy
    from rlco.training.distributed.following import FollowingRun
    from rlco.training.distributed.ranks import Ranks
    from rlco.training.large_learner import LargeLearner

log = logging.getLogger("rlco.lerobot_co_train")


@dataclass
class Config(LearnersOptions, TrainingDomainOptions):
    """Options of lerobot_co_train.py."""

    name: str = option(
        "co_train", "name of the run, a part of its folder's name", check=folder_name
    )
    policy: str = option(REQUIRED, "LeRobot's folder pretrained_model", input="folder")
    tokenizer: str | None = option(
        None, "folder of the tokenizer, for machines without network", input="folder"
    )
    allow_code: list[str] = option(
        [], "code of yours that its files may name, my_module.MyStep; it runs"
    )
    device: str | None = option(None, "cpu or cuda; null: the checkpoint's, or what is")
    camera: str | None = option(
        None, "the checkpoint's camera that sees the task; null: its only one"
    )
    task: str = option("push_cube", "name of the task")
    real_demos: str | None = option(
        None, "LeRobot folder of real demonstrations", input="folder"
    )
    real_camera: str | None = option(
        None, "camera of real_demos; null: the checkpoint's name for it"
    )
    real_coeff: float = option(0.2, "beta, weight of the real anchor", minimum=0)
    trained: Literal["expert", "lora", "full"] = option(
        "expert",
        "expert: what follows images and text; lora: adapters on that; full: all",
    )
    lora_rank: int = option(16, "rank of the adapters", minimum=1)
    keep_prefix: bool = option(
        True, "whether rollouts carry what a frozen language model said"
    )
    stats: str | None = option(
        None,
        "LeRobot folder whose statistics normalise, for a checkpoint without its own",
        input="folder",
    )
    executed: int | None = option(
        None, "steps of a chunk that are executed; null: the checkpoint's", minimum=1
    )
    method: Literal["flow_noise", "flow_sde"] = option(
        "flow_noise", "what stands for the log-probability"
    )
    steps: int | None = option(4, "denoising steps; null: the checkpoint's", minimum=1)
    noisy_steps: Literal["all", "one"] = option(
        "all", "denoising steps with noise: all, or one of each decision"
    )
    noise_range: list[float] = option(
        [0.08, 0.16], "flow_noise: least and greatest deviation of a step"
    )
    noise_level: float = option(0.5, "flow_sde: a, how much noise a step has")
    denoise_reduction: Literal["mean", "sum"] = option(
        "mean", "of a chain's terms: their mean, as RLinf has it, or their sum"
    )
    log_prob_level: Literal["chunk", "action", "token"] = option(
        "chunk", "what gets its own probability ratio: a decision, a step, a dimension"
    )
    padded_mean: bool = option(
        False, "whether imitation also averages padded dimensions, as RLinf does"
    )
    iterations: int = option(100, "rollouts", minimum=1, may_change=True)
    num_envs: int = option(64, "episodes of a rollout", minimum=1, maximum=MOST_ENVS)
    horizon: int | None = option(
        None,
        "control steps of a training episode; null: the task's",
        minimum=1,
        maximum=LONGEST_EPISODE,
    )
    reward: Literal["shaped", "sparse"] = option("shaped", "reward of a control step")
    epochs: int = option(2, "passes over a rollout", minimum=1)
    minibatch: int = option(
        40, "simulated decisions of a minibatch", minimum=1, maximum=MOST_ROWS
    )
    real_rows: int = option(
        16, "real rows of a minibatch", minimum=1, maximum=MOST_ROWS
    )
    accumulate: int = option(
        8, "minibatches whose gradients make one update", minimum=1
    )
    lr: float = option(
        4e-6, "learning rate of the policy", minimum=0, maximum=LARGEST_LR
    )
    critic_lr: float = option(
        2e-4,
        "learning rate of the critic and of the noise",
        minimum=0,
        maximum=LARGEST_LR,
    )
    critic_iterations: int = option(
        1, "gae: first rollouts that train the critic alone", minimum=0
    )
    clip: float = option(0.2, "PPO's clip of the ratio", minimum=0, maximum=1)
    advantage: Literal["gae", "mc"] = option(
        "gae", "by a critic, or by returns within groups that start alike"
    )
    group_size: int = option(8, "mc: episodes of a group", minimum=2)
    gamma: float = option(0.99, "gae: discount a decision", minimum=0, maximum=1)
    lmbda: float = option(0.95, "GAE's lambda", minimum=0, maximum=1)
    max_grad_norm: float = option(
        1.0, "clip of the gradient's norm; inf: none", minimum=0, infinite=True
    )
    renderer: Literal["raster", "opengl"] = option(
        "raster",
        "what draws the images: rlco's own renderer, or OpenGL",
        earlier="opengl",
    )
    eval_every: int = option(10, "rollouts between evaluations", minimum=1)
    eval_episodes: int = option(64, "episodes of an evaluation; 0: none", minimum=0)
    save_every: int = option(50, "rollouts between checkpoints", minimum=1)
    eval_domains: list[str] = option(
        ["sim"],
        "domains to evaluate in: names, MODULE:NAME, or paths of effects.yaml files",
        input="file",
        check=none_twice,
    )


def check(config: Config) -> None:
    """Check the options, before anything large is loaded."""
    from rlco.lerobot_files import read_folder
    from rlco.physics.rendering.renderers import check_can_render
    from rlco.policies.densities.flow_chain import FlowChain
    from rlco.policies.vla.lerobot.checkpoint import lerobot_config
    from rlco.policies.vla.lerobot.flow_model import CHECKPOINTING
    from rlco.policies.vla.lerobot.inputs import camera_of
    from rlco.policies.vla.lerobot.noise import check_range
    from rlco.training.stage_two import stage_two_problems

    # Names are checked where they are parsed; of a chain only this number is left.
    chain = FlowChain(config.method, 1, "all", config.noise_level, "mean")
    problems = chain.problems() + check_range(config.noise_range)
    problems += stage_two_problems(config)
    checkpoint = lerobot_config(config.policy)
    if getattr(checkpoint, "gradient_checkpointing", False):
        problems.append(CHECKPOINTING)
    predicted = checkpoint.chunk_size
    if config.executed is not None and config.executed > predicted:
        problems.append(
            f"executed={config.executed} must be 1 to {predicted}, the steps that the "
            "checkpoint predicts"
        )
    if problems:
        raise ConfigError(problems)
    camera_of(checkpoint, config.camera)
    if config.real_demos is not None:
        read_folder(config.real_demos)
    check_can_render(config.renderer)


def own_code(config: Config) -> tuple[str, ...]:
    """Return the code that the options themselves name: it may run."""
    domains = (config.train_domain, *config.eval_domains)
    code = () if config.effects_code is None else (config.effects_code,)
    return (*config.allow_code, config.task, *domains, *code)


def load(config: Config) -> tuple[Any, LeRobotPolicy, Any]:
    """Return the checkpoint, the policy around it, and real demonstrations if any."""
    from rlco.physics.tasks.make_task import make_task
    from rlco.policies.vla.lerobot.checkpoint import load_lerobot
    from rlco.policies.vla.lerobot.flow_model import check_trainable
    from rlco.policies.vla.lerobot.policy import LeRobotPolicy
    from rlco.policies.vla.lerobot.trained_weights import add_expert_lora
    from rlco.runs.state_files import seed_everything
    from rlco.training.lerobot_stage import load_real, statistics_of

    task = make_task(config.task)
    check(config)
    checkpoint = load_lerobot(
        config.policy,
        action_size=len(task.action_names),
        state_size=len(task.state_names),
        tokenizer=config.tokenizer,
        stats=statistics_of(config.stats),
        device=config.device,
        allow_code=own_code(config),
    )
    seed_everything(config.seed)  # the noise and the adapters are drawn before the run
    policy = LeRobotPolicy(
        checkpoint,
        instructions=task.instructions,
        camera=config.camera,
        executed=config.executed,
        trained="full" if config.trained == "full" else "expert",
        method=config.method,
        steps=config.steps,
        noisy_steps=config.noisy_steps,
        noise_range=(config.noise_range[0], config.noise_range[1]),
        noise_level=config.noise_level,
        denoise_reduction=config.denoise_reduction,
        log_prob_level=config.log_prob_level,
        padded_mean=config.padded_mean,
        keep_prefix=config.keep_prefix,
    )
    check_trainable(policy.model)
    if config.trained == "lora":
        add_expert_lora(policy.model, rank=config.lora_rank)
    real = None
    if config.real_coeff > 0 and config.real_demos is not None:
        camera, rows = config.real_camera, config.minibatch
        real = load_real(config.real_demos, task, policy, camera=camera, rows=rows)
    return checkpoint, policy, real


def make_learner(
    config: Config,
    policy: LeRobotPolicy,
    critic: Any,
    real: Any,
    rows: int,
    ranks: Ranks | None = None,
) -> LargeLearner:
    """Put loss, minibatches and optimisers around a policy and its critic."""
    from rlco.losses import CoTrainingLoss, ImitationLoss
    from rlco.training.lerobot_stage import make_large_learner
    from rlco.training.stage_two import make_ppo

    # Not functional: billions of weights are trained where they are.
    loss = CoTrainingLoss(
        make_ppo(policy, critic, clip=config.clip, functional=False),
        None if real is None else ImitationLoss(policy, functional=False),
        real_coeff=0.0 if real is None else config.real_coeff,
    )
    given = {"rows": rows, "ranks": ranks}
    return make_large_learner(config, loss, policy, critic, real, **given)


def train(
    config: Config,
    run: Run | FollowingRun,
    checkpoint: Any,
    policy: LeRobotPolicy,
    real: Any,
    domains: dict[str, Domain],
    ranks: Ranks,
) -> None:
    """Train, and write LeRobot checkpoints to the run's folder ``lerobot``.

    Of several ranks the first evaluates and saves.
    """
    from rlco.collectors import check_signal, make_collector
    from rlco.evaluation import evaluation_envs, success_rates
    from rlco.policies.vla.prefix_critic import PrefixCritic, add_next_summaries
    from rlco.training.distributed.launch import own_options
    from rlco.training.iterations import co_train
    from rlco.training.lerobot_stage import restore_beside
    from rlco.training.stage_two import rollout_rows

    critic = None
    if config.advantage == "gae":
        critic = PrefixCritic(policy.model.summary_size).to(policy.device)
    restore_beside(config.policy, critic=critic, noise=policy.noise)
    own = own_options(config, ranks)
    rows = rollout_rows(own, policy.executed)
    learner = make_learner(own, policy, critic, real, rows, ranks)
    run.step = ranks.from_lead(run.step)
    collector = make_collector(
        own,
        policy,
        critic,
        chunk=policy.executed,
        image_size=policy.inputs.image_size,
        renderer=config.renderer,
        prepare=partial(add_next_summaries, summary=policy.new_summary),
        ranks=ranks,
    )
    episodes = config.eval_episodes
    envs = evaluation_envs(
        config.task,
        domains,
        chunk=policy.executed,
        episodes=episodes,
        image_size=policy.inputs.image_size,
        renderer=config.renderer,
    )
    if run.step is None:
        before = success_rates(policy, envs, episodes, 0)
        run.log_metrics(0, {"frames": 0} | before)
    for iteration, row in co_train(
        config, run, collector, learner, check_first=check_signal, ranks=ranks
    ):
        last = iteration == config.iterations
        if iteration % config.eval_every == 0 or last:
            row |= success_rates(policy, envs, episodes, iteration)
        if iteration % config.save_every == 0 and not last and ranks.leads:
            save(config, run, checkpoint, learner, iteration)
    if ranks.leads:
        save(config, run, checkpoint, learner, config.iterations)
    collector.close()


def save(
    config: Config,
    run: Run | FollowingRun,
    checkpoint: Any,
    learner: LargeLearner,
    iteration: int,
) -> None:
    """Write a folder that LeRobot takes back, unless an interrupted run has."""
    from lerobot.common.train_utils import update_last_checkpoint

    from rlco.policies.vla.lerobot.export import save_lerobot

    folder = run.path / "lerobot"
    there = folder / "checkpoints" / f"{iteration:06d}"
    if there.exists():
        update_last_checkpoint(there)
        return
    camera = learner.policy.inputs.camera
    parts = {"critic": learner.critic, "noise": learner.policy.noise}
    saved = save_lerobot(
        checkpoint,
        folder,
        step=iteration,
        data=config.real_demos,
        rename={config.real_camera: camera} if config.real_camera else {},
        optimizer=learner.actor_optimizer,
        beside={k: dict(m.state_dict()) for k, m in parts.items() if m is not None},
    )
    log.info("lerobot-eval --policy.path=%s", saved)


def main(config: Config) -> None:
    """Check everything, train, and say where the checkpoint is."""
    from rlco.evaluation import evaluation_domains
    from rlco.physics.effects import load_code
    from rlco.training.distributed.following import FollowingRun
    from rlco.training.distributed.launch import check_launch, learners, take_gpu

    # What is wrong shows before a run is made.
    check_launch(config, "lerobot_co_train")
    take_gpu(config)
    load_code(config.effects_code)
    evaluated = config.eval_domains if config.eval_episodes else []
    domains = evaluation_domains(
        config.task,
        evaluated,
        train_domain=config.train_domain,
        train_sample=config.train_sample,
    )
    checkpoint, policy, real = load(config)
    given = (checkpoint, policy, real)
    with learners(config, policy.device) as ranks:
        if not ranks.leads:
            with FollowingRun(config) as following:
                train(config, following, *given, {}, ranks)
            return
        with Run(config, "lerobot_co_train") as run:
            train(config, run, *given, domains, ranks)


if __name__ == "__main__":
    run_recipe(main, Config)
