"""What pi0.5 and OpenVLA cost at real size, counted without computing anything."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode
from vla_models import OPENVLA_7B, OnMeta, pi05_config

from rlco.policies.vla.lerobot.flow_model import velocity_given
from rlco.policies.vla.lerobot.pi05 import Pi05Model
from rlco.policies.vla.openvla.model import OpenVLA

STEPS = 4
TEXT = 20  # tokens of a prompt of OpenVLA
Work = Callable[[], Any]


@dataclass(frozen=True)
class Count:
    """One line of the table.

    Attributes:
        name: of the model and of what is trained.
        parameters: all of them.
        trained: those that are trained.
        forward: floating-point operations of a forward pass, one sample.
        update: the same of forward and backward.
        bytes_per_row: keys and values that a rollout carries, one sample.
    """

    name: str
    parameters: int
    trained: int
    forward: int
    update: int
    bytes_per_row: int = 0


def operations(work: Work) -> int:
    """Count floating-point operations, two for a multiplication and an addition."""
    with FlopCounterMode(display=False) as counter:
        work()
    return int(counter.get_total_flops())


def size(parameters: Iterable[nn.Parameter]) -> int:
    """Count numbers."""
    return sum(parameter.numel() for parameter in parameters)


def count_pi05() -> list[Count]:
    """Count pi0.5: one camera, chunks of 8, four denoising steps, bfloat16."""
    config = pi05_config(device="cpu", dtype="bfloat16")
    model = Pi05Model(OnMeta(config))
    core = model.policy.model
    every = list(core.parameters())
    for module in model.unused_modules():
        module.requires_grad_(False)
    batch = {
        "observation.images.front": torch.empty(1, 3, 224, 224, device="meta"),
        "observation.language.tokens": torch.empty(
            1, 200, dtype=torch.int64, device="meta"
        ),
        "observation.language.attention_mask": torch.empty(
            1, 200, dtype=torch.bool, device="meta"
        ),
    }
    chain = torch.empty(1, STEPS, config.chunk_size, 32, device="meta")
    times = torch.empty(STEPS, device="meta")
    kept = model.prefix(batch)

    def expert(prefix: Any) -> torch.Tensor:
        return velocity_given(model, prefix)(chain, times)[0]

    def trained() -> int:
        return size(p for p in every if p.requires_grad)

    with torch.no_grad():
        seen = operations(lambda: model.prefix(batch))
        steps = operations(lambda: expert(kept))
    whole = trained(), operations(lambda: expert(model.prefix(batch)).sum().backward())
    for module in model.prefix_modules():
        module.requires_grad_(False)
    kept = model.prefix(batch)
    alone = trained(), operations(lambda: expert(kept).sum().backward())
    total, carried = size(every), kept.bytes_per_row
    forward = seen + steps
    return [
        Count("pi0.5, all weights", total, whole[0], forward, whole[1]),
        Count("pi0.5, expert", total, alone[0], forward, seen + alone[1]),
        Count("pi0.5, expert, kept", total, alone[0], steps, alone[1], carried),
    ]


def count_openvla() -> list[Count]:
    """Count openvla-7b: one image, a prompt of twenty tokens, seven action tokens."""
    with torch.device("meta"):
        model = OpenVLA(OPENVLA_7B)
    # The others look into the mask, which has no content here.
    model.language_model.set_attn_implementation("eager")
    image = torch.empty(1, 3, 224, 224, dtype=torch.uint8, device="meta")
    tokens = torch.empty(1, TEXT, dtype=torch.int64, device="meta")
    mask = torch.empty(1, TEXT, dtype=torch.bool, device="meta")
    actions = torch.empty(1, 7, dtype=torch.int64, device="meta")

    def evaluate() -> torch.Tensor:
        return model.action_logits(model.states(image, tokens, mask, actions))

    total = size(model.parameters())
    with torch.no_grad():
        forward = operations(evaluate)
    update = operations(lambda: evaluate().sum().backward())
    return [Count("OpenVLA, all weights", total, total, forward, update)]


def print_counts() -> None:
    """Print the table."""
    print("| real size | parameters | trained | forward | update | kept |")
    print("|---|---|---|---|---|---|")
    for count in (*count_pi05(), *count_openvla()):
        print(
            f"| {count.name} | {count.parameters / 1e9:.2f} G | "
            f"{count.trained / 1e9:.2f} G | {count.forward / 1e12:.3f} TFLOP | "
            f"{count.update / 1e12:.3f} TFLOP | {count.bytes_per_row / 2**20:.1f} MiB |"
        )
