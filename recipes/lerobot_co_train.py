"""Stage II on a LeRobot checkpoint of pi0.5 or SmolVLA: load, co-train, save it back.

    uv run recipes/lerobot_co_train.py policy=outputs/train/RUN/checkpoints/last/\
pretrained_model task=push_cube real_demos=demos/real
    lerobot-eval --policy.path=outputs/lerobot_co_train/RUN/lerobot/checkpoints/last/\
pretrained_model --env.type=rlco --env.task=push_cube --env.camera=front

L = L_PPO(sim) + beta L_BC(D_real), beta = real_coeff (RL-Co, arXiv 2602.12628). The
checkpoint must solve the task now and then in the simulator before this can help:
train it on both kinds of demonstrations first, with lerobot-train.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from rlco import keys
from rlco.config import REQUIRED, RunOptions, option
from rlco.errors import ConfigError, DataError
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
    method: Literal["flow_noise", "flow_sde"] = option(
        "flow_noise", "what stands for the log-probability"
    )
    steps: int | None = option(4, "denoising steps; null: the checkpoint's", minimum=1)
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
        1, "first rollouts that train the critic alone", minimum=0
    )
    clip: float = option(0.2, "PPO's clip of the ratio", minimum=0)
    gamma: float = option(0.99, "discount a decision", minimum=0, maximum=1)
    lmbda: float = option(0.95, "GAE's lambda", minimum=0, maximum=1)
    max_grad_norm: float = option(1.0, "clip of the gradient's norm")
    eval_every: int = option(10, "rollouts between evaluations", minimum=1)
    eval_episodes: int = option(64, "episodes of an evaluation; 0: none", minimum=0)
    save_every: int = option(50, "rollouts between checkpoints", minimum=1)


def load(config: Config) -> tuple[Any, Any, Any]:
    """Return the checkpoint, the policy around it, and real demonstrations if any."""
    from rlco.physics.observation import ACTION_NAMES
    from rlco.physics.task import make_task
    from rlco.policies.lerobot_checkpoint import load_lerobot
    from rlco.policies.lerobot_flow import check_trainable
    from rlco.policies.lerobot_policies import LeRobotPolicy
    from rlco.policies.lerobot_trained import add_expert_lora
    from rlco.state_files import seed_everything

    task = make_task(config.task)
    if config.real_coeff > 0 and config.real_demos is None:
        raise ConfigError(
            [
                f"real_coeff={config.real_coeff} needs real_demos=FOLDER; "
                "real_coeff=0 is reinforcement learning alone"
            ]
        )
    checkpoint = load_lerobot(
        config.policy,
        action_size=len(ACTION_NAMES),
        tokenizer=config.tokenizer,
        device=config.device,
    )
    seed_everything(config.seed)  # the noise and the adapters are drawn before the run
    policy = LeRobotPolicy(
        checkpoint,
        instructions=task.instructions,
        camera=config.camera,
        trained="full" if config.trained == "full" else "expert",
        method=config.method,
        steps=config.steps,
    )
    check_trainable(policy.model)
    if config.trained == "lora":
        add_expert_lora(policy.model, rank=config.lora_rank)
    return checkpoint, policy, load_real(config, task, policy)


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


@dataclass
class Learner:
    """What is trained, and what trains it."""

    policy: Any
    critic: Any
    loss: Any
    buffer: Any
    actor_optimizer: Any
    critic_optimizer: Any

    def modules(self) -> dict[str, Any]:
        """Everything that a run's own checkpoint holds by its state dict."""
        names = ("policy", "critic", "actor_optimizer", "critic_optimizer")
        return {name: getattr(self, name) for name in names}

    def state(self) -> dict[str, Any]:
        """Return what the run's own checkpoint holds."""
        state = {name: dict(m.state_dict()) for name, m in self.modules().items()}
        return state | {"buffer": self.buffer.state_dict(rows=False)}

    def load(self, state: dict[str, Any]) -> None:
        """Go on from the run's own checkpoint."""
        for name, module in self.modules().items():
            module.load_state_dict(state[name])
        self.buffer.load_state_dict(state["buffer"])

    def beside(self) -> dict[str, Any]:
        """Return what a LeRobot checkpoint has no place for, by file."""
        return {
            "critic": dict(self.critic.state_dict()),
            "noise": dict(self.policy.noise.state_dict()),
            "critic_optimizer": self.critic_optimizer.state_dict(),
        }


def make_learner(config: Config, policy: Any, real: Any, rows: int) -> Learner:
    """Put critic, loss, buffer and optimisers around a policy."""
    import torch
    from torchrl.data import LazyTensorStorage, ReplayBuffer
    from torchrl.objectives import ClipPPOLoss

    from rlco.data import SimRealReplayBuffer
    from rlco.losses import CoTrainingLoss, ImitationLoss
    from rlco.policies.lerobot_export import load_beside
    from rlco.policies.prefix_critic import PrefixCritic

    critic = PrefixCritic(policy.model.summary_size).to(policy.device)
    for name, module in (("critic", critic), ("noise", policy.noise)):
        saved = load_beside(config.policy, name)
        if saved is not None:
            module.load_state_dict(saved)
    batch_size = config.minibatch + (config.real_rows if real is not None else 0)
    buffer = SimRealReplayBuffer(
        ReplayBuffer(storage=LazyTensorStorage(rows)),
        real,
        sim_ratio=config.minibatch / batch_size,
        batch_size=batch_size,
    )
    # Not functional: billions of weights are trained where they are.
    ppo = ClipPPOLoss(
        policy,
        critic,
        functional=False,
        clip_epsilon=config.clip,
        entropy_bonus=False,
        critic_coeff=1.0,
        loss_critic_type="l2",
    )
    anchor = ImitationLoss(policy, functional=False) if real is not None else None
    loss = CoTrainingLoss(
        ppo, anchor, real_coeff=config.real_coeff if anchor is not None else 0.0
    )
    preset = policy.policy.config.get_optimizer_preset()
    preset.lr = config.lr
    beside = [*critic.parameters(), *policy.noise.parameters()]
    return Learner(
        policy,
        critic,
        loss,
        buffer,
        preset.build(policy.policy.parameters()),
        torch.optim.Adam(beside, lr=config.critic_lr),
    )


def update(
    config: Config, learner: Learner, rollout: Any, *, train_policy: bool
) -> dict[str, float]:
    """Pass over a rollout, each minibatch with fresh real rows; return the means."""
    from rlco.losses import log_probs
    from rlco.policies.prefix_cache import SUMMARY

    policy = learner.policy
    kept = [*policy.replay_keys, SUMMARY, keys.LOG_PROB, keys.ADVANTAGE]
    flat = rollout.select(*kept, keys.VALUE_TARGET, keys.STATE_VALUE).reshape(-1)
    flat = flat.to(policy.device)
    # The old log-probability by the learner itself: the first ratio is 1.
    computed = log_probs(policy, flat, rows=config.minibatch)
    row = {"log_prob_gap": float((computed - flat[keys.LOG_PROB]).abs().max())}
    flat.set(keys.LOG_PROB, computed)
    learner.buffer.empty()
    learner.buffer.extend(flat)
    sums: dict[str, float] = {}
    minibatches = 0
    for _ in range(config.epochs):
        for batch in learner.buffer:
            out = learner.loss(batch.to(policy.device))
            terms = [v for k, v in out.items() if k.startswith("loss_")]
            (sum(terms) / config.accumulate).backward()
            if minibatches == 0:
                row["first_ratio"] = float(out["max_ratio"])
            minibatches += 1
            if minibatches % config.accumulate == 0:
                follow(config, learner, train_policy=train_policy)
            for name, value in out.items():
                sums[name] = sums.get(name, 0.0) + float(value.detach())
    if minibatches % config.accumulate:
        follow(config, learner, train_policy=train_policy)
    return row | {name: total / minibatches for name, total in sums.items()}


def follow(config: Config, learner: Learner, *, train_policy: bool) -> None:
    """Follow the gradients that have come together, and forget them."""
    from torch.nn.utils import clip_grad_norm_

    clip_grad_norm_(learner.critic.parameters(), 10.0)
    learner.critic_optimizer.step()
    if train_policy:
        clip_grad_norm_(learner.policy.policy.parameters(), config.max_grad_norm)
        learner.actor_optimizer.step()
    learner.actor_optimizer.zero_grad()
    learner.critic_optimizer.zero_grad()


def train(config: Config, run: Run, checkpoint: Any, policy: Any, real: Any) -> None:
    """Train, and write LeRobot checkpoints to the run's folder ``lerobot``."""
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
        prepare=partial(add_next_summaries, prefix=policy.new_prefix),
    )
    if (saved := run.load_checkpoint()) is not None:
        learner.load(saved)

    folder = run.path / "lerobot"

    def save(iteration: int) -> None:
        saved = save_lerobot(
            checkpoint,
            folder,
            step=iteration,
            data=config.real_demos,
            optimizer=learner.actor_optimizer,
            beside=learner.beside(),
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
        alone = iteration <= config.critic_iterations
        row |= update(config, learner, rollout, train_policy=not alone)
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
        run.save_checkpoint(iteration, learner.state())
        if iteration % config.save_every == 0 and not last:
            save(iteration)
    if not (folder / "checkpoints" / f"{config.iterations:06d}").exists():
        save(config.iterations)
    collector.close()


def main(config: Config) -> None:
    """Check everything, train, and say where the checkpoint is."""
    checkpoint, policy, real = load(config)  # what is wrong shows before a run is made
    with Run(config, "lerobot_co_train") as run:
        train(config, run, checkpoint, policy, real)


if __name__ == "__main__":
    run_recipe(main, Config)
