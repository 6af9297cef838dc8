"""A small training with all that a resumed run must have back."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import torch
from torch import nn

from rlco.run import Run
from rlco.runs.config import RunOptions

ITERATIONS = 3


def train(config: RunOptions, iterations: int = ITERATIONS) -> None:
    """Train for some iterations; writes the weights to ``weights.txt`` at the end."""
    with Run(config, "toy") as run:
        layer = nn.Linear(3, 1)
        optimizer = torch.optim.AdamW(layer.parameters(), lr=0.1)
        schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.5)
        if (saved := run.load_checkpoint()) is not None:
            layer.load_state_dict(saved["layer"])
            optimizer.load_state_dict(saved["optimizer"])
            schedule.load_state_dict(saved["schedule"])
        else:
            run.log_metrics(0, {"loss": 1.0})
        for step in run.iterations(iterations):
            scale = random.random() + np.random.rand()  # noqa: NPY002 - saved, too
            batch = torch.randn(4, 3) * scale
            loss = layer(batch).square().mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            late = {"late": step} if step >= 2 else {}  # a column that comes later
            run.log_metrics(step, {"loss": loss, **late})
            run.log_timings(step, {"update": random.random()})
            run.save_checkpoint(
                step,
                {
                    "layer": dict(layer.state_dict()),
                    "optimizer": optimizer.state_dict(),
                    "schedule": schedule.state_dict(),
                },
            )
        (run.path / "weights.txt").write_text(repr(layer.weight.tolist()))


def result(run: Path) -> dict[str, bytes]:
    """Return what two runs of the same options have in common, to the byte."""
    return {
        name: (run / name).read_bytes()
        for name in ("metrics.csv", "timings.csv", "weights.txt", "config.yaml")
    }
