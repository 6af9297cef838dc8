"""What libraries raise over a damaged file, turned into one sentence."""

from __future__ import annotations

import os
import reprlib
import stat
import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

from rlco.errors import DataError, RlcoError

#: What the standard library and those written in Python raise over bytes that are not
#: what they expect. Those with an exception of their own are given to `reading`.
FOREIGN: tuple[type[Exception], ...] = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    BadZipFile,
    BufferError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    zlib.error,
)
#: What a message shows of a value or of another library's message [characters].
_LONGEST = 200
_SHORT = reprlib.Repr(
    maxlevel=4,
    maxdict=8,
    maxlist=8,
    maxtuple=8,
    maxset=8,
    maxfrozenset=8,
    maxstring=80,
    maxother=80,
)


@contextmanager
def reading(
    path: str | Path,
    *also: type[Exception],
    what: str = "file",
    advice: str = "copy it again",
    error: type[RlcoError] = DataError,
) -> Iterator[None]:
    """Turn what a library raises while it reads a file into one sentence.

    Put the call of the library into it and no more: a mistake of one's own in there
    would be blamed on the file. What is no file is refused before, see `check_kind`.

    Args:
        path: The file or folder that is read.
        also: Exceptions of the library that are no built-in ones.
        what: What it is called in the message.
        advice: What to do about it.
        error: What is raised.

    Raises:
        RlcoError: One raised inside goes through as it is; all else that a file can
            cause becomes an `error`.

    Example:
        >>> import json
        >>> with reading("robot.json"):
        ...     json.loads('{"fps": ')
        Traceback (most recent call last):
        ...
        rlco.errors.DataError: file 'robot.json' is truncated or damaged (Expecting \
value: line 1 column 9 (char 8)); copy it again.
    """
    named = f"{what} {str(path)!r}"
    check_kind(path, advice=advice, error=error)
    try:
        yield
    except RlcoError:
        raise
    except FileNotFoundError as cause:
        raise error(f"{named} is missing; {advice}.") from cause
    except OSError as cause:
        if cause.strerror is None:  # of a library, not of the system
            raise error(f"{named} is damaged ({reason(cause)}); {advice}.") from cause
        raise error(f"{named} cannot be read ({cause.strerror}); {advice}.") from cause
    except MemoryError as cause:
        raise error(f"{named} needs more memory than there is; {advice}.") from cause
    except FOREIGN + also as cause:
        raise error(
            f"{named} is truncated or damaged ({reason(cause)}); {advice}."
        ) from cause


def check_kind(
    *paths: str | Path,
    advice: str = "copy it again",
    error: type[RlcoError] = DataError,
) -> None:
    """Refuse paths of what is neither a file nor a folder, before they are opened.

    A pipe would be waited for, and a device such as ``/dev/zero`` never ends. What is
    missing is left to whoever opens it.

    Raises:
        RlcoError: Of the class `error`, if there is one.

    Example:
        >>> check_kind("/dev/zero", advice="give a file")
        Traceback (most recent call last):
        ...
        rlco.errors.DataError: '/dev/zero' is no file; give a file.
    """
    for path in paths:
        try:
            mode = os.stat(path).st_mode
        except (OSError, ValueError):
            continue
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise error(f"{str(path)!r} is no file; {advice}.")


def reason(error: BaseException) -> str:
    """Return what an exception says, on one short line.

    Example:
        >>> reason(ValueError("no number.")), reason(KeyError())
        ('no number', 'KeyError')
    """
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return cut(lines[0]).rstrip(".") if lines else type(error).__name__


def shown(value: Any) -> str:
    """Return a value as messages show it: `repr`, short whatever its size is.

    A value that holds itself many times over, as YAML's aliases allow, is not spelt
    out.

    Example:
        >>> shown("fast"), len(shown(["x" * 1000] * 1000)) <= 200
        ("'fast'", True)
    """
    try:
        return cut(_SHORT.repr(value))
    except ValueError:  # Python writes out no integer of thousands of digits
        return f"a {type(value).__name__} of many digits"


def cut(text: str, most: int = _LONGEST) -> str:
    """Return a text without what is beyond its first characters."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


#: Of a name in a row of them [characters].
_NAME = 100


def few(names: Sequence[str], most: int = 8) -> str:
    """Return names in a row, the first few of many.

    Example:
        >>> few(["hip", "knee", "toe"], most=2)
        'hip, knee, and 1 more'
    """
    listed = [cut(str(name), _NAME) for name in names[:most]]
    more = [f"and {len(names) - most} more"] if len(names) > most else []
    return ", ".join([*listed, *more])
