"""How rlco compiles with numba, and a word before: the first time takes a minute."""

from __future__ import annotations

import logging
from typing import Any

from numba import njit
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


def inner[F](function: F) -> F:
    """Return a function compiled for other compiled functions alone.

    Without what Python would need to call it, which for a tuple of many arrays takes
    longer to compile than the function itself. As in OpenGL, a division by 0 gives
    infinity.
    """
    options: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    compiled: F = njit(nogil=True, cache=True, error_model="numpy", **options)(function)
    return compiled
