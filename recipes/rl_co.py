"""Stage II: PPO in the simulator, anchored to the real demonstrations.

    uv run recipes/rl_co.py policy=outputs/sft/RUN/policy real_demos=demos/stand_in
    uv run recipes/rl_co.py policy=outputs/sft/RUN/policy real_coeff=0   # RL alone

L = L_PPO(sim) + beta L_BC(D_real), beta = real_coeff, in every minibatch of every
epoch, each with freshly drawn real rows (RL-Co, arXiv 2602.12628, Stage II).
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from typing import Any, Literal

from rlco import keys
from rlco.config import REQUIRED, RunOptions, option
from rlco.errors import ConfigError
from rlco.run import Run, run_recipe

log = logging.getLogger("rlco.rl_co")


@dataclass
class Config(RunOptions):
    """Options of rl_co.py."""

    name: str = option("rl_co", "name of the run, a part of its folder's name")
    policy: str = option(REQUIRED, "folder of the policy that Stage I saved")
    task: str = option("push_cube", "name of the task")
    real_demos: str | None = option(None, "LeRobot folder of real demonstrations")
    rename: str = option(
        "", "features of real_demos with other names: THEIRS:OURS,THEIRS:OURS"
    )
    heldout_demos: str | None = option(
        None, "LeRobot folder of real demonstrations to measure forgetting on"
    )
    real_coeff: float = option(0.2, "beta, weight of the real anchor", minimum=0)
    iterations: int = option(50, "rollouts", minimum=1, may_change=True)
    num_envs: int = option(128, "episodes of a rollout", minimum=1)
    horizon: int | None = option(
        64,
        "control steps of a training episode, truncated; null: the task's",
        minimum=1,
    )
    backend: Literal["native", "robosuite"] = option("native", "who steps the model")
    reward: Literal["shaped", "sparse"] = option("shaped", "reward of a control step")
    epochs: int = option(4, "passes over a rollout", minimum=1)
    minibatch: int = option(512, "simulated decisions of a minibatch", minimum=1)
    real_rows: int = option(128, "real rows of a minibatch", minimum=1)
    lr: float = option(2e-4, "learning rate of the policy")
    clip: float = option(0.2, "PPO's clip of the ratio", minimum=0)
    advantage: Literal["gae", "mc"] = option(
        "gae", "by a critic, or by returns within groups that start alike"
    )
    group_size: int = option(8, "mc: episodes of a group", minimum=2)
    gamma: float = option(0.9, "gae: discount a decision", minimum=0, maximum=1)
    lmbda: float = option(0.95, "GAE's lambda", minimum=0, maximum=1)
    critic_hidden: list[int] = option(
        [256, 256], "gae: width of each hidden layer of the critic", minimum=1
    )
    critic_lr: float = option(1e-3, "gae: learning rate of the critic")
    critic_iterations: int = option(
        3, "gae: first rollouts that train the critic alone", minimum=0
    )
    max_grad_norm: float = option(1.0, "clip of the gradient's norm")
    eval_every: int = option(10, "rollouts between evaluations", minimum=1)
    eval_episodes: int = option(64, "episodes of an evaluation; 0: none", minimum=0)
    eval_domains: list[str] = option(["sim", "stand_in"], "domains to evaluate in")


def load(config: Config) -> tuple[Any, dict[str, Any]]:
    """Load the policy and the demonstrations, and check that they fit the task."""
    from rlco.data import load_task_demos
    from rlco.physics.domain import make_domain
    from rlco.physics.task import make_task
    from rlco.policies import load_task_policy

    task = make_task(config.task)
    for domain in config.eval_domains:
        make_domain(domain)
    policy = load_task_policy(config.policy, task)
    problems = []
    if config.advantage == "mc" and config.num_envs % config.group_size:
        problems.append(
            f"num_envs={config.num_envs} is no multiple of "
            f"group_size={config.group_size}"
        )
    if config.real_coeff > 0 and config.real_demos is None:
        problems.append(
            f"real_coeff={config.real_coeff} needs real_demos=FOLDER; "
            "real_coeff=0 is reinforcement learning alone"
        )
    if problems:
        raise ConfigError(problems)
    demos = {}
    for name in ("real_demos", "heldout_demos"):
        path = getattr(config, name)
        if path is not None:
            demos[name] = load_task_demos(
                path, task, chunk=policy.chunk, rename=config.rename
            )
    return policy, demos


@dataclass
class Learner:
    """What is trained, and what trains it; without a critic two of them are None."""

    policy: Any
    critic: Any
    loss: Any
    buffer: Any
    actor_optimizer: Any
    critic_optimizer: Any

    def modules(self) -> dict[str, Any]:
        """Everything that a checkpoint holds by its state dict."""
        names = ("policy", "critic", "actor_optimizer", "critic_optimizer")
        found = {name: getattr(self, name) for name in names}
        return {name: module for name, module in found.items() if module is not None}

    def step(self, config: Config, out: Any, *, train_policy: bool) -> None:
        """Follow the gradient of a loss's terms once."""
        from torch.nn.utils import clip_grad_norm_

        self.actor_optimizer.zero_grad()
        if self.critic is not None:
            self.critic_optimizer.zero_grad()
        sum(v for k, v in out.items() if k.startswith("loss_")).backward()
        if self.critic is not None:
            clip_grad_norm_(self.critic.parameters(), 10.0)
            self.critic_optimizer.step()
        if train_policy:
            clip_grad_norm_(self.policy.parameters(), config.max_grad_norm)
            self.actor_optimizer.step()

    def state(self) -> dict[str, Any]:
        """Return what a checkpoint holds."""
        modules = self.modules().items()
        state = {name: dict(module.state_dict()) for name, module in modules}
        return state | {"buffer": self.buffer.state_dict(rows=False)}

    def load(self, state: dict[str, Any]) -> None:
        """Go on from a checkpoint."""
        for name, module in self.modules().items():
            module.load_state_dict(state[name])
        self.buffer.load_state_dict(state["buffer"])


def make_learner(
    config: Config, policy: Any, demos: dict[str, Any], rows: int
) -> Learner:
    """Put critic, loss, buffer and optimisers around a policy."""
    import torch
    from torchrl.data import LazyTensorStorage, ReplayBuffer
    from torchrl.objectives import ClipPPOLoss

    from rlco.data import SimRealReplayBuffer
    from rlco.losses import CoTrainingLoss, ImitationLoss
    from rlco.physics.task import make_task
    from rlco.policies import ValueNetwork, task_sizes

    critic = None
    if config.advantage == "gae":
        sizes = task_sizes(make_task(config.task))
        critic = ValueNetwork(hidden=config.critic_hidden, **sizes)
        critic.encoder.load_state_dict(policy.encoder.state_dict())  # normalises alike
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
        torch.optim.Adam(critic.parameters(), lr=config.critic_lr) if critic else None,
    )


def update(
    config: Config, learner: Learner, rollout: Any, *, train_policy: bool
) -> dict[str, float]:
    """Pass over a rollout, each minibatch with fresh real rows; return the means."""
    from rlco.losses import gradient_agreement, log_probs

    policy, loss = learner.policy, learner.loss
    kept = [*policy.in_keys, *policy.replay_keys, keys.LOG_PROB, keys.ADVANTAGE]
    if learner.critic is not None:
        kept += [keys.VALUE_TARGET, keys.STATE_VALUE]
    # Text and raw actions stay behind.
    flat = rollout.select(*kept).reshape(-1)
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
            if minibatches == 0 and config.real_coeff > 0:
                row |= gradient_agreement(loss, batch)
            out = loss(batch)
            if minibatches == 0:
                row["first_ratio"] = float(out["max_ratio"])
            learner.step(config, out, train_policy=train_policy)
            minibatches += 1
            for name, value in out.items():
                sums[name] = sums.get(name, 0.0) + float(value.detach())
    return row | {name: total / minibatches for name, total in sums.items()}


def train(config: Config, run: Run, policy: Any, demos: dict[str, Any]) -> Any:
    """Train, and save the policy to the run's folder ``policy``."""
    from rlco.collectors import RolloutCollector, check_signal
    from rlco.envs import make_env
    from rlco.evaluation import evaluation_env, imitation_error, success_rates
    from rlco.policies import save_policy

    env = make_env(
        config.task,
        backend=config.backend,
        num_envs=config.num_envs,
        chunk=policy.chunk,
        reward=config.reward,
        horizon=config.horizon,
        seed=config.seed,
    )
    places = {
        domain: evaluation_env(
            config.task, domain, chunk=policy.chunk, episodes=config.eval_episodes
        )
        for domain in (config.eval_domains if config.eval_episodes else [])
    }
    decisions = config.num_envs * -(-env.horizon // env.chunk)
    learner = make_learner(config, policy, demos, decisions)
    collector = RolloutCollector(
        env,
        policy,
        learner.critic,
        gamma=config.gamma,
        lmbda=config.lmbda,
        advantage=config.advantage,
        group_size=config.group_size,
    )
    if (saved := run.load_checkpoint()) is not None:
        learner.load(saved)

    def measured(iteration: int) -> dict[str, float]:
        rates = success_rates(policy, places, config.eval_episodes)
        for name, rate in rates.items():
            log.info("rollout %d, %s: %.1f %%", iteration, name, 100 * rate)
        return rates

    def forgetting() -> dict[str, float]:
        if "heldout_demos" not in demos:
            return {}
        error = imitation_error(policy, demos["heldout_demos"].frames())
        return {"imitation_error_heldout": error}

    if run.step is None:
        run.log_metrics(0, {"frames": 0, **measured(0), **forgetting()})
    for iteration in run.iterations(config.iterations):
        started = time.perf_counter()
        rollout = collector.collect(iteration)
        collected = time.perf_counter()
        if iteration == 1:
            check_signal(rollout)
        solved = rollout["next", keys.SUCCESS][:, -1]
        row = {
            "frames": iteration * collector.frames,
            "return_mean": float(rollout["next", keys.REWARD].sum(1).mean()),
            "success_rollout": float(solved.float().mean()),
            "diverged": int(rollout["next", keys.DIVERGED].sum()),
        }
        alone = config.critic_iterations if learner.critic is not None else 0
        row |= update(config, learner, rollout, train_policy=iteration > alone)
        row |= forgetting()
        learned = time.perf_counter()
        if iteration % config.eval_every == 0 or iteration == config.iterations:
            row |= measured(iteration)
        run.log_metrics(iteration, row)
        run.log_timings(
            iteration,
            {
                "collect": collected - started,
                "learn": learned - collected,
                "evaluate": time.perf_counter() - learned,
                "frames_per_second": collector.frames / (learned - started),
            },
        )
        run.save_checkpoint(iteration, learner.state())
    collector.close()
    save_policy(
        policy,
        run.path / "policy",
        extra={"real_coeff": config.real_coeff, **env.task.description()},
    )
    return policy


def main(config: Config) -> None:
    """Check everything, train, and say how it went."""
    policy, demos = load(config)  # what is wrong shows before a folder is made
    from rlco.metrics import read_metrics
    from rlco.statistics import ResultRow

    method = "rl_co" if config.real_coeff > 0 else "rl_only"
    with Run(config, "rl_co") as run:
        train(config, run, policy, demos)
        last = read_metrics(run.path / "metrics.csv")[-1]
        episodes = config.eval_episodes
        results = [
            ResultRow(
                method=method,
                task=config.task,
                policy=policy.kind,
                domain=domain,
                variation=None,
                seed=config.seed,
                episodes=episodes,
                successes=round(last[f"success_{domain}"] * episodes),
            )
            for domain in (config.eval_domains if episodes else [])
        ]
        run.save_results(results)
        log.info("policy: %s", run.path / "policy")


if __name__ == "__main__":
    run_recipe(main, Config)
