"""How a run's log is written: printable, and no obstacle where a disk is full."""

from __future__ import annotations

import contextlib
import logging
import sys

from rlco.errors import printable


class Printable(logging.Formatter):
    """Writes out what would move the cursor of a terminal."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record."""
        return printable(super().format(record))


class LogFile(logging.FileHandler):
    """A log that cannot be written stops no run: whatever matters more will say so."""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802
        """Report what went wrong with a record, unless the disk did."""
        if not isinstance(sys.exception(), OSError):
            super().handleError(record)

    def close(self) -> None:
        """Close the file, also where its last lines find no room."""
        with contextlib.suppress(OSError):
            super().close()
