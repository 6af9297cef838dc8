"""Texts of an experiment that name variables and jobs: ``{seed}``, ``{sft}/policy``."""

from __future__ import annotations

import re
import string
from collections.abc import Iterator, Mapping
from typing import Any

from rlco.files import shown

# Of a number. A width of more digits, or one that braces hold, takes any memory.
_FORMAT = re.compile(r"[0-9]{0,2}(\.[0-9]{1,2})?[defg%]?")


def names_in(value: Any) -> list[str]:
    """Return the names in braces, in their order.

    Raises:
        ValueError: Braces do not match, or hold more than a name and a format.

    Example:
        >>> names_in(["{gap}", "{sft}/policy", 3])
        ['gap', 'sft']
    """
    return [name for name, _ in fields_in(value)]


def fields_in(value: Any) -> list[tuple[str, str]]:
    """Return the names in braces, each with its format, which is mostly "".

    Raises:
        ValueError: Braces do not match, or hold more than a name and a format.

    Example:
        >>> fields_in("yaw{yaw:03d}_{seed}")
        [('yaw', '03d'), ('seed', '')]
    """
    found: list[tuple[str, str]] = []
    for text in _texts(value):
        for _, name, form, conversion in string.Formatter().parse(text):
            if name is None:
                continue
            if not name.isidentifier():
                raise ValueError(f"braces hold {shown(name)}, which is no name")
            if conversion or not _FORMAT.fullmatch(form or ""):
                more = f"!{conversion}" if conversion else f":{form}"
                raise ValueError(
                    f"braces hold {shown(name + more)}; give a name alone, or with a "
                    "number's width, digits and kind, such as 03d or .2f"
                )
            found.append((name, form or ""))
    return found


def takes(value: Any, form: str) -> bool:
    """Return whether a variable's value can be written in a format.

    Example:
        >>> takes(7, "03d"), takes("push_cube", "03d"), takes(0.5, "d")
        (True, False, False)
    """
    try:
        format(plain(value), form)
    except (ValueError, OverflowError):
        return False
    return True


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, list):
        for item in value:
            yield from _texts(item)


def filled(value: Any, names: Mapping[str, Any]) -> str:
    """Return a value as a recipe's command line takes it, names filled in.

    Example:
        >>> filled(["sim", "{where}"], {"where": "stand_in"})
        '[sim,stand_in]'
        >>> filled(True, {}), filled(None, {}), filled(0.2, {})
        ('true', 'null', '0.2')
    """
    if isinstance(value, list):
        return f"[{','.join(filled(item, names) for item in value)}]"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    shown = {key: plain(one) for key, one in names.items()}
    return value.format(**shown) if isinstance(value, str) else str(value)


def plain(value: Any) -> Any:
    """Return a variable's value as texts show it: numbers can still be formatted."""
    return filled(value, {}) if value is None or isinstance(value, bool) else value


def flat(options: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return options with groups as dotted names.

    Example:
        >>> flat({"gaussian": {"std": 0.1}, "seed": 1})
        {'gaussian.std': 0.1, 'seed': 1}
    """
    found: dict[str, Any] = {}
    for name, value in options.items():
        if isinstance(value, Mapping):
            found |= flat(value, f"{prefix}{name}.")
        else:
            found[f"{prefix}{name}"] = value
    return found
