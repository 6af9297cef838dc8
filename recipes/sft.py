"""Stage I: imitate simulated and real demonstrations, mixed by sim_ratio.

    uv run recipes/sft.py sim_demos=demos/sim real_demos=demos/stand_in
    uv run recipes/sft.py real_demos=demos/stand_in sim_ratio=0    # real data alone

L = alpha L_BC(D_sim) + (1 - alpha) L_BC(D_real), alpha = sim_ratio, the share of
simulated samples (RL-Co, arXiv 2602.12628, Stage I).
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import policy_options
from policy_options import SIM_CAMERA, PolicyOptions

from rlco.config import option
from rlco.errors import ConfigError
from rlco.run import Run, run_recipe

if TYPE_CHECKING:
    from rlco.data import DemoReplayBuffer
    from rlco.policies import ChunkPolicy

log = logging.getLogger("rlco.sft")


@dataclass
class Config(PolicyOptions):
    """Options of sft.py."""

    name: str = option("sft", "name of the run, a part of its folder's name")
    task: str = option("push_cube", "name of the task")
    sim_demos: str | None = option(None, "LeRobot folder of simulated demonstrations")
    real_demos: str | None = option(None, "LeRobot folder of real demonstrations")
    rename: str = option(
        "", "features of real_demos with other names: THEIRS:OURS,THEIRS:OURS"
    )
    real_camera: str | None = option(
        None, "camera of real_demos that is read; null: its only one"
    )
    sim_ratio: float = option(0.5, "alpha, the share of sim", minimum=0, maximum=1)
    chunk: int = option(4, "control steps of an action chunk", minimum=1)
    hidden: list[int] = option([256, 256], "width of each hidden layer", minimum=1)
    updates: int = option(1500, "optimiser steps", minimum=1)
    log_every: int = option(100, "updates between rows of metrics.csv", minimum=1)
    batch_size: int = option(256, "rows of a batch, both kinds together", minimum=1)
    lr: float = option(1e-3, "learning rate, falling to 0 along a cosine")
    weight_decay: float = option(1e-4, "AdamW's weight decay", minimum=0)
    eval_episodes: int = option(128, "episodes of the evaluation; 0: none", minimum=0)
    eval_domains: list[str] = option(["sim", "stand_in"], "domains to evaluate in")


def check(config: Config) -> ChunkPolicy:
    """Check what the options say of each other; return a policy that they describe."""
    from rlco.physics.named_task import check_domains

    check_domains(config.task, config.eval_domains if config.eval_episodes else ())
    policy_options.check_sight(config)
    policy = new_policy(config)
    if config.eval_episodes and config.eval_domains:
        policy_options.check_pictures(policy, config.task)
    return policy


def load(config: Config) -> dict[str, DemoReplayBuffer | None]:
    """Load the demonstrations that sim_ratio asks for."""
    from rlco.data import load_task_demos
    from rlco.physics.named_task import named_task

    task = named_task(config.task)
    needed = {"sim_demos": config.sim_ratio > 0, "real_demos": config.sim_ratio < 1}
    problems = [
        f"sim_ratio={config.sim_ratio} needs {name}=FOLDER"
        for name, need in needed.items()
        if need and getattr(config, name) is None
    ]
    if problems:
        raise ConfigError(problems)
    image_size = check(config).image_size
    rename = {"sim_demos": "", "real_demos": config.rename}
    camera = {"sim_demos": SIM_CAMERA, "real_demos": config.real_camera}
    demos = {
        name: load_task_demos(
            getattr(config, name),
            task,
            chunk=config.chunk,
            rename=rename[name],
            image_size=image_size,
            camera=camera[name],
            environment_state=config.use_environment_state,
        )
        if need
        else None
        for name, need in needed.items()
    }
    policy_options.augment(config, *demos.values())
    return demos


def new_policy(config: Config) -> ChunkPolicy:
    """Return a new policy of the kind and the size that the options give."""
    return policy_options.new_policy(
        config, task=config.task, chunk=config.chunk, hidden=list(config.hidden)
    )


def build_policy(config: Config, sets: list[Any]) -> ChunkPolicy:
    """Return a new policy, its normalisation fixed by the demonstrations."""
    from rlco import keys
    from rlco.data import exact_quantiles

    policy = new_policy(config)
    frames = [demos.frames() for demos in sets]

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


def train(config: Config, run: Run, demos: dict[str, Any]) -> ChunkPolicy:
    """Train, evaluate, and save the policy to the run's folder ``policy``."""
    import torch

    from rlco.data import SimRealReplayBuffer
    from rlco.losses import CoTrainingLoss, ImitationLoss
    from rlco.physics.named_task import named_task
    from rlco.policies import save_policy

    sim, real = demos["sim_demos"], demos["real_demos"]
    policy = build_policy(config, [d for d in (sim, real) if d is not None])
    buffer = SimRealReplayBuffer(
        sim, real, sim_ratio=config.sim_ratio, batch_size=config.batch_size
    )
    loss = CoTrainingLoss(
        ImitationLoss(policy) if sim is not None else None,
        ImitationLoss(policy) if real is not None else None,
        sim_coeff=config.sim_ratio,
        real_coeff=1.0 - config.sim_ratio,
    )
    optimizer = torch.optim.AdamW(
        loss.parameters(), lr=config.lr, weight_decay=config.weight_decay
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, config.updates)
    if (saved := run.load_checkpoint()) is not None:
        loss.load_state_dict(saved["loss"])
        optimizer.load_state_dict(saved["optimizer"])
        schedule.load_state_dict(saved["schedule"])
        buffer.load_state_dict(saved["buffer"])

    for block in run.iterations(-(-config.updates // config.log_every)):
        left = config.updates - (block - 1) * config.log_every
        totals: dict[str, float] = {}
        for _ in range(count := min(config.log_every, left)):
            terms = loss(buffer.sample())
            optimizer.zero_grad()
            sum(terms.values()).backward()
            optimizer.step()
            schedule.step()
            for name, value in terms.items():
                totals[name] = totals.get(name, 0.0) + float(value.detach()) / count
        run.log_metrics(block, {"updates": config.updates - left + count, **totals})
        run.save_checkpoint(
            block,
            {
                "loss": dict(loss.state_dict()),
                "optimizer": optimizer.state_dict(),
                "schedule": schedule.state_dict(),
                "buffer": buffer.state_dict(rows=False),
            },
        )
    save_policy(
        policy,
        run.path / "policy",
        extra={"sim_ratio": config.sim_ratio, **named_task(config.task).description()},
    )
    return policy


def main(config: Config) -> None:
    """Check the data, train, and evaluate."""
    demos = load(config)  # what is wrong with it shows before a folder is made
    from rlco.evaluation import evaluate, evaluation_env

    method = "real_only" if config.sim_ratio == 0 else "sft"
    with Run(config, "sft") as run:
        policy = train(config, run, demos)
        rows = []
        for domain in config.eval_domains if config.eval_episodes else []:
            env = evaluation_env(
                config.task,
                domain,
                chunk=config.chunk,
                episodes=config.eval_episodes,
                image_size=policy.image_size,
            )
            result = evaluate(policy, env, config.eval_episodes)
            log.info("%s in %s: %s", method, domain, result)
            row = result.row(
                method, domain, config.seed, task=config.task, policy=policy.kind
            )
            rows.append(row)
        run.save_results(rows)
        log.info("policy: %s", run.path / "policy")


if __name__ == "__main__":
    run_recipe(main, Config)
