"""A user's own Python: what it raises while it is imported, in one sentence."""

from __future__ import annotations

import importlib.util
import sysconfig
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rlco.errors import RlcoError
from rlco.files.reading import FOREIGN, reason

_RAISED: tuple[type[BaseException], ...] = (*FOREIGN, ImportError, SystemExit)


@contextmanager
def importing(what: str) -> Iterator[None]:
    """Turn what a user's module raises into one sentence that says where.

    Args:
        what: What is imported, for the message.

    Raises:
        RlcoError: Something was raised, or the module ends the process.

    Example:
        >>> with importing("module 'my_task'"):
        ...     1 / 0  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        ...
        rlco.errors.RlcoError: module 'my_task' raises ZeroDivisionError (division by \
zero) in line ... of '...'; correct it.
    """
    try:
        yield
    except RlcoError:
        raise
    except _RAISED as error:
        said = reason(error)
        if isinstance(error, SyntaxError) and error.filename:
            said, line, file = error.msg, error.lineno, error.filename
        else:
            last = traceback.extract_tb(error.__traceback__)[-1]
            line, file = last.lineno, last.filename
        raise RlcoError(
            f"{what} raises {type(error).__name__} ({said}) in line {line} of "
            f"{file!r}; correct it."
        ) from error


def source_of(text: str) -> Path | None:
    """Return the file of the module that ``MODULE:NAME`` names; None for all else.

    Python's own modules and installed ones have versions, and are None, too. Nothing is
    imported but the packages that the module is in.

    Example:
        >>> source_of("json:dumps"), source_of("push_cube"), source_of("nowhere:TASK")
        (None, None, None)
    """
    module, colon, name = text.partition(":")
    if not colon or not name.isidentifier():
        return None
    if not all(part.isidentifier() for part in module.split(".")):
        return None
    try:
        spec = importlib.util.find_spec(module)
    except (ModuleNotFoundError, ValueError):  # none, or one without a file
        return None
    if spec is None or not spec.has_location or spec.origin is None:
        return None
    path = Path(spec.origin)
    installed = (sysconfig.get_paths()[name] for name in ("stdlib", "purelib"))
    return None if any(path.is_relative_to(place) for place in installed) else path
