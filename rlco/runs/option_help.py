"""The text that ``help`` prints: a recipe's options, a line each."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rlco.runs.options import Option, options_of, started_by_rlco


def help_table(config_class: type, recipe_path: Path, configs: Iterable[str]) -> str:
    """Lay out the text that ``help`` prints: usage, configs, one line an option."""
    options = options_of(config_class)
    rows = [("option", "type", "default", "meaning")]
    for key, entry in options.items():
        default = "required" if entry.is_required else _show(entry.default)
        rows.append((key, entry.type_name, default, _meaning(entry)))
    widths = [min(36, max(len(row[i]) for row in rows)) for i in range(3)]
    indent = sum(widths) + 6
    room = max(30, shutil.get_terminal_size((100, 24)).columns - indent)
    lines = [
        f"usage: {_command(recipe_path)} [config=NAME|PATH] [key=value ...]",
        f"configs: {', '.join(sorted(configs)) or 'none'}",
        "",
    ]
    for row in rows:
        left = "  ".join(f"{cell:<{w}}" for cell, w in zip(row, widths, strict=False))
        meaning = textwrap.wrap(row[3], room) or [""]
        if len(left) > indent - 2:
            lines.append(left.rstrip())
            left = " " * (indent - 2)
        lines.append(f"{left}  {meaning[0]}".rstrip())
        lines += [" " * indent + text for text in meaning[1:]]
    return "\n".join(lines) + "\n"


def _command(recipe_path: Path) -> str:
    if started_by_rlco():
        return f"rlco {recipe_path.stem}"
    return f"uv run {recipe_path.parent.name}/{recipe_path.name}"


def _show(default: Any) -> str:
    if default is None or isinstance(default, bool):
        return str(default).lower().replace("none", "null")
    return str(default)


def _meaning(entry: Option) -> str:
    """Return what an option means, its limits, and what its values imply."""
    implied = "".join(
        f"; {value} implies, unless given: "
        + " ".join(f"{key}={_show(default)}" for key, default in defaults.items())
        for value, defaults in entry.implies.items()
    )
    return entry.help + _limits(entry) + implied


def _limits(entry: Option) -> str:
    parts = []
    if entry.minimum is not None:
        parts.append(f"at least {entry.minimum:g}")
    if entry.maximum is not None:
        parts.append(f"at most {entry.maximum:g}")
    return f" ({', '.join(parts)})" if parts else ""
