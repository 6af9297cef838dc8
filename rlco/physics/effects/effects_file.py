"""``effects.yaml``: what a simulator lacks, as a file that people can read and edit.

It is also a domain file, see `rlco.physics.spec.domain.read_domain`. A file with a
look or a sample of parameter sets has version 3, another one with sensors version 2,
all others version 1.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rlco.errors import DataError, suggest
from rlco.files import read_yaml, shown, yaml_text
from rlco.files.fields import is_number
from rlco.physics.effects.apply import library_effect
from rlco.physics.effects.effect import AppliedEffect

VERSION = 1
WITH_SENSORS = 2  # the version of files with sensors
NEWEST = 3  # the version of files with a look or a sample
_VERSIONS = (VERSION, WITH_SENSORS, NEWEST)
_TOP = ("version", "effects", "names", "sensors", "look", "sample")
_KEYS = {"name", "target", "parameters", "units"}
_HEAD = """\
# What a simulator lacks: make_env(task, domain="effects.yaml") has it.
# names: from a target to its name in a model that calls it otherwise.
"""
_SAMPLE_HEAD = """\
# sample: parameter sets that are as believable as the one above, in the intervals and
# with their correlations; make_env(..., sample="posterior") draws one an episode.
"""


@dataclass(frozen=True)
class EffectsFile:
    """The contents of an ``effects.yaml``.

    Attributes:
        effects: The effects.
        names: From a target's name to its name in another model, where the two differ
            by more than robosuite's prefixes.
        sensors: The file's entry on sensors, unchanged; None: no entry.
        look: The file's entry on the look, or its name, unchanged; None: no entry.
        sample: The file's entry on parameter sets, unchanged; None: no entry. See
            `rlco.physics.spec.sample.sample_of`.
    """

    effects: tuple[AppliedEffect, ...]
    names: Mapping[str, str] = field(default_factory=dict)
    sensors: Mapping[str, Any] | None = None
    look: Mapping[str, Any] | str | None = None
    sample: Mapping[str, Any] | None = None

    def renamed(self) -> tuple[AppliedEffect, ...]:
        """Return the effects with targets renamed by `names`."""
        return tuple(
            effect
            if effect.target is None
            else replace(effect, target=self.names.get(effect.target, effect.target))
            for effect in self.effects
        )


def write_effects(
    path: str | Path,
    effects: Iterable[AppliedEffect],
    *,
    names: Mapping[str, str] | None = None,
    units: Mapping[str, Mapping[str, str]] | None = None,
    sensors: Mapping[str, Any] | None = None,
    look: Mapping[str, Any] | str | None = None,
    sample: Mapping[str, Any] | None = None,
) -> None:
    """Write effects.

    Args:
        path: The file.
        effects: The effects.
        names: See `EffectsFile`.
        units: By effect, as ``name`` or ``name target``, and parameter, for readers of
            the file.
        sensors: Entry on sensors; None: no entry.
        look: Entry on the look, or its name; None: no entry.
        sample: Entry on parameter sets; None: no entry.

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
        place = f"{effect.name} {effect.target}"
        found = (units or {}).get(place, (units or {}).get(effect.name, {}))
        if found:
            row["units"] = dict(found)
        rows.append(row)
    version = VERSION if sensors is None else WITH_SENSORS
    version = version if look is None and sample is None else NEWEST
    content = {"version": version, "effects": rows, "names": dict(names or {})}
    if sensors is not None:
        content["sensors"] = dict(sensors)
    if look is not None:
        content["look"] = look if isinstance(look, str) else dict(look)
    head = _HEAD
    if sample is not None:
        content["sample"] = dict(sample)
        head += _SAMPLE_HEAD
    text = yaml_text(content, default_flow_style=None)
    Path(path).write_text(head + text, "utf-8")


def read_effects(path: str | Path) -> EffectsFile:
    """Read effects; their fit to a model is checked when they are applied.

    Raises:
        DataError: If the file is missing, is not YAML, or has another form.
        UnknownNameError: If an effect is not in the library.
    """
    path = Path(path)
    content = read_yaml(
        path, advice="give an effects.yaml as the gap workflow writes it"
    )
    if not isinstance(content, dict) or not isinstance(content.get("effects"), list):
        raise DataError(
            f"effects file {str(path)!r} has no list named 'effects'; write one with "
            "name, target and parameters of each."
        )
    if content.get("version", VERSION) not in _VERSIONS:
        raise DataError(
            f"effects file {str(path)!r} has version {shown(content['version'])}; "
            f"versions {VERSION} to {NEWEST} are read, so let the gap workflow "
            "write it again."
        )
    for key in content:
        if key not in _TOP:
            raise DataError(
                f"effects file {str(path)!r} has an unknown entry {shown(key)}"
                f"{suggest(str(key), _TOP)}; known: {', '.join(_TOP)}."
            )
    names = content.get("names") or {}
    if not _is_text_map(names):
        raise DataError(
            f"names of effects file {str(path)!r} are {shown(names)}; give a map from "
            "names to names."
        )
    rows = tuple(_effect(path, i, row) for i, row in enumerate(content["effects"], 1))
    sensors = content.get("sensors")
    if sensors is not None and not isinstance(sensors, dict):
        raise DataError(
            f"sensors of effects file {str(path)!r} are {shown(sensors)}; give a map "
            "from names to numbers."
        )
    look = content.get("look")
    if look is not None and not isinstance(look, dict | str):
        raise DataError(
            f"the look of effects file {str(path)!r} is {shown(look)}; give the name "
            "of a look, or a map from names to values."
        )
    sample = content.get("sample")
    if sample is not None and not isinstance(sample, dict):
        raise DataError(
            f"the sample of effects file {str(path)!r} is {shown(sample)}; give a map "
            "with columns and rows."
        )
    return EffectsFile(rows, names, sensors, look, sample)


def _effect(path: Path, number: int, row: Any) -> AppliedEffect:
    place = f"effect {number} of {str(path)!r}"
    if not isinstance(row, dict) or not {"name", "parameters"} <= row.keys() <= _KEYS:
        raise DataError(
            f"{place} is {shown(row)}; give its name, target and parameters."
        )
    library_effect(str(row["name"]))
    target, parameters = row.get("target"), row["parameters"]
    if target is not None and not isinstance(target, str):
        raise DataError(
            f"{place} has the target {shown(target)}; give a name, or null."
        )
    if not isinstance(parameters, dict) or not all(map(is_number, parameters.values())):
        raise DataError(
            f"{place} has the parameters {shown(parameters)}; give numbers."
        )
    numbers = {str(k): float(v) for k, v in parameters.items()}
    return AppliedEffect(str(row["name"]), target, numbers)


def _is_text_map(value: Any) -> bool:
    return isinstance(value, dict) and all(
        isinstance(part, str) for pair in value.items() for part in pair
    )
