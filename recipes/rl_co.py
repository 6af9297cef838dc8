"""Stage II: PPO in the simulator, anchored to the real demonstrations.

    uv run recipes/rl_co.py policy=outputs/sft/RUN/policy real_demos=demos/stand_in
    uv run recipes/rl_co.py policy=outputs/sft/RUN/policy real_coeff=0   # RL alone
    uv run recipes/rl_co.py ... train_domain=gap_report/effects.yaml
    uv run recipes/rl_co.py ... real_coeff=0 keep=best    # stopped where sim was best
    uv run recipes/rl_co.py ... launch=ray workers=4      # four processes play
    uv run torchrun --nproc-per-node=2 recipes/rl_co.py ... launch=torchrun

L = L_PPO(sim) + beta L_BC(D_real), beta = real_coeff, in every minibatch of every
epoch, each with freshly drawn real rows (RL-Co, arXiv 2602.12628, Stage II).
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from rlco.run import Run, run_recipe
from rlco.training.options.stage_two_options import StageTwoOptions as Config

if TYPE_CHECKING:
    from rlco.physics.spec.domain import Domain
    from rlco.policies import ChunkPolicy
    from rlco.reporting.statistics import ResultRow
    from rlco.training.distributed.following import FollowingRun
    from rlco.training.distributed.ranks import Ranks
    from rlco.training.stage_two import StageTwoDemos

log = logging.getLogger("rlco.rl_co")


def main(config: Config) -> None:
    """Load, train, and say how it went."""
    from rlco.evaluation import evaluation_domains
    from rlco.physics.effects import load_code
    from rlco.training.distributed.following import FollowingRun
    from rlco.training.distributed.launch import check_launch, learners
    from rlco.training.kept_policy import check_keep
    from rlco.training.stage_two import load_stage_two

    # What is wrong shows before a folder is made.
    check_launch(config)
    load_code(config.effects_code)
    given = {
        "task": config.task,
        "train_domain": config.train_domain,
        "train_sample": config.train_sample,
    }
    curves = config.eval_domains if config.eval_episodes else []
    last = [*config.eval_domains, *config.final_domains] if config.final else []
    domains = evaluation_domains(evaluated=curves, **given)
    final = evaluation_domains(evaluated=last, **given)
    check_keep(config, domains)
    policy, demos = load_stage_two(config)
    with learners(config) as ranks:
        if not ranks.leads:
            with FollowingRun(config) as following:
                train(config, following, policy, demos, {}, {}, ranks)
            return
        with Run(config, "rl_co") as run:
            rows = train(config, run, policy, demos, domains, final, ranks)
            run.save_results(rows)
            log.info("policy: %s", run.path / "policy")


def train(
    config: Config,
    run: Run | FollowingRun,
    policy: ChunkPolicy,
    demos: StageTwoDemos,
    domains: dict[str, Domain],
    final: dict[str, Domain],
    ranks: Ranks,
) -> list[ResultRow]:
    """Train, evaluate now and then, and save the policy to the folder ``policy``.

    With ``keep=best`` the last policy is saved, too, to ``policy_last``. It is
    evaluated in ``domains`` on the way, and in ``final`` at the end. Of several ranks
    the first evaluates and saves.

    Returns:
        What each saved policy reaches.
    """
    from rlco.collectors import check_signal, make_collector
    from rlco.evaluation import evaluation_envs, final_rows, read_by, success_rates
    from rlco.losses import CoTrainingLoss, ImitationLoss
    from rlco.policies import save_policy
    from rlco.training.distributed.launch import own_options
    from rlco.training.held_out import HeldOut
    from rlco.training.iterations import co_train
    from rlco.training.kept_policy import best_policy
    from rlco.training.stage_two import (
        fix_pose_range,
        make_critic,
        make_learner,
        make_ppo,
        rollout_rows,
        warn_of_trained_on,
    )

    critic = make_critic(config, policy)
    real = demos.real if config.real_coeff > 0 else None
    if ranks.leads:
        warn_of_trained_on(real, demos.heldout)
    # Several ranks need the networks inside the loss, which find them there.
    functional = ranks.alone
    loss = CoTrainingLoss(
        make_ppo(policy, critic, clip=config.clip, functional=functional),
        None if real is None else ImitationLoss(policy, functional=functional),
        real_coeff=config.real_coeff,
    )
    own = own_options(config, ranks)
    rows = rollout_rows(own, policy.chunk)
    learner = make_learner(own, loss, policy, critic, real, rows=rows, ranks=ranks)
    run.step = ranks.from_lead(run.step)
    collector = make_collector(
        own,
        policy,
        critic,
        backend=config.backend,
        chunk=policy.chunk,
        image_size=policy.image_size,
        renderer=policy.renderer,
        cameras=policy.cameras,
        look=config.look,
        prepare=fix_pose_range(critic, policy, ranks) if run.step is None else None,
        ranks=ranks,
        workers=own.workers,
        ray_address=own.ray_address,
        effects_code=own.effects_code,
    )
    episodes = config.eval_episodes
    envs = evaluation_envs(
        config.task,
        domains,
        chunk=policy.chunk,
        episodes=episodes,
        **read_by(policy),
    )
    best = best_policy(config, policy)
    # Before a checkpoint is loaded.
    held_out = HeldOut(policy, demos.heldout if ranks.leads else None)
    if run.step is None:
        before = success_rates(policy, envs, episodes, 0)
        before |= held_out.measure(policy)
        run.log_metrics(0, {"frames": 0} | before)
        if best is not None:
            best.offer(0, before)
    for iteration, row in co_train(
        config,
        run,
        collector,
        learner,
        check_first=check_signal,
        best=best,
        measure=config.evaluates,
        ranks=ranks,
    ):
        row |= held_out.measure(policy)
        if config.evaluates(iteration):
            row |= success_rates(policy, envs, episodes, iteration)
    extra = {"real_coeff": config.real_coeff, **collector.env.task.description()}
    collector.close()
    if not ranks.leads:
        return []
    folder = "policy" if best is None else "policy_last"
    save_policy(policy, run.path / folder, extra=extra)
    method = "rl_co" if config.real_coeff > 0 else "rl_only"
    given = {"method": method, "task": config.task, "seed": config.seed}
    rows = final_rows(policy, final, config.final, **given)
    if best is not None:
        best.restore()
        save_policy(policy, run.path / "policy", extra=extra | best.description())
        given["method"] = f"{method}_best"
        rows += final_rows(policy, final, config.final, **given)
    return rows


if __name__ == "__main__":
    run_recipe(main, Config)
