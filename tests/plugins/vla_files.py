"""A tiny checkpoint and demonstrations for it, on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from rlco.data import DemoWriter
from rlco.physics.spec.names import ACTION_NAMES, STATE_NAMES
from rlco.physics.tasks.make_task import make_task
from rlco.policies.tiny.smolvla import write_tiny_smolvla


def tiny_with_statistics(path: Path) -> Path:
    """Write a tiny SmolVLA whose processors change something."""
    stats = {
        key: {"mean": torch.full((7,), 0.1), "std": torch.full((7,), 0.5)}
        for key in ("observation.state", "action")
    }
    return write_tiny_smolvla(path, stats=stats)


def record(path: Path) -> Path:
    """Record two short episodes of noise, as a robot with one camera would."""
    rng = np.random.default_rng(0)
    task = make_task("push_cube")
    with DemoWriter(
        path,
        fps=task.control_frequency,
        state_names=STATE_NAMES,
        action_names=ACTION_NAMES,
        camera="front",
        image_size=(64, 64),
    ) as writer:
        for episode in range(2):
            for _ in range(10):
                writer.add_frame(
                    state=rng.uniform(-1, 1, 7),
                    action=rng.uniform(-1, 1, 7),
                    image=rng.integers(256, size=(3, 64, 64), dtype=np.uint8),
                    task=task.instructions[episode],
                )
            writer.save_episode()
    return path
