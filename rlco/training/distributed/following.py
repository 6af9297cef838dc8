"""What ranks that write nothing have in the place of a run's folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Self

import torch

from rlco.runs.config import RunOptions
from rlco.runs.state_files import seed_everything


class FollowingRun:
    """A `TrainingRun` that counts iterations and keeps nothing; the first rank does.

    Args:
        config: The recipe's options; the seed is set as `rlco.run.Run` sets it.

    Attributes:
        path: A place that is never written to.
        step: The last iteration of the first rank's checkpoint, once it is told.

    Example:
        >>> with FollowingRun(RunOptions()) as run:
        ...     run.step = 2
        ...     list(run.iterations(4))
        [3, 4]
    """

    path = Path("/nonexistent")

    def __init__(self, config: RunOptions) -> None:
        torch.set_num_threads(config.threads)
        seed_everything(config.seed)
        self.step: int | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_ended: object) -> None:
        """Nothing was opened."""

    def iterations(
        self, total: int, progress: Callable[[int], str] | None = None
    ) -> Iterator[int]:
        """Count the iterations that are left, as the first rank does."""
        del progress
        yield from range((self.step or 0) + 1, total + 1)

    def log_metrics(self, step: int, row: Mapping[str, Any]) -> None:
        """Leave it to the first rank."""

    def log_timings(self, step: int, row: Mapping[str, Any]) -> None:
        """Leave it to the first rank."""

    def save_checkpoint(self, step: int, state: Any) -> Path:
        """Leave it to the first rank."""
        del step, state
        return self.path

    def load_checkpoint(self) -> Any:
        """Return nothing: the first rank sends what it has loaded."""
