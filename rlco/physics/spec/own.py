"""A value in a user's module: MODULE:NAME, as options name tasks and domains."""

from __future__ import annotations

import importlib

from rlco.errors import RlcoError


def of_module[T](text: str, kind: type[T]) -> T:
    """Return what a module of the user's holds under a name.

    Args:
        text: ``MODULE:NAME``.
        kind: What it must be an instance of.

    Raises:
        RlcoError: The module cannot be imported, or holds no such thing.

    Example:
        >>> of_module("math:pi", float)
        3.141592653589793
    """
    module, _, name = text.partition(":")
    what = kind.__name__.lower()
    try:
        found = getattr(importlib.import_module(module), name, None)
    # A relative or an empty name is a TypeError or ValueError of Python's.
    except (ModuleNotFoundError, TypeError, ValueError) as error:
        raise RlcoError(
            f"cannot import {module!r} for the {what} {text!r} ({error}); give "
            "MODULE:NAME of a module that Python finds, with PYTHONPATH=. where it "
            "lies in the working directory."
        ) from error
    if not isinstance(found, kind):
        raise RlcoError(
            f"module {module!r} holds no {kind.__name__} named {name!r} but {found!r}; "
            "assign one to that name."
        )
    return found
