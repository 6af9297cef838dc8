"""What the loops of training need of a run directory and of a collector.

`rlco.run.Run` and `rlco.collectors.RolloutCollector` are such; they stand above this
layer, so loops are given them and know them by what they do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from tensordict import TensorDictBase


class TrainingRun(Protocol):
    """A run directory: it counts iterations, and keeps numbers and checkpoints."""

    path: Path
    step: int | None  # the last iteration that a checkpoint holds

    def iterations(
        self, total: int, progress: Callable[[int], str] | None = None
    ) -> Iterator[int]:
        """Count the iterations that are left."""

    def log_metrics(self, step: int, row: Mapping[str, Any]) -> None:
        """Write a row of metrics.csv."""

    def log_timings(self, step: int, row: Mapping[str, Any]) -> None:
        """Write a row of timings.csv."""

    def save_checkpoint(self, step: int, state: Any) -> Path:
        """Save state, as the last act of an iteration."""

    def load_checkpoint(self) -> Any:
        """Return the last checkpoint's state; None where a run starts afresh."""


class Collector(Protocol):
    """What plays rollouts and estimates their advantages."""

    @property
    def frames(self) -> int:
        """Control steps of one rollout, summed over environments."""

    def collect(self, iteration: int) -> TensorDictBase:
        """Return the rollout of one iteration."""
