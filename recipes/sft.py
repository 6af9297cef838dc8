"""Stage I: imitate simulated and real demonstrations, mixed by sim_ratio.

    uv run recipes/sft.py sim_demos=demos/sim real_demos=demos/stand_in
    uv run recipes/sft.py real_demos=demos/stand_in sim_ratio=0    # real data alone
    uv run recipes/sft.py ... 'eval_domains=[sim,gap_report/effects.yaml]'
    uv run recipes/sft.py task=null eval_episodes=0 sim_ratio=0 real_demos=demos/my_arm

L = alpha L_BC(D_sim) + (1 - alpha) L_BC(D_real), alpha = sim_ratio, the share of
simulated samples (RL-Co, arXiv 2602.12628, Stage I).
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from rlco.run import Run, run_recipe
from rlco.training.stage_one import StageOneOptions as Config

if TYPE_CHECKING:
    from rlco.physics.spec.domain import Domain
    from rlco.policies import ChunkPolicy
    from rlco.reporting.statistics import ResultRow

log = logging.getLogger("rlco.sft")


def main(config: Config) -> None:
    """Check the data, train, and evaluate."""
    from rlco.evaluation import evaluation_domains
    from rlco.physics.effects import load_code
    from rlco.training.stage_one import load_stage_one, train_stage_one

    # What is wrong shows before a folder is made.
    load_code(config.effects_code)
    domains: dict[str, Domain] = {}
    if config.task is not None and config.eval_episodes:
        domains = evaluation_domains(config.task, config.eval_domains)
    demos = load_stage_one(config)
    with Run(config, "sft") as run:
        policy = train_stage_one(config, run, demos)
        rows = []
        if config.task is not None:
            rows = count_successes(config, config.task, policy, domains)
        run.save_results(rows)
        log.info("policy: %s", run.path / "policy")


def count_successes(
    config: Config, task: str, policy: ChunkPolicy, domains: dict[str, Domain]
) -> list[ResultRow]:
    """Evaluate the policy in every domain, from the same initial states."""
    from rlco.evaluation import evaluation_envs, result_rows

    episodes = config.eval_episodes
    envs = evaluation_envs(
        task,
        domains,
        chunk=config.chunk,
        episodes=episodes,
        image_size=policy.image_size,
    )
    method = "real_only" if config.sim_ratio == 0 else "sft"
    return result_rows(
        policy, envs, episodes, method=method, task=task, seed=config.seed
    )


if __name__ == "__main__":
    run_recipe(main, Config)
