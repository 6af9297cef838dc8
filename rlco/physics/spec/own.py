"""A value in a user's module: MODULE:NAME, as options name tasks and domains."""

from __future__ import annotations

import importlib
import importlib.util

from rlco.errors import RlcoError
from rlco.files import shown
from rlco.files.own_code import importing


def of_module[T](text: str, kind: type[T]) -> T:
    """Return what a module of the user's holds under a name.

    Args:
        text: ``MODULE:NAME``.
        kind: What it must be an instance of.

    Raises:
        RlcoError: The module cannot be imported, raises, or holds no such thing.

    Example:
        >>> of_module("math:pi", float)
        3.141592653589793
    """
    module, _, name = text.partition(":")
    what = kind.__name__.lower()
    with importing(f"module {module!r} of {what}={text}"):
        if not _exists(module):
            raise RlcoError(
                f"cannot import {module!r} for the {what} {text!r}; give MODULE:NAME "
                "of a module that Python finds, with PYTHONPATH=. where it lies in the "
                "working directory."
            )
        found = getattr(importlib.import_module(module), name, None)
    if not isinstance(found, kind):
        raise RlcoError(
            f"module {module!r} holds no {kind.__name__} named {name!r} but "
            f"{shown(found)}; assign one to that name."
        )
    return found


def _exists(module: str) -> bool:
    """Return whether Python finds a module; packages that it is in are imported."""
    if not all(part.isidentifier() for part in module.split(".")):
        return False  # a relative or an empty name
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # one that it would be in
        return False
