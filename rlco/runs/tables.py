"""The tables of a run, metrics.csv and timings.csv, which TensorBoard shows, too."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rlco.runs.metrics import MetricsFile

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

Name = Literal["metrics", "timings"]
_PREFIX: Mapping[Name, str] = {"metrics": "", "timings": "time/"}


class Tables:
    """The two tables, and a copy for TensorBoard that holds nothing else.

    Args:
        folder: Of the run.
        keep_to: The last step that is kept; None: all are.

    Attributes:
        metrics: What is the same when a run is repeated.
        timings: What differs [s].
    """

    def __init__(self, folder: Path, keep_to: int | None) -> None:
        self.metrics = MetricsFile(folder / "metrics.csv", keep_to=keep_to)
        self.timings = MetricsFile(folder / "timings.csv", keep_to=keep_to)
        self._folder = folder / "tb"
        self._board: SummaryWriter | None = None

    def append(self, name: Name, step: int, row: Mapping[str, Any]) -> None:
        """Write one row of a table; see `MetricsFile.append`."""
        board = self._board or self.open_board()
        file: MetricsFile = getattr(self, name)
        file.append(step, row)
        _show(board, name, file.last)

    def open_board(self) -> SummaryWriter:
        """Begin TensorBoard's files anew, with the rows that are there."""
        from torch.utils.tensorboard import SummaryWriter

        shutil.rmtree(self._folder, ignore_errors=True)
        board = self._board = SummaryWriter(str(self._folder))
        for name in _PREFIX:
            for row in getattr(self, name).rows():
                _show(board, name, row)
        return board

    def sync(self) -> None:
        """Wait until the tables are on the disk."""
        self.metrics.sync()
        self.timings.sync()

    def close(self) -> None:
        """Close TensorBoard's files."""
        if self._board is not None:
            self._board.close()


def _show(board: SummaryWriter, name: Name, row: Mapping[str, float]) -> None:
    for column, value in row.items():
        if column != "step":
            board.add_scalar(_PREFIX[name] + column, value, int(row["step"]))
