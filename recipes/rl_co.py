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

from policy_options import AugmentOptions, augment, check_pictures
from stage_two import fix_poses, make_critic, make_learner

from rlco import keys
from rlco.config import REQUIRED, option
from rlco.errors import ConfigError
from rlco.run import Run, run_recipe

log = logging.getLogger("rlco.rl_co")


@dataclass
class Config(AugmentOptions):
    """Options of rl_co.py."""

    name: str = option("rl_co", "name of the run, a part of its folder's name")
    policy: str = option(REQUIRED, "folder of the policy that Stage I saved")
    task: str = option("push_cube", "name of the task")
    real_demos: str | None = option(None, "LeRobot folder of real demonstrations")
    rename: str = option(
        "", "features of real_demos with other names: THEIRS:OURS,THEIRS:OURS"
    )
    real_camera: str | None = option(
        None, "camera of these and of heldout_demos that is read; null: its only one"
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
    critic: Literal["network", "head"] = option(
        "network", "gae: of its own, or a head on a token policy's state"
    )
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


def check(config: Config) -> None:
    """Check what the options say of each other."""
    problems = []
    if config.advantage == "mc" and config.num_envs % config.group_size:
        problems.append(
            f"num_envs={config.num_envs} is no multiple of "
            f"group_size={config.group_size}, as advantage='mc' needs"
        )
    if config.real_coeff > 0 and config.real_demos is None:
        problems.append(
            f"real_coeff={config.real_coeff} needs real_demos=FOLDER; "
            "real_coeff=0 is reinforcement learning alone"
        )
    if problems:
        raise ConfigError(problems)


def load(config: Config) -> tuple[Any, dict[str, Any]]:
    """Load the policy and the demonstrations, and check that they fit the task."""
    from rlco.data import load_task_demos
    from rlco.physics.named_task import check_domains, named_task
    from rlco.policies import load_task_policy

    task = named_task(config.task)
    check_domains(config.task, config.eval_domains if config.eval_episodes else ())
    policy = load_task_policy(config.policy, task)
    make_critic(config, policy)  # whether such a policy can have it shows here
    check(config)
    check_pictures(policy, config.task)
    if config.augment and policy.image_size is None:
        raise ConfigError(
            [f"augment=true changes pictures, but policy {config.policy!r} reads none"]
        )
    demos = {}
    for name in ("real_demos", "heldout_demos"):
        path = getattr(config, name)
        if path is not None:
            demos[name] = load_task_demos(
                path,
                task,
                chunk=policy.chunk,
                rename=config.rename,
                image_size=policy.image_size,
                camera=config.real_camera,
                environment_state=keys.ENVIRONMENT_STATE in policy.in_keys,
            )
    augment(config, demos.get("real_demos"))
    return policy, demos


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
        image_size=policy.image_size,
        seed=config.seed,
    )
    places = {
        domain: evaluation_env(
            config.task,
            domain,
            chunk=policy.chunk,
            episodes=config.eval_episodes,
            image_size=policy.image_size,
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
        prepare=fix_poses(learner.critic, policy) if run.step is None else None,
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
        # Every minibatch of every epoch draws its real rows anew.
        row |= learner.update(rollout, config.epochs, train_policy=iteration > alone)
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
