"""Values of a YAML file that no command line takes, or that no text can show."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date
from typing import Any

from rlco.files import shown
from rlco.files.fields import is_number
from rlco.files.reading import cut


def unusable(value: Any, place: str = "") -> Iterator[str]:
    r"""Yield what is wrong in a file's values and names, a sentence each.

    Example:
        >>> list(unusable({"jobs": {"one": ["a\0b"]}}))
        ["jobs one: 'a\\x00b' is no text that a command line takes; give another one"]
    """
    if isinstance(value, dict):
        for name, one in value.items():
            yield from unusable(name, place)
            # The name may be a number of more digits than Python writes out.
            inner = name if isinstance(name, str) else shown(name)
            yield from unusable(one, cut(f"{place} {inner}".strip()))
    elif isinstance(value, list):
        for one in value:
            yield from unusable(one, place)
    elif (kind := _wanted(value)) is not None:
        yield f"{place or 'the file'}: {shown(value)} is no {kind}; give another one"


def _wanted(value: Any) -> str | None:
    """Return what a single value should be and is not; None where it may stay."""
    if isinstance(value, str):
        return None if _is_text(value) else "text that a command line takes"
    if isinstance(value, int):
        return None if isinstance(value, bool) or is_number(value) else "usual number"
    if value is None or isinstance(value, float | date):
        return None
    return "text, number, flag, list or mapping"  # but YAML's bytes or sets


def _is_text(value: str) -> bool:
    try:
        value.encode()
    except UnicodeEncodeError:  # half of a pair, which YAML can name
        return False
    return "\0" not in value
