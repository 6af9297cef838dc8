"""How far a rollout's log-probability is from the one that the learner computes.

    uv run benchmarks/log_prob_gap.py 'runs=[outputs/quickstart/RUN]'

Rollouts draw and learners evaluate in other batches, and tokens by other code. Measured
at most over the decisions: for the policies of quickstart's runs after Stage II, on
states of their demonstrations (1024 drawn 128 at once, evaluated 512 at once), and for
the tiny pi0.5, SmolVLA and OpenVLA (64 drawn at once, evaluated 40 at once).
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from vla_models import INSTRUCTIONS, Actor, rows

from rlco.data import load_demos
from rlco.losses import log_probs
from rlco.policies import load_policy
from rlco.policies.tiny.openvla import write_tiny_openvla
from rlco.policies.tiny.pi05 import write_tiny_pi05
from rlco.policies.tiny.smolvla import write_tiny_smolvla
from rlco.policies.vla.lerobot.checkpoint import load_lerobot
from rlco.policies.vla.lerobot.policy import LeRobotPolicy
from rlco.policies.vla.openvla.load import load_openvla
from rlco.policies.vla.openvla.policy import OpenVLAPolicy
from rlco.run import run_recipe
from rlco.runs.config import option

DTYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16}


@dataclass
class Config:
    """Options of log_prob_gap.py."""

    runs: list[str] = option([], "quickstart's run directories")


def gap(policy: Actor, seen: TensorDictBase, *, drawn: int, evaluated: int) -> float:
    """Return the largest difference of two log-probabilities [nats].

    Args:
        policy: the actor.
        seen: observations, shape (decisions,).
        drawn: decisions that are drawn at once.
        evaluated: decisions that are evaluated at once.
    """
    with torch.no_grad():
        rollout = torch.cat([policy(part.clone()) for part in seen.split(drawn)])
    learners = log_probs(policy, rollout, rows=evaluated)
    return float((learners - rollout["vla_action", "log_probs"]).abs().max())


def small(run: Path, dtype: torch.dtype) -> float:
    """Return the gap of a quickstart's policy after Stage II."""
    policy, _ = load_policy(run / "stages" / "rl_co" / "policy")
    policy.to(dtype)
    frames = load_demos(run / "data" / "sim")[:].select(*policy.in_keys)
    seen = frames[torch.randint(len(frames), (1024,))]
    return gap(policy, seen, drawn=128, evaluated=512)


def lerobot(write: Callable[..., Any], dtype: torch.dtype, reduction: Any) -> float:
    """Return the gap of a tiny LeRobot checkpoint."""
    checkpoint = load_lerobot(write(tempfile.mkdtemp()))
    network = checkpoint.model.policy.model
    if write is write_tiny_smolvla:
        network.vlm_with_expert.to(dtype)  # LeRobot leaves its projections in float32
    elif dtype is torch.bfloat16:
        checkpoint = load_lerobot(write(tempfile.mkdtemp(), dtype="bfloat16"))
    policy = LeRobotPolicy(
        checkpoint, instructions=INSTRUCTIONS, denoise_reduction=reduction
    )
    seen = rows(64, chunk=8, size=64).exclude("vla_action")
    return gap(policy, seen, drawn=64, evaluated=40)


def openvla(dtype: torch.dtype) -> float:
    """Return the gap of the tiny OpenVLA."""
    folder = write_tiny_openvla(tempfile.mkdtemp())
    policy = OpenVLAPolicy(
        load_openvla(folder, dtype=dtype),
        instructions=INSTRUCTIONS,
        tokenizer=folder,
        action_quantiles=([-1.0] * 7, [1.0] * 7),
    )
    seen = rows(64, chunk=1, size=64).exclude("vla_action")
    return gap(policy, seen, drawn=64, evaluated=40)


def measured(config: Config, dtype: torch.dtype) -> Iterator[tuple[str, float]]:
    """Yield each policy's name and gap."""
    for run in config.runs:
        yield run, small(Path(run), dtype)
    for name, write in {
        "pi0.5": write_tiny_pi05,
        "SmolVLA": write_tiny_smolvla,
    }.items():
        for reduction in ("mean", "sum"):
            yield f"tiny {name}, {reduction}", lerobot(write, dtype, reduction)
    yield "tiny OpenVLA", openvla(dtype)


def main(config: Config) -> None:
    """Measure and print."""
    found: dict[str, list[float]] = {}
    for dtype in DTYPES.values():
        torch.manual_seed(0)
        for name, value in measured(config, dtype):
            found.setdefault(name, []).append(value)
    print(f"| policy | {' | '.join(DTYPES)} |\n|---|---|---|")
    for name, values in found.items():
        print(f"| {name} | {' | '.join(f'{value:.1e}' for value in values)} |")


if __name__ == "__main__":
    run_recipe(main, Config)
