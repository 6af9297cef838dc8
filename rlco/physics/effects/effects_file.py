"""``effects.yaml``: what a simulator lacks, as a file that people can read and edit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from rlco.errors import DataError
from rlco.physics.effects.apply import library_effect
from rlco.physics.effects.effect import AppliedEffect

VERSION = 1
_KEYS = {"name", "target", "parameters", "units"}
_HEAD = """\
# Effects to add to a simulator: make_env(task, effects="effects.yaml").
# names: from a target to its name in a model that calls it otherwise.
"""


@dataclass(frozen=True)
class EffectsFile:
    """What an ``effects.yaml`` holds.

    Attributes:
        effects: The effects.
        names: From a target's name to the name in another model, where the two differ
            by more than robosuite's prefixes.
    """

    effects: tuple[AppliedEffect, ...]
    names: Mapping[str, str] = field(default_factory=dict)


def write_effects(
    path: str | Path,
    effects: Iterable[AppliedEffect],
    *,
    names: Mapping[str, str] | None = None,
    units: Mapping[str, Mapping[str, str]] | None = None,
) -> None:
    """Write effects.

    Args:
        path: The file.
        effects: The effects.
        names: See `EffectsFile`.
        units: By effect and parameter, for whoever reads the file.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "effects.yaml"
        >>> write_effects(path, [AppliedEffect("command_delay", None, {"delay": 0.05})])
        >>> read_effects(path).effects[0].parameters
        {'delay': 0.05}
    """
    rows = []
    for effect in effects:
        row: dict[str, Any] = {"name": effect.name, "target": effect.target}
        row["parameters"] = {k: float(v) for k, v in effect.parameters.items()}
        found = (units or {}).get(effect.name, {})
        if found:
            row["units"] = dict(found)
        rows.append(row)
    content = {"version": VERSION, "effects": rows, "names": dict(names or {})}
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    Path(path).write_text(_HEAD + text, "utf-8")


def read_effects(path: str | Path) -> EffectsFile:
    """Read effects; whether they fit a model shows when they are applied.

    Raises:
        DataError: If the file is missing, is no YAML, or has another form.
        UnknownNameError: If an effect is not in the library.
    """
    path = Path(path)
    try:
        content = yaml.safe_load(path.read_text("utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())
        raise DataError(
            f"effects file {str(path)!r} cannot be read ({reason}); give an "
            "effects.yaml as the gap workflow writes it."
        ) from None
    if not isinstance(content, dict) or not isinstance(content.get("effects"), list):
        raise DataError(
            f"effects file {str(path)!r} has no list named 'effects'; write one with "
            "name, target and parameters of each."
        )
    if content.get("version", VERSION) != VERSION:
        raise DataError(
            f"effects file {str(path)!r} has version {content['version']!r}; version "
            f"{VERSION} is read, so let the gap workflow write it again."
        )
    names = content.get("names") or {}
    if not _is_text_map(names):
        raise DataError(
            f"names of effects file {str(path)!r} are {names!r}; give a map from names "
            "to names."
        )
    rows = tuple(_effect(path, i, row) for i, row in enumerate(content["effects"], 1))
    return EffectsFile(rows, names)


def _effect(path: Path, number: int, row: Any) -> AppliedEffect:
    place = f"effect {number} of {str(path)!r}"
    if not isinstance(row, dict) or not {"name", "parameters"} <= row.keys() <= _KEYS:
        raise DataError(f"{place} is {row!r}; give its name, target and parameters.")
    library_effect(str(row["name"]))
    target, parameters = row.get("target"), row["parameters"]
    if target is not None and not isinstance(target, str):
        raise DataError(f"{place} has the target {target!r}; give a name, or null.")
    if not isinstance(parameters, dict) or any(
        isinstance(v, bool) or not isinstance(v, int | float)
        for v in parameters.values()
    ):
        raise DataError(f"{place} has the parameters {parameters!r}; give numbers.")
    numbers = {str(k): float(v) for k, v in parameters.items()}
    return AppliedEffect(str(row["name"]), target, numbers)


def _is_text_map(value: Any) -> bool:
    return isinstance(value, dict) and all(
        isinstance(part, str) for pair in value.items() for part in pair
    )
