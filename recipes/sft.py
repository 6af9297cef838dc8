"""Stage I: imitate simulated and real demonstrations, mixed by sim_ratio.

    uv run recipes/sft.py sim_demos=demos/sim real_demos=demos/stand_in
    uv run recipes/sft.py real_demos=demos/stand_in sim_ratio=0    # real data alone

L = alpha L_BC(D_sim) + (1 - alpha) L_BC(D_real), alpha = sim_ratio, the share of
simulated samples (RL-Co, arXiv 2602.12628, Stage I).
"""

from __future__ import annotations

import logging
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from rlco.config import RunOptions, option
from rlco.errors import ConfigError
from rlco.run import Run, run_recipe

if TYPE_CHECKING:
    from rlco.data import DemoReplayBuffer
    from rlco.policies import ChunkPolicy

log = logging.getLogger("rlco.sft")


@dataclass
class GaussianOptions:
    """Options of policy=gaussian."""

    std: float = option(0.2, "exploration, in units of the normalised action")
    imitation: Literal["nll", "mse"] = option("nll", "imitation loss of a step")


@dataclass
class TokenOptions:
    """Options of policy=token."""

    width: int = option(64, "features of a position of the transformer", minimum=1)
    layers: int = option(1, "blocks of the transformer", minimum=1)
    heads: int = option(4, "attention heads; they divide the width", minimum=1)
    bins: int = option(256, "tokens an action number", minimum=2)
    bin_range: float = option(
        1.25, "outermost edges of the bins, in units of the normalised action"
    )
    temperature: float = option(1.0, "logits are divided by it")
    noise_std: float = option(
        0.2, "noise on demonstrations, in units of the normalised action", minimum=0
    )
    hidden_share: float = option(
        0.5, "share of chunks imitated from the observation alone", minimum=0, maximum=1
    )
    log_prob_level: Literal["chunk", "action", "token"] = option(
        "chunk", "what one ratio of PPO covers"
    )


@dataclass
class FlowOptions:
    """Options of policy=flow."""

    steps: int = option(4, "denoising steps", minimum=1)
    method: Literal["flow_noise", "flow_sde", "fpo"] = option(
        "flow_noise", "what stands for the log-probability"
    )
    noisy_steps: Literal["all", "one"] = option("all", "denoising steps with noise")
    noise_range: list[float] = option(
        [0.08, 0.16], "flow_noise: least and greatest standard deviation of a step"
    )
    noise_level: float = option(0.5, "flow_sde: size of the noise")
    denoise_reduction: Literal["mean", "sum"] = option(
        "mean", "of a chain's log-probabilities"
    )
    log_prob_level: Literal["chunk", "action", "token"] = option(
        "chunk", "what one ratio of PPO covers"
    )
    imitation_draws: int = option(1, "times and noises a row", minimum=1)
    padded_size: int | None = option(
        None, "numbers that RLinf's mean would run over; null: the real ones"
    )


@dataclass
class Config(RunOptions):
    """Options of sft.py."""

    name: str = option("sft", "name of the run, a part of its folder's name")
    task: str = option("push_cube", "name of the task")
    sim_demos: str | None = option(None, "LeRobot folder of simulated demonstrations")
    real_demos: str | None = option(None, "LeRobot folder of real demonstrations")
    rename: str = option(
        "", "features of real_demos with other names: THEIRS:OURS,THEIRS:OURS"
    )
    sim_ratio: float = option(0.5, "alpha, the share of sim", minimum=0, maximum=1)
    policy: Literal["gaussian", "token", "flow"] = option("gaussian", "kind of policy")
    chunk: int = option(4, "control steps of an action chunk", minimum=1)
    hidden: list[int] = option([256, 256], "width of each hidden layer", minimum=1)
    gaussian: GaussianOptions = field(default_factory=GaussianOptions)
    token: TokenOptions = field(default_factory=TokenOptions)
    flow: FlowOptions = field(default_factory=FlowOptions)
    updates: int = option(1500, "optimiser steps", minimum=1)
    log_every: int = option(100, "updates between rows of metrics.csv", minimum=1)
    batch_size: int = option(256, "rows of a batch, both kinds together", minimum=1)
    lr: float = option(1e-3, "learning rate, falling to 0 along a cosine")
    weight_decay: float = option(1e-4, "AdamW's weight decay", minimum=0)
    eval_episodes: int = option(128, "episodes of the evaluation; 0: none", minimum=0)
    eval_domains: list[str] = option(["sim", "stand_in"], "domains to evaluate in")


def load(config: Config) -> dict[str, DemoReplayBuffer | None]:
    """Load the demonstrations that sim_ratio asks for."""
    from rlco.data import load_task_demos
    from rlco.physics.named_task import check_domains, named_task

    task = named_task(config.task)
    check_domains(config.task, config.eval_domains if config.eval_episodes else ())
    needed = {"sim_demos": config.sim_ratio > 0, "real_demos": config.sim_ratio < 1}
    problems = [
        f"sim_ratio={config.sim_ratio} needs {name}=FOLDER"
        for name, need in needed.items()
        if need and getattr(config, name) is None
    ]
    if problems:
        raise ConfigError(problems)
    new_policy(config)  # what is wrong with its options shows here
    rename = {"sim_demos": "", "real_demos": config.rename}
    return {
        name: load_task_demos(
            getattr(config, name), task, chunk=config.chunk, rename=rename[name]
        )
        if need
        else None
        for name, need in needed.items()
    }


def new_policy(config: Config) -> ChunkPolicy:
    """Return a new policy of the kind and the size that the options give."""
    from rlco.physics.named_task import named_task
    from rlco.policies import make_policy, task_sizes

    policy: ChunkPolicy = make_policy(
        config.policy,
        chunk=config.chunk,
        action_size=len(named_task(config.task).action_names),
        hidden=list(config.hidden),
        **task_sizes(named_task(config.task)),
        **asdict(getattr(config, config.policy)),
    )
    return policy


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
        environment_state=quantiles(keys.ENVIRONMENT_STATE),
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
                config.task, domain, chunk=config.chunk, episodes=config.eval_episodes
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
