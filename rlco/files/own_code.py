"""A user's own Python: what it raises while it is imported, in one sentence."""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from contextlib import contextmanager

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
