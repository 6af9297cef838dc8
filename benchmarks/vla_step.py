"""What one co-training step of pi0.5 and of OpenVLA costs.

    uv run benchmarks/vla_step.py

With an accelerator: both at real size, random weights, bfloat16; time, samples a
second, memory and the share of the chip's peak; what does not fit into its memory says
so, and the next line follows. Without one: parameters, operations
and bytes of the real sizes, counted, and the same steps of the tiny models, timed.
"""

from __future__ import annotations

import gc
import resource
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict
from torch.utils.flop_counter import FlopCounterMode
from torchrl.objectives import ClipPPOLoss
from vla_counts import print_counts
from vla_models import (
    Actor,
    openvla_modes,
    pi05_modes,
    real_openvla,
    real_pi05,
    rows,
    tiny_openvla,
    tiny_pi05,
)

from rlco.losses import CoTrainingLoss, ImitationLoss, log_probs
from rlco.policies.vla.prefix_cache import with_prefixes
from rlco.policies.vla.prefix_critic import PrefixCritic
from rlco.run import run_recipe
from rlco.runs.config import option
from rlco.training import MasterWeightAdamW

#: Dense bfloat16 [operations a second] by a part of the device's name.
PEAKS = {"H200": 989e12, "H100": 989e12, "A100": 312e12}


@dataclass
class Config:
    """Options of vla_step.py."""

    sim_rows: int = option(40, "simulated decisions of a step", minimum=1)
    real_rows: int = option(16, "real rows of a step", minimum=1)
    repeats: int = option(20, "steps that are timed", minimum=1)
    tiny: bool = option(False, "time the tiny models even where there is a GPU")


@dataclass(frozen=True)
class Measured:
    """One line of the table: what a step took.

    Attributes:
        seconds: median of the steps.
        operations: floating-point operations of a step.
        memory: most memory in use [bytes], of the GPU, or of this process.
    """

    seconds: float
    operations: int
    memory: int


def prepare(config: Config, policy: Actor) -> Callable[[], None]:
    """Return one co-training step: losses, gradients, optimiser."""
    torch.manual_seed(0)
    size = 64 if policy.device.type == "cpu" else 224
    keeps = getattr(policy, "keep_prefix", False)

    def drawn(count: int) -> Any:
        return rows(count, chunk=policy.chunk, size=size)

    sim = drawn(config.sim_rows).exclude("vla_action")
    observed = sim.clone()
    with torch.no_grad():
        sim = policy(sim)
    critic = PrefixCritic(sim["vla_prefix", "summary"].shape[-1]).to(policy.device)
    if keeps:
        real = with_prefixes(drawn(config.real_rows), policy.new_prefix, rows=8)[:]
    else:
        real = drawn(config.real_rows)
        kept = sim["vla_prefix", "summary"]
        sim = sim.update(observed).exclude("vla_prefix")
        sim["vla_prefix", "summary"] = kept
    sim, real = sim.to(policy.device), real.to(policy.device)
    sim["vla_action", "log_probs"] = log_probs(policy, sim)
    sim["advantage"] = torch.randn(config.sim_rows, 1, device=policy.device)
    with torch.no_grad():
        sim = critic(sim)
    sim["value_target"] = sim["state_value"] + 1
    ppo = ClipPPOLoss(policy, critic, functional=False, entropy_bonus=False)
    loss = CoTrainingLoss(ppo, ImitationLoss(policy, functional=False))
    trained = [p for p in loss.parameters() if p.requires_grad]
    fused = policy.device.type != "cpu"
    optimizer = MasterWeightAdamW(trained, lr=4e-6, fused=fused)
    batch = TensorDict({"sim": sim, "real": real})

    def step() -> None:
        optimizer.zero_grad()
        out = loss(batch)
        sum(v for k, v in out.items() if k.startswith("loss_")).backward()
        optimizer.step()

    return step


def measure(config: Config, build: Callable[[], Actor]) -> Measured:
    """Time a model's step."""
    policy = build()
    on_gpu = policy.device.type != "cpu"
    step = prepare(config, policy)
    if on_gpu:
        torch.cuda.reset_peak_memory_stats()
    with FlopCounterMode(display=False) as counter:
        step()
    seconds = []
    for _ in range(config.repeats):
        if on_gpu:
            torch.cuda.synchronize()
        started = time.perf_counter()
        step()
        if on_gpu:
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - started)
    memory = (
        torch.cuda.max_memory_allocated()
        if on_gpu
        else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    )
    return Measured(
        statistics.median(seconds), int(counter.get_total_flops()), int(memory)
    )


def main(config: Config) -> None:
    """Count or measure, and print."""
    on_gpu = torch.cuda.is_available() and not config.tiny
    if on_gpu:
        modes = pi05_modes(real_pi05) | openvla_modes(real_openvla)
        device = torch.cuda.get_device_name()
        peak = next((v for k, v in PEAKS.items() if k in device), None)
        print(f"{device}, real sizes, bfloat16, random weights\n")
    else:
        print_counts()
        modes = pi05_modes(tiny_pi05) | openvla_modes(tiny_openvla)
        peak = None
        print("\nTiny models, one CPU thread, float32\n")
    samples = config.sim_rows + config.real_rows
    print("| trained | step [ms] | samples a second | GFLOP | memory | of the peak |")
    print("|---|---|---|---|---|---|")
    for name, build in modes.items():
        try:
            cells = measured_cells(measure(config, build), samples, peak)
        except torch.cuda.OutOfMemoryError:
            cells = ["out of memory", "-", "-", "-", "-"]
        print(f"| {' | '.join([name, *cells])} |", flush=True)
        # Outside of the handler: there its traceback still holds the model.
        gc.collect()
        if on_gpu:
            torch.cuda.empty_cache()


def measured_cells(found: Measured, samples: int, peak: float | None) -> list[str]:
    """Return a line's cells after its name."""
    share = 0.0 if peak is None else found.operations / found.seconds / peak
    return [
        f"{1e3 * found.seconds:.1f}",
        f"{samples / found.seconds:.0f}",
        f"{found.operations / 1e9:.2f}",
        f"{found.memory / 2**30:.2f} GiB",
        f"{share:.1%}" if share else "-",
    ]


if __name__ == "__main__":
    run_recipe(main, Config)
