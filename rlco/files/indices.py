"""Indices of episodes as short text, and back."""

from __future__ import annotations

from collections.abc import Iterable

from rlco.errors import ConfigError
from rlco.files import shown

#: Of an index; a data set has fewer than ten million episodes.
_DIGITS = 7


def index_list(text: str, option: str = "episodes") -> list[int] | None:
    """Read indices and ranges, ``0-19,25``; None where nothing is given.

    Args:
        text: Of an option.
        option: Its name.

    Raises:
        ConfigError: The text has another form.

    Example:
        >>> index_list("0-2,7"), index_list("[4]"), index_list("")
        ([0, 1, 2, 7], [4], None)
    """
    bare = text.strip("[] ").replace(" ", "")
    if not bare:
        return None
    found: list[int] = []
    for part in bare.split(","):
        first, dash, last = part.partition("-")
        ends = (first, last if dash else first)
        numbers = all(end.isdecimal() and len(end) <= _DIGITS for end in ends)
        if not numbers or int(ends[0]) > int(ends[1]):
            raise ConfigError(
                [
                    f"{option}={shown(text)} is no list of indices; write ranges with "
                    f"their last index, such as {option}=0-19,25"
                ]
            )
        found += range(int(ends[0]), int(ends[1]) + 1)
    return found


def format_indices(indices: Iterable[int]) -> str:
    """Write sorted indices as short ranges.

    Example:
        >>> format_indices([0, 1, 2, 5, 7, 8])
        '0-2, 5, 7-8'
    """
    runs: list[list[int]] = []
    for index in sorted(indices):
        if runs and index == runs[-1][1] + 1:
            runs[-1][1] = index
        else:
            runs.append([index, index])
    return ", ".join(f"{a}-{b}" if b > a else f"{a}" for a, b in runs)
