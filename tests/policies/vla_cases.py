"""Tiny LeRobot checkpoints and OpenVLA, and rows that they can read."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase

from rlco.policies.tiny.openvla import write_tiny_openvla
from rlco.policies.tiny.pi05 import write_tiny_pi05
from rlco.policies.tiny.smolvla import write_tiny_smolvla
from rlco.policies.vla.lerobot.checkpoint import LeRobotCheckpoint, load_lerobot
from rlco.policies.vla.lerobot.policy import LeRobotPolicy

INSTRUCTIONS = ("push the blue cube onto its mark", "open the top drawer")
KINDS = ("smolvla", "pi05")
_WRITE: dict[str, Any] = {
    "smolvla": write_tiny_smolvla,
    "pi05": write_tiny_pi05,
    "openvla": write_tiny_openvla,
}


@cache
def folder(kind: str, **options: Any) -> Path:
    """Return a tiny checkpoint's folder, written once; tests must not change it."""
    return Path(_WRITE[kind](mkdtemp(), **options))


def loaded(kind: str, dtype: str = "float32") -> LeRobotCheckpoint:
    """Load a tiny checkpoint."""
    given = {"dtype": dtype} if kind == "pi05" and dtype != "float32" else {}
    checkpoint = load_lerobot(folder(kind, **given))
    if kind == "smolvla" and dtype == "bfloat16":
        checkpoint.model.policy.model.vlm_with_expert.bfloat16()
    return checkpoint


_shared = cache(loaded)


def actor(kind: str, **options: Any) -> LeRobotPolicy:
    """Return a tiny checkpoint as an actor that a test may change."""
    return LeRobotPolicy(loaded(kind), **{"instructions": INSTRUCTIONS, **options})


def still(kind: str, *, dtype: str = "float32", **options: Any) -> LeRobotPolicy:
    """Return an actor whose weights all tests share: they must not change them."""
    checkpoint = _shared(kind, dtype)
    config, steps = checkpoint.config, checkpoint.model.steps_option
    before = {"n_action_steps": config.n_action_steps, steps: getattr(config, steps)}
    policy = LeRobotPolicy(checkpoint, **{"instructions": INSTRUCTIONS, **options})
    vars(config).update(before)  # an actor makes them what it was given
    return policy


def rows(count: int, *, chunk: int = 8, action_size: int = 7) -> TensorDictBase:
    """Draw observations and demonstrated chunks."""
    return TensorDict(
        {
            "observation": {
                "state": torch.rand(count, 7) * 2 - 1,
                "image": torch.randint(256, (count, 3, 64, 64), dtype=torch.uint8),
            },
            "instruction_id": torch.arange(count) % 2,
            "vla_action": {"chunk": torch.rand(count, chunk, action_size) * 2 - 1},
        },
        [count],
    )


def slopes(policy: Any, compute: Callable[[], torch.Tensor]) -> tuple[float, float]:
    """Return a value's slope by autograd and by differences, some way through weights.

    Along one random direction of all weights that are trained: a model of millions of
    them has no time for every one. It goes uphill in each of them, so that the
    difference is far larger than what float32 rounds away.
    """
    parameters = [p for p in policy.parameters() if p.requires_grad]
    gradients = torch.autograd.grad(compute(), parameters, materialize_grads=True)
    torch.manual_seed(3)
    along = [
        torch.randn_like(p).abs() * g.sign() * p.abs().mean()
        for p, g in zip(parameters, gradients, strict=True)
    ]
    slope = sum(float((g * d).sum()) for g, d in zip(gradients, along, strict=True))

    def moved(step: float) -> float:
        with torch.no_grad():
            for parameter, direction in zip(parameters, along, strict=True):
                parameter.add_(direction, alpha=step)
            out = float(compute())
            for parameter, direction in zip(parameters, along, strict=True):
                parameter.add_(direction, alpha=-step)
        return out

    step = 3e-4
    return slope, (moved(step) - moved(-step)) / (2 * step)
