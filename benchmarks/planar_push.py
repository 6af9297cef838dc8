"""Co-training on a planar pushing task, in minutes: one cell of the planar map.

    uv run benchmarks/planar_push.py stage=one gap=yaw45 seed=100
    uv run benchmarks/planar_push.py stage=two gap=yaw45 seed=100 \
        policy=RUN/stages/sft/policy real_coeff=0.2

`stage=one` trains real_only, sim_only and sft (Stage I) and evaluates each in the
simulator and in `stand_in`; `stage=two` trains RL in the simulator after one of them,
anchored to demonstrations of `stand_in` by real_coeff (0: RL alone). `stand_in` plays
the robot's part and is a second simulator: `gap` names what it differs in
(planar/gaps.py). All else is as in recipes/sft.py and recipes/rl_co.py, with their
default settings.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from rlco.errors import ConfigError
from rlco.run import Run, run_recipe
from rlco.runs.config import RunOptions, option

if TYPE_CHECKING:
    from planar.env import PlanarEnv

    from rlco.data import DemoReplayBuffer
    from rlco.policies import ChunkPolicy
    from rlco.training.options.stage_two_options import StageTwoOptions

log = logging.getLogger("rlco.planar_push")

#: Stage I by method: sim_ratio, the share of simulated demonstrations.
STAGE_ONE = {"real_only": 0.0, "sim_only": 1.0, "sft": 0.5}
#: PPO's numbers, as they were when the map was planned.
PPO: dict[str, Any] = {
    **{"minibatch": 512, "gamma": 0.9, "time_left": False},
    **{"reuse": 0, "lr_final": 1.0},
}


@dataclass
class Config(RunOptions):
    """Options of planar_push.py."""

    name: str = option("planar", "name of the run, a part of its folder's name")
    stage: Literal["one", "two"] = option("one", "which stage is trained")
    gap: str = option("yaw8", "what stand_in differs in; see planar/gaps.py")
    sim_demos: int = option(60, "simulated demonstrations", minimum=3)
    real_demos: int = option(12, "demonstrations in stand_in", minimum=3)
    heldout_demos: int = option(9, "further ones there, never trained on", minimum=3)
    updates: int = option(1500, "stage=one: optimiser steps", minimum=1)
    policy: str | None = option(None, "stage=two: folder of the policy it starts from")
    real_coeff: float = option(0.2, "stage=two: beta, weight of the anchor", minimum=0)
    forget_limit: float | None = option(
        None,
        "stage=two: share of the real demonstrations' variance that RL may stop "
        "explaining, see rl_co.py; null: real_coeff stays",
        minimum=0,
    )
    iterations: int = option(100, "stage=two: rollouts", minimum=1, may_change=True)
    num_envs: int = option(128, "stage=two: episodes of a rollout", minimum=1)
    eval_every: int = option(20, "stage=two: rollouts between evaluations", minimum=1)
    eval_episodes: int = option(128, "episodes of each evaluation", minimum=1)


def main(config: Config) -> None:
    """Check, train, evaluate, and write results.json."""
    from planar.gaps import named_gap

    named_gap(config.gap)
    if (config.stage == "two") != (config.policy is not None):
        raise ConfigError(
            [
                f"stage={config.stage} and policy={config.policy} do not go together; "
                "stage=two starts from policy=FOLDER, stage=one from nothing"
            ]
        )
    if config.stage == "one":
        stage_one(config)
    else:
        stage_two(config)


def record(config: Config) -> dict[str, DemoReplayBuffer]:
    """Return demonstrations of both domains, and held-out ones of stand_in."""
    from planar.demos import record
    from planar.gaps import SIM, named_gap

    real = named_gap(config.gap)
    first = 500_000 + 3 * config.seed  # far from the seeds of rollouts and evaluations
    return {
        "sim": record(SIM, config.sim_demos, first),
        "real": record(real, config.real_demos, first + 1),
        "heldout": record(real, config.heldout_demos, first + 2),
    }


# -- Stage I -----------------------------------------------------------------------


def stage_one(config: Config) -> None:
    """Imitate real, simulated, and both kinds of demonstrations."""
    from planar.evaluation import evaluation_envs, play_all, rates

    demos = record(config)
    envs = evaluation_envs(config.gap, config.eval_episodes)
    rows: list[Any] = []
    with Run(config, "planar_push") as run:
        for method, sim_ratio in STAGE_ONE.items():
            policy = imitate(config, run, demos, method, sim_ratio)
            outcomes = play_all(policy, envs)
            log.info("%s: %s", method, rates(outcomes))
            rows += [
                outcome.row(method, domain, config.gap, config.seed)
                for domain, outcome in outcomes.items()
            ]
        run.save_results(rows)


def imitate(
    config: Config,
    run: Run,
    demos: dict[str, DemoReplayBuffer],
    method: str,
    sim_ratio: float,
) -> ChunkPolicy:
    """Return a policy of Stage I, saved to ``stages/METHOD/policy``."""
    from planar.env import CHUNK, PlanarTask

    from rlco.training.options.stage_one_options import StageOneOptions
    from rlco.training.stage_one import StageOneDemos, train_stage_one

    options = StageOneOptions(
        name=method,
        seed=config.seed,
        threads=config.threads,
        task=PlanarTask.name,
        sim_ratio=sim_ratio,
        chunk=CHUNK,
        updates=config.updates,
    )
    data: Any = StageOneDemos(
        PlanarTask(),
        sim=demos["sim"] if sim_ratio > 0 else None,
        real=demos["real"] if sim_ratio < 1 else None,
    )
    with run.stage(options, "sft", f"stages/{method}") as stage:
        return train_stage_one(options, stage, data)


# -- Stage II ----------------------------------------------------------------------


def stage_two(config: Config) -> None:
    """Train in the simulator, anchored to demonstrations in stand_in."""
    from planar.env import PlanarTask
    from planar.evaluation import evaluation_envs, play_all, rates

    from rlco.collectors import check_signal
    from rlco.policies import load_task_policy, save_policy
    from rlco.training.held_out import HeldOut
    from rlco.training.iterations import co_train
    from rlco.training.options.stage_two_options import StageTwoOptions

    policy = load_task_policy(str(config.policy), PlanarTask())
    demos = record(config)
    envs = evaluation_envs(config.gap, config.eval_episodes)
    options = StageTwoOptions(
        **PPO,
        policy=str(config.policy),
        task=PlanarTask.name,
        seed=config.seed,
        real_coeff=config.real_coeff,
        forget_limit=config.forget_limit,
        iterations=config.iterations,
        num_envs=config.num_envs,
    )
    method = "rl_co" if config.real_coeff > 0 else "rl_only"
    with Run(config, "planar_push") as run:
        collector, learner = assemble(options, policy, demos["real"])
        held_out = HeldOut(policy, demos["heldout"])  # before a checkpoint is loaded
        if run.step is None:
            before = rates(play_all(policy, envs))
            before |= held_out.measure(policy)
            run.log_metrics(0, {"frames": 0} | before)
        for iteration, row in co_train(
            options, run, collector, learner, check_first=check_signal
        ):
            last = iteration == config.iterations
            if iteration % config.eval_every == 0 or last:
                row |= rates(play_all(policy, envs))
                row |= held_out.measure(policy)
        outcomes = play_all(policy, envs)
        extra = {"real_coeff": config.real_coeff, **PlanarTask().description()}
        save_policy(policy, run.path / "policy", extra=extra)
        collector.close()
        log.info("%s: %s", method, rates(outcomes))
        run.save_results(
            [
                outcome.row(method, domain, config.gap, config.seed)
                for domain, outcome in outcomes.items()
            ]
        )


def assemble(
    options: StageTwoOptions, policy: ChunkPolicy, real: DemoReplayBuffer
) -> tuple[Any, Any]:
    """Return the collector in the simulator, and the learner with its loss."""
    from planar.env import TRAINING_HORIZON, PlanarTask
    from planar.gaps import SIM

    from rlco.collectors import RolloutCollector
    from rlco.losses import CoTrainingLoss, ImitationLoss
    from rlco.policies import ValueNetwork, task_sizes
    from rlco.training.stage_two import make_learner, make_ppo

    anchor = real if options.real_coeff > 0 else None
    critic = ValueNetwork(hidden=options.critic_hidden, **task_sizes(PlanarTask()))
    # What both read they normalise alike.
    critic.encoder.load_state_dict(policy.encoder.state_dict(), strict=False)
    loss = CoTrainingLoss(
        make_ppo(policy, critic, clip=options.clip),
        None if anchor is None else ImitationLoss(policy),
        real_coeff=options.real_coeff,
    )
    env = training_env(SIM, options, TRAINING_HORIZON)
    collector = RolloutCollector(
        env, policy, critic, gamma=options.gamma, lmbda=options.lmbda
    )
    rows = options.num_envs * collector.decisions
    learner = make_learner(options, loss, policy, critic, anchor, rows=rows)
    return collector, learner


def training_env(gap: Any, options: StageTwoOptions, horizon: int) -> PlanarEnv:
    """Return where RL takes place."""
    from planar.env import PlanarEnv

    return PlanarEnv(gap, num_envs=options.num_envs, seed=options.seed, horizon=horizon)


if __name__ == "__main__":
    run_recipe(main, Config)
