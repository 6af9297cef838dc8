"""Stage I: imitate simulated and real demonstrations, mixed by sim_ratio.

    uv run recipes/sft.py sim_demos=demos/sim real_demos=demos/stand_in
    uv run recipes/sft.py real_demos=demos/stand_in sim_ratio=0    # real data alone
    uv run recipes/sft.py ... 'eval_domains=[sim,gap_report/effects.yaml]'
    uv run recipes/sft.py task=null real_demos=demos/my_arm episodes=0-39 \
        heldout_demos=demos/my_arm heldout_episodes=40-49    # no simulator has it

L = alpha L_BC(D_sim) + (1 - alpha) L_BC(D_real), alpha = sim_ratio, the share of
simulated samples (RL-Co, arXiv 2602.12628, Stage I). Without a simulator
(task=null) the error on held-out demonstrations says how good a policy is.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from rlco.run import Run, run_recipe
from rlco.training.options.stage_one_options import StageOneOptions as Config

if TYPE_CHECKING:
    from rlco.physics.spec.domain import Domain
    from rlco.policies import ChunkPolicy
    from rlco.reporting.statistics import ImitationRow
    from rlco.training.stage_one import StageOneDemos

log = logging.getLogger("rlco.sft")


def main(config: Config) -> None:
    """Check the data, train, and evaluate."""
    from rlco.evaluation import evaluation_domains, final_rows
    from rlco.physics.effects import load_code
    from rlco.training.stage_one import load_stage_one, train_stage_one

    # What is wrong shows before a folder is made.
    load_code(config.effects_code)
    domains: dict[str, Domain] = {}
    if config.task is not None and config.evaluated:
        domains = evaluation_domains(config.task, config.eval_domains)
    demos = load_stage_one(config)
    with Run(config, "sft") as run:
        policy = train_stage_one(config, run, demos)
        rows = []
        if config.task is not None:
            rows = final_rows(
                policy,
                domains,
                config.evaluated,
                method=method_of(config),
                task=config.task,
                seed=config.seed,
            )
        run.save_results(rows, imitation=compare_actions(config, policy, demos))
        log.info("policy: %s", run.path / "policy")


def compare_actions(
    config: Config, policy: ChunkPolicy, demos: StageOneDemos
) -> list[ImitationRow]:
    """Compare the policy's actions with those of every data set, held-out ones last."""
    from rlco.training.imitation_errors import imitation_errors

    sets = {
        "sim_demos": demos.sim,
        "real_demos": demos.real,
        "heldout_demos": demos.heldout,
    }
    rows: list[ImitationRow] = []
    names = demos.task.action_names
    for name, found in imitation_errors(policy, sets, names).items():
        log.info(
            "%s: imitation error %.3g, actions off by %s on average",
            name,
            found.loss,
            ", ".join(f"{error:.2g} ({of})" for of, error in found.actions.items()),
        )
        rows.append(
            {
                "method": method_of(config),
                "task": config.task,
                "policy": policy.kind,
                "seed": config.seed,
                "data": name,
                "path": str(found.path),
                "frames": found.frames,
                "imitation_error": found.loss,
                "action_error": found.actions,
            }
        )
    return rows


def method_of(config: Config) -> str:
    """Return what results call this kind of training."""
    return "real_only" if config.alpha == 0 else "sft"


if __name__ == "__main__":
    run_recipe(main, Config)
