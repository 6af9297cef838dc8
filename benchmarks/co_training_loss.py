"""What CoTrainingLoss costs above its two losses called one after the other.

Run ``python benchmarks/co_training_loss.py [repeats]`` with OMP_NUM_THREADS=1; it
prints one markdown table. Both sides do a forward and a backward pass on the same
batch, in turns, within one process; the ratio is the median over pairs, with the 95 %
bootstrap interval of that median.

Last table (500 pairs on 2 shared cores, one thread, torch 2.11; target <= 1.05):

| mode | two losses [ms] | CoTrainingLoss [ms] | ratio [95 %] |
|---|---|---|---|
| eager | 15.29 | 15.42 | 1.012 [1.000, 1.025] |
| compiled | 9.11 | 8.20 | 0.902 [0.900, 0.904] |
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.objectives import ClipPPOLoss, LossModule

from rlco.losses import CoTrainingLoss, ImitationLoss
from rlco.policies import GaussianPolicy, ValueNetwork

SIM_ROWS, REAL_ROWS, CHUNK, STATE, OBJECTS = 400, 128, 4, 20, 24
REAL_COEFF = 0.2

Step = Callable[[], None]
Times = NDArray[np.float64]


def make_batch(policy: GaussianPolicy) -> TensorDictBase:
    """Return a minibatch of the size that the recipes use."""

    def observations(rows: int) -> TensorDictBase:
        content = {
            "observation": {
                "state": torch.randn(rows, STATE),
                "environment_state": torch.randn(rows, OBJECTS),
            },
            "instruction_id": torch.randint(3, (rows,)),
        }
        return TensorDict(content, [rows])

    with torch.no_grad():
        sim = policy(observations(SIM_ROWS))
    for name in ("advantage", "value_target", "state_value"):
        sim[name] = torch.randn(SIM_ROWS, 1)
    real = observations(REAL_ROWS)
    real["vla_action", "chunk"] = torch.rand(REAL_ROWS, CHUNK, 7) * 2 - 1
    real["action_is_pad"] = torch.zeros(REAL_ROWS, CHUNK, dtype=torch.bool)
    return TensorDict({"sim": sim, "real": real})


def make_steps(*, compiled: bool) -> tuple[Step, Step]:
    """Return (the two losses apart, CoTrainingLoss), forward and backward each."""
    torch.manual_seed(0)
    policy = GaussianPolicy(
        STATE, chunk=CHUNK, environment_state_size=OBJECTS, num_instructions=3
    )
    value = ValueNetwork(STATE, environment_state_size=OBJECTS, num_instructions=3)
    batch = make_batch(policy)
    parameters = [*policy.parameters(), *value.parameters()]

    def build() -> tuple[LossModule, LossModule]:
        # No clip_value: ClipPPOLoss branches on it, which fullgraph refuses.
        return ClipPPOLoss(policy, value, entropy_coeff=0.005), ImitationLoss(policy)

    losses: list[Any] = [*build(), CoTrainingLoss(*build(), real_coeff=REAL_COEFF)]
    if compiled:
        losses = [torch.compile(loss, fullgraph=True) for loss in losses]
    ppo, imitation, both = losses

    def backward(terms: list[torch.Tensor]) -> None:
        torch.autograd.backward(torch.stack(terms).sum())
        for parameter in parameters:
            parameter.grad = None

    def apart() -> None:
        terms = [v for k, v in ppo(batch["sim"]).items() if k.startswith("loss")]
        terms.append(REAL_COEFF * imitation(batch["real"])["loss_bc"])
        backward(terms)

    def together() -> None:
        backward([v for k, v in both(batch).items() if k.startswith("loss")])

    return apart, together


def compare(apart: Step, together: Step, repeats: int) -> tuple[Times, Times]:
    """Time both in turns, in changing order, after a warm-up; seconds each."""
    for _ in range(20):
        apart()
        together()
    seconds = np.empty((repeats, 2))
    for pair in range(repeats):
        order = ((0, apart), (1, together))
        for column, step in order if pair % 2 else reversed(order):
            start = time.perf_counter()
            step()
            seconds[pair, column] = time.perf_counter() - start
    return seconds[:, 0], seconds[:, 1]


def median_interval(ratios: Times) -> tuple[float, float, float]:
    """Return the median and its 95 % bootstrap interval."""
    rng = np.random.default_rng(0)
    draws = rng.choice(ratios, (1000, len(ratios)))
    low, high = np.quantile(np.median(draws, axis=1), [0.025, 0.975])
    return float(np.median(ratios)), float(low), float(high)


def main(repeats: int) -> None:
    """Print the table."""
    rows = []
    for name, compiled in (("eager", False), ("compiled", True)):
        apart, together = compare(*make_steps(compiled=compiled), repeats)
        ratio, low, high = median_interval(together / apart)
        rows.append(
            f"| {name} | {1e3 * np.median(apart):.2f} | {1e3 * np.median(together):.2f}"
            f" | {ratio:.3f} [{low:.3f}, {high:.3f}] |"
        )
    header = "| mode | two losses [ms] | CoTrainingLoss [ms] | ratio [95 %] |"
    sys.stdout.write("\n".join([header, "|---|---|---|---|", *rows]) + "\n")


if __name__ == "__main__":
    torch.set_num_threads(1)
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 500)
