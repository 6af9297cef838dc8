"""A recipe's options: dataclass defaults, then a YAML file, then ``key=value``.

A recipe declares one dataclass whose fields are made by :func:`option`; nested
dataclasses become groups with dotted names. :func:`parse` lays the sources over
each other and reports every problem at once. Nothing here imports torch, so help
and wrong input answer at once.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf, SCMode
from omegaconf.errors import InterpolationResolutionError, OmegaConfBaseException

from rlco.errors import ConfigError, UnknownNameError
from rlco.files import shown, yaml_text
from rlco.runs.option_help import help_table
from rlco.runs.options import (
    AS_NOW,
    Option,
    options_of,
    unknown_option,
)
from rlco.runs.options import REQUIRED as REQUIRED
from rlco.runs.options import distinct as distinct
from rlco.runs.options import folder_name as folder_name
from rlco.runs.options import none_twice as none_twice
from rlco.runs.options import option as option
from rlco.runs.settings import (
    Setting,
    command_line,
    config_file,
    configs,
    read_settings,
)

#: NumPy's generators take 32 bits.
LAST_SEED = 2**32 - 1
_HELP = ("help", "--help", "-h")


@dataclass
class RunOptions:
    """The options that every recipe with a run directory shares; inherit from it."""

    name: str = option(
        "run", "name of the run, a part of its folder's name", check=folder_name
    )
    seed: int = option(0, "seed of every random number", minimum=0, maximum=LAST_SEED)
    threads: int = option(
        1,
        "threads that torch may use on the CPU",
        minimum=1,
        maximum=1024,
        may_change=True,
    )
    keep_checkpoints: int = option(
        2,
        "checkpoints that stay, the newest; each is as large as weights and optimiser",
        minimum=1,
        may_change=True,
    )
    out: str | None = option(
        None, "run directory; null: outputs/RECIPE/DATE_NAME_sSEED", may_change=True
    )
    resume: str | None = option(
        None, "run directory to continue with its own options", may_change=True
    )


def parse[C](config_class: type[C], argv: Sequence[str], recipe_path: str | Path) -> C:
    """Build a recipe's configuration from its command line.

    Args:
        config_class: The recipe's dataclass of options.
        argv: The arguments after the script's name: ``config=NAME|PATH`` (a YAML
            file that holds only differences, looked up in the folder named like
            the recipe and then beside it; what stands below ``KEY=VALUE:`` in it
            holds only where that option has that value), ``key=value`` with dots
            for groups, or ``help``, which prints the options and exits with status 0.
        recipe_path: The recipe's script.

    Returns:
        An instance of ``config_class``. With ``resume=DIR`` its values are those
        of that run, and only options declared with ``may_change`` may differ.

    Raises:
        ConfigError: Every problem found, together.

    Example:
        >>> @dataclass
        ... class Config(RunOptions):
        ...     lr: float = option(3e-4, "learning rate", minimum=0.0)
        >>> parse(Config, ["lr=1e-3", "seed=2"], "recipes/sft.py").lr
        0.001
        >>> parse(Config, ["learning=1", "seed=x"], "recipes/sft.py")
        Traceback (most recent call last):
        rlco.errors.ConfigError: unknown option 'learning'; 'help' lists them all; \
option seed: 'x' is not of type int.
    """
    recipe_path = Path(recipe_path)
    if any(argument in _HELP for argument in argv):
        sys.stdout.write(help_table(config_class, recipe_path, configs(recipe_path)))
        raise SystemExit(0)
    options = options_of(config_class)
    problems: list[str] = []
    given = command_line(argv, options, problems)
    base = _base_settings(given, options, recipe_path, problems)
    config: DictConfig = OmegaConf.structured(config_class)
    implied = [] if "resume" in given else _implied(options)
    lower = _holding([*implied, *(base or [])], given, options)
    _apply(config, lower, options, problems)
    saved = OmegaConf.create(config) if "resume" in given else None
    _apply(config, [s for s in given.values() if s.key != "config"], options, problems)
    if saved is not None and base:
        _check_unchanged(saved, config, given, options, problems)
    problems += [
        f"option {key} is required: {entry.help}"
        for key, entry in options.items()
        if OmegaConf.select(config, key, throw_on_resolution_failure=False) is None
        and entry.is_required
        and key not in given
        and base is not None
    ]
    if problems:
        raise ConfigError(problems)
    try:
        # The structure behind config_class has checked every type already.
        return cast(C, OmegaConf.to_object(config))
    except OmegaConfBaseException as error:
        raise ConfigError([str(error).splitlines()[0]]) from error


def to_plain(config: object) -> dict[str, Any]:
    """Return a configuration as nested plain dicts, lists, numbers and strings.

    Example:
        >>> to_plain(RunOptions(seed=3))["seed"]
        3
    """
    container = OmegaConf.to_container(
        OmegaConf.structured(config), structured_config_mode=SCMode.DICT
    )
    return cast(dict[str, Any], _plain(container))


def to_yaml(config: object, *, leave_out: Sequence[str] = ()) -> str:
    """Return a configuration as YAML that :func:`parse` reads back."""
    plain = {k: v for k, v in to_plain(config).items() if k not in leave_out}
    return yaml_text(plain, allow_unicode=True)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def _base_settings(
    given: Mapping[str, Setting],
    options: Mapping[str, Option],
    recipe_path: Path,
    problems: list[str],
) -> list[Setting] | None:
    """Read what lies below the command line: a YAML file, or the run to resume.

    None where it cannot be read, so that nothing it may hold is called missing.
    """
    resumes = "resume" in given and "resume" in options
    problems += [
        f"{other}= and resume= cannot be given together"
        for other in ("config", "out")
        if resumes and other in given
    ]
    try:
        if resumes:
            path = Path(given["resume"].value or "") / "config.yaml"
            if not path.is_file():
                problems.append(
                    f"resume={shown(given['resume'].value)} is not a run directory: it "
                    "has no config.yaml; give the folder of an earlier run"
                )
                return None
        elif "config" in given:
            path = config_file(str(given["config"].value), recipe_path)
        else:
            return []
    except UnknownNameError as error:
        problems.append(str(error).rstrip("."))
        return None
    settings = read_settings(path, options, problems)
    if settings is None or not resumes:
        return settings
    # What the run did before an option existed, it goes on to do.
    written = {setting.key for setting in settings}
    return settings + [
        Setting(key, entry.earlier, str(path))
        for key, entry in options.items()
        if key not in written and entry.earlier is not AS_NOW
    ]


def _implied(options: Mapping[str, Option]) -> list[Setting]:
    """Return the defaults that values of options imply for others."""
    return [
        Setting(key, default, when=(name, value))
        for name, entry in options.items()
        for value, defaults in entry.implies.items()
        for key, default in defaults.items()
    ]


def _holding(
    settings: Sequence[Setting],
    given: Mapping[str, Setting],
    options: Mapping[str, Option],
) -> list[Setting]:
    """Return the settings that hold, the later ones last.

    What an option's value implies lies below all that files say; what they say for one
    value of an option lies over what they say for all.
    """
    plain = [one for one in settings if one.when is None]
    chosen = {name: entry.default for name, entry in options.items()}
    chosen |= {one.key: one.value for one in [*plain, *given.values()]}
    some = [one for one in settings if one.when and chosen[one.when[0]] == one.when[1]]
    return [
        *(one for one in some if not one.source),
        *plain,
        *(one for one in some if one.source),
    ]


def _apply(
    config: DictConfig,
    settings: Sequence[Setting],
    options: Mapping[str, Option],
    problems: list[str],
) -> None:
    for setting in settings:
        key = setting.key
        if key not in options:
            problems.append(setting.problem(unknown_option(key, options)))
            continue
        complaint = options[key].complaint(setting.value) or _outside(setting.value)
        if complaint is None:
            try:
                OmegaConf.update(config, key, setting.value)
                complaint = options[key].out_of_range(OmegaConf.select(config, key))
            except InterpolationResolutionError:
                complaint = (
                    f"{shown(setting.value)} refers to an option that is not set"
                )
            except (OmegaConfBaseException, OverflowError):  # an int for a float
                complaint = (
                    f"{shown(setting.value)} is not of type {options[key].type_name}"
                )
        if complaint is not None:
            problems.append(setting.problem(f"option {key}: {complaint}"))


def _outside(value: Any) -> str | None:
    """Say where a value asks for what lies outside of the options, such as a secret.

    ``${lr}`` is another option; ``${oc.env:KEY}`` would be written to config.yaml.
    """
    if isinstance(value, Mapping):
        return next(filter(None, map(_outside, value.values())), None)
    if isinstance(value, list | tuple):
        return next(filter(None, map(_outside, value)), None)
    if isinstance(value, str) and re.search(r"\$\{.*:", value, re.DOTALL):
        return (
            f"{shown(value)} asks for more than another option, and nothing else is "
            "filled in; write the value itself"
        )
    return None


def _check_unchanged(
    saved: DictConfig,
    config: DictConfig,
    given: Mapping[str, Setting],
    options: Mapping[str, Option],
    problems: list[str],
) -> None:
    for key in given:
        # A file may be elsewhere by now: `check_unchanged` decides by its content.
        if key not in options or options[key].may_change or options[key].input:
            continue
        before, now = OmegaConf.select(saved, key), OmegaConf.select(config, key)
        if before != now:
            problems.append(
                f"option {key} cannot change on resume: the run has {shown(before)}, "
                f"given was {shown(now)}"
            )
