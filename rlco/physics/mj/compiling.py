"""A word before numba compiles for the first time: it takes up to a minute."""

from __future__ import annotations

import logging

from numba.core.event import Event, Listener, register

_logger = logging.getLogger(__name__)


class _Word(Listener):
    """Says it once, of functions of rlco's, which numba keeps on disk."""

    said = False

    def on_start(self, event: Event) -> None:
        """Say it, unless it was said or the function is a user's own."""
        module = event.data["dispatcher"].py_func.__module__
        if not self.said and module.startswith("rlco."):
            self.said = True
            _logger.info("compiling (once: numba keeps what it has compiled)")

    def on_end(self, event: Event) -> None:
        """Say nothing."""


def announce() -> None:
    """Log when rlco's own functions are about to be compiled, the first time."""
    register("numba:compile", _Word())
