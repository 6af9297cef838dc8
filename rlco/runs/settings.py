"""Settings as users write them: on the command line, and in files of options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import yaml

from rlco.errors import DataError, UnknownNameError
from rlco.files import read_yaml, shown
from rlco.runs.options import Option, from_home


@dataclass(frozen=True)
class Setting:
    """One value given by the user, and the file it stands in ("": command line).

    With ``when`` it holds only where that option has that value.
    """

    key: str
    value: Any
    source: str = ""
    when: tuple[str, Any] | None = None

    def problem(self, text: str) -> str:
        """Return what is wrong with it, with its file."""
        return f"in {self.source}: {text}" if self.source else text


def command_line(
    argv: Sequence[str], options: Mapping[str, Option], problems: list[str]
) -> dict[str, Setting]:
    """Split ``key=value`` arguments; each key may come once.

    What is wrong is added to `problems`.
    """
    given: dict[str, Setting] = {}
    for argument in argv:
        key, equals, text = argument.partition("=")
        if not equals or not key or key.startswith("-"):
            hint = f"; write {argument.lstrip('-')}" if "=" in argument[1:] else ""
            problems.append(f"argument {shown(argument)} is not key=value{hint}")
            continue
        if key in given:
            problems.append(f"option {key} is given twice")
            continue
        value: Any = text
        if key in options:
            try:
                value = options[key].from_text(text)
            except (yaml.YAMLError, ValueError):
                problems.append(f"option {key}: {shown(text)} is not a YAML value")
                continue
        given[key] = Setting(key, from_home(value))
    return given


def configs(recipe_path: Path) -> dict[str, Path]:
    """Return named configurations: in the recipe's own folder first, then beside it."""
    folders = (recipe_path.parent, recipe_path.with_suffix(""))
    return {path.stem: path for f in folders for path in sorted(f.glob("*.yaml"))}


def config_file(given: str, recipe_path: Path) -> Path:
    """Return the file of a configuration, given as its path or its name.

    Raises:
        UnknownNameError: There is none.
    """
    if Path(given).suffix in (".yaml", ".yml") and Path(given).is_file():
        return Path(given)
    known = configs(recipe_path)
    if given not in known:
        raise UnknownNameError("config", given, sorted(known) or ["PATH of a .yaml"])
    return known[given]


def read_settings(
    path: Path, options: Mapping[str, Option], problems: list[str]
) -> list[Setting] | None:
    """Return the settings of a file of options; None where it holds none.

    What is wrong is added to `problems`.
    """
    try:
        content = read_yaml(path, advice="give a YAML file of options")
    except DataError as error:
        problems.append(str(error).rstrip("."))
        return None
    if not isinstance(content, dict):
        problems.append(f"{path} must hold key: value lines")
        return None
    try:
        settings = _flatten(content, options, str(path))
    except (yaml.YAMLError, ValueError) as error:
        problems.append(
            f"in {path}: a value before a group is no YAML: {shown(str(error))}"
        )
        return None
    # A value may be a list, which a set cannot hold.
    keys = [(setting.key, repr(setting.when)) for setting in settings]
    problems += [
        f"in {path}: option {key[0]} is given twice"
        for key in dict.fromkeys(keys)
        if keys.count(key) > 1
    ]
    values = {repr(one.when): one.when for one in settings if one.when}
    for name, value in values.values():
        if complaint := options[name].complaint(value):
            problems.append(f"in {path}: option {name}: {complaint}")
    return settings


def _flatten(
    content: Mapping[Any, Any],
    options: Mapping[str, Option],
    source: str,
    prefix: str = "",
) -> list[Setting]:
    settings = []
    for name, value in content.items():
        key = f"{prefix}{name}"
        option, equals, text = key.partition("=")
        # A dict-valued option is a leaf; every other mapping is a group, or is for one
        # value of an option.
        if isinstance(value, Mapping) and equals and option in options:
            when = (option, options[option].from_text(text))
            settings += [
                replace(one, when=when) for one in _flatten(value, options, source)
            ]
        elif isinstance(value, Mapping) and key not in options:
            settings += _flatten(value, options, source, f"{key}.")
        else:
            settings.append(Setting(key, from_home(value), source))
    return settings
