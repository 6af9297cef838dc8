"""Stage II on a LeRobot checkpoint of pi0.5 or SmolVLA: load, co-train, save it back.

    uv run recipes/lerobot_co_train.py policy=outputs/train/RUN/checkpoints/last/\
pretrained_model task=push_cube real_demos=demos/real
    lerobot-eval --policy.path=outputs/lerobot_co_train/RUN/lerobot/checkpoints/last/\
pretrained_model --env.type=rlco --env.task=push_cube --env.camera=front

L = L_PPO(sim) + beta L_BC(D_real), beta = real_coeff (RL-Co, arXiv 2602.12628). The
checkpoint must solve the task now and then in the simulator before this can help:
train it on both kinds of demonstrations first (docs/vla.md says how).
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from lerobot_stage_two import load_real, make_learner, statistics_of

from rlco import keys
from rlco.config import REQUIRED, RunOptions, option
from rlco.errors import ConfigError
from rlco.run import Run, run_recipe

log = logging.getLogger("rlco.lerobot_co_train")


@dataclass
class Config(RunOptions):
    """Options of lerobot_co_train.py."""

    name: str = option("co_train", "name of the run, a part of its folder's name")
    policy: str = option(REQUIRED, "LeRobot's folder pretrained_model")
    tokenizer: str | None = option(
        None, "folder of the tokenizer, where there is no network"
    )
    device: str | None = option(None, "cpu or cuda; null: the checkpoint's, or what is")
    camera: str | None = option(
        None, "the checkpoint's camera that sees the task; null: its only one"
    )
    task: str = option("push_cube", "name of the task")
    real_demos: str | None = option(None, "LeRobot folder of real demonstrations")
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
        "chunk", "what has a ratio of its own: a decision, a step, a number"
    )
    padded_mean: bool = option(
        False, "whether imitation averages padded numbers too, as RLinf does"
    )
    iterations: int = option(100, "rollouts", minimum=1, may_change=True)
    num_envs: int = option(64, "episodes of a rollout", minimum=1)
    horizon: int | None = option(
        None, "control steps of a training episode; null: the task's", minimum=1
    )
    reward: Literal["shaped", "sparse"] = option("shaped", "reward of a control step")
    epochs: int = option(2, "passes over a rollout", minimum=1)
    minibatch: int = option(40, "simulated decisions of a minibatch", minimum=1)
    real_rows: int = option(16, "real rows of a minibatch", minimum=1)
    accumulate: int = option(
        8, "minibatches whose gradients make one update", minimum=1
    )
    lr: float = option(4e-6, "learning rate of the policy")
    critic_lr: float = option(2e-4, "learning rate of the critic and of the noise")
    critic_iterations: int = option(
        1, "gae: first rollouts that train the critic alone", minimum=0
    )
    clip: float = option(0.2, "PPO's clip of the ratio", minimum=0)
    advantage: Literal["gae", "mc"] = option(
        "gae", "by a critic, or by returns within groups that start alike"
    )
    group_size: int = option(8, "mc: episodes of a group", minimum=2)
    gamma: float = option(0.99, "gae: discount a decision", minimum=0, maximum=1)
    lmbda: float = option(0.95, "GAE's lambda", minimum=0, maximum=1)
    max_grad_norm: float = option(1.0, "clip of the gradient's norm")
    eval_every: int = option(10, "rollouts between evaluations", minimum=1)
    eval_episodes: int = option(64, "episodes of an evaluation; 0: none", minimum=0)
    save_every: int = option(50, "rollouts between checkpoints", minimum=1)


def check(config: Config) -> None:
    """Check the options, before anything large is loaded."""
    from rlco.lerobot_files import read_folder
    from rlco.physics.camera import check_rendering
    from rlco.policies.flow_chain import FlowChain
    from rlco.policies.lerobot_checkpoint import lerobot_config
    from rlco.policies.lerobot_flow import CHECKPOINTING
    from rlco.policies.lerobot_inputs import camera_of
    from rlco.policies.lerobot_noise import check_range

    # Names are checked where they are parsed; of a chain only this number is left.
    chain = FlowChain(config.method, 1, "all", config.noise_level, "mean")
    problems = chain.problems() + check_range(config.noise_range)
    if config.real_coeff > 0 and config.real_demos is None:
        problems.append(
            f"real_coeff={config.real_coeff} needs real_demos=FOLDER; "
            "real_coeff=0 is reinforcement learning alone"
        )
    if config.advantage == "mc" and config.num_envs % config.group_size:
        problems.append(
            f"num_envs={config.num_envs} is no multiple of "
            f"group_size={config.group_size}, as advantage='mc' needs"
        )
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
    check_rendering()


def load(config: Config) -> tuple[Any, Any, Any]:
    """Return the checkpoint, the policy around it, and real demonstrations if any."""
    from rlco.physics.observation import ACTION_NAMES, STATE_NAMES
    from rlco.physics.task import make_task
    from rlco.policies.lerobot_checkpoint import load_lerobot
    from rlco.policies.lerobot_flow import check_trainable
    from rlco.policies.lerobot_policies import LeRobotPolicy
    from rlco.policies.lerobot_trained import add_expert_lora
    from rlco.state_files import seed_everything

    task = make_task(config.task)
    check(config)
    checkpoint = load_lerobot(
        config.policy,
        action_size=len(ACTION_NAMES),
        state_size=len(STATE_NAMES),
        tokenizer=config.tokenizer,
        stats=statistics_of(config.stats),
        device=config.device,
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
    return checkpoint, policy, load_real(config, task, policy)


def train(config: Config, run: Run, checkpoint: Any, policy: Any, real: Any) -> None:
    """Train, and write LeRobot checkpoints to the run's folder ``lerobot``."""
    from lerobot.common.train_utils import update_last_checkpoint

    from rlco.collectors import RolloutCollector, check_signal
    from rlco.envs import make_env
    from rlco.evaluation import evaluation_env, success_rates
    from rlco.policies.lerobot_export import save_lerobot
    from rlco.policies.prefix_critic import add_next_summaries

    size = policy.inputs.image_size
    env = make_env(
        config.task,
        num_envs=config.num_envs,
        chunk=policy.executed,
        reward=config.reward,
        horizon=config.horizon,
        image_size=size,
        seed=config.seed,
    )
    places = {}
    if config.eval_episodes:
        places["sim"] = evaluation_env(
            config.task,
            "sim",
            chunk=policy.executed,
            episodes=config.eval_episodes,
            image_size=size,
        )
    learner = make_learner(
        config, policy, real, config.num_envs * -(-env.horizon // env.chunk)
    )
    collector = RolloutCollector(
        env,
        policy,
        learner.critic,
        gamma=config.gamma,
        lmbda=config.lmbda,
        advantage=config.advantage,
        group_size=config.group_size,
        prepare=partial(add_next_summaries, summary=policy.new_summary),
    )
    if (saved := run.load_checkpoint()) is not None:
        learner.load(saved)

    folder = run.path / "lerobot"
    seen = policy.inputs.camera
    renamed = {config.real_camera: seen} if config.real_camera else {}

    def save(iteration: int) -> None:
        there = folder / "checkpoints" / f"{iteration:06d}"
        if there.exists():  # the run was interrupted after it was written
            update_last_checkpoint(there)
            return
        parts = {"critic": learner.critic, "noise": policy.noise}
        saved = save_lerobot(
            checkpoint,
            folder,
            step=iteration,
            data=config.real_demos,
            rename=renamed,
            optimizer=learner.actor_optimizer,
            beside={k: dict(m.state_dict()) for k, m in parts.items() if m is not None},
        )
        log.info("lerobot-eval --policy.path=%s", saved)

    def measured(iteration: int) -> dict[str, float]:
        rates = success_rates(policy, places, config.eval_episodes)
        for name, rate in rates.items():
            log.info("rollout %d, %s: %.1f %%", iteration, name, 100 * rate)
        return rates

    if run.step is None:
        run.log_metrics(0, {"frames": 0, **measured(0)})
    for iteration in run.iterations(config.iterations):
        started = time.perf_counter()
        rollout = collector.collect(iteration)
        collected = time.perf_counter()
        if iteration == 1:
            check_signal(rollout)
        row = {
            "frames": iteration * collector.frames,
            "return_mean": float(rollout["next", keys.REWARD].sum(1).mean()),
            "success_rollout": float(
                rollout["next", keys.SUCCESS][:, -1].float().mean()
            ),
            "diverged": int(rollout["next", keys.DIVERGED].sum()),
        }
        alone = config.critic_iterations if learner.critic is not None else 0
        row |= learner.update(rollout, config.epochs, train_policy=iteration > alone)
        learned = time.perf_counter()
        last = iteration == config.iterations
        if iteration % config.eval_every == 0 or last:
            row |= measured(iteration)
        run.log_metrics(iteration, row)
        run.log_timings(
            iteration,
            {
                "collect": collected - started,
                "learn": learned - collected,
                "frames_per_second": collector.frames / (learned - started),
            },
        )
        if iteration % config.save_every == 0 and not last:
            save(iteration)
        run.save_checkpoint(iteration, learner.state())
    save(config.iterations)
    collector.close()


def main(config: Config) -> None:
    """Check everything, train, and say where the checkpoint is."""
    checkpoint, policy, real = load(config)  # what is wrong shows before a run is made
    with Run(config, "lerobot_co_train") as run:
        train(config, run, checkpoint, policy, real)


if __name__ == "__main__":
    run_recipe(main, Config)
