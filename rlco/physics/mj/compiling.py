"""How rlco compiles with numba, and a word before: the first time takes a minute."""

from __future__ import annotations

import logging
from typing import Any

from llvmlite.ir import Constant
from numba import njit, types
from numba.core.errors import TypingError
from numba.core.event import Event, Listener, register
from numba.extending import intrinsic

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


@intrinsic
def borrowed(context: Any, value: Any) -> Any:
    """Return arrays, or a tuple of arrays and numbers, without counts of references.

    For compiled functions alone. Numba counts who uses an array with atomic operations,
    several at each call of a function that gets it: in the loop over the pixels of a
    frame that took longer than all else, more so when two threads count the same array.
    What a function was given outlives the function, and needs no count there. What it
    makes itself does not: numba frees an array after the last use that it counts, so
    that a function which owns one has to give it to another that borrows it.
    """
    if not any(isinstance(value, kind) for kind in (types.Array, types.BaseTuple)):
        raise TypingError(f"{value} is neither an array nor a tuple")

    def compile_(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _uncounted(target, builder, signature.args[0], arguments[0])

    return value(value), compile_


def _uncounted(target: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.BaseTuple):
        for place, each in enumerate(kind):
            one = builder.extract_value(value, place)
            one = _uncounted(target, builder, each, one)
            value = builder.insert_value(value, one, place)
        return value
    if isinstance(kind, types.Array):
        array = target.make_helper(builder, kind, value=value)
        for owner in ("meminfo", "parent"):
            setattr(array, owner, Constant(getattr(array, owner).type, None))
        return array._getvalue()
    return value
