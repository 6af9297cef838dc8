"""One option of a recipe: its declaration and its checks."""

from __future__ import annotations

import dataclasses
import math
import os
import sys
import types
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING as NO_DEFAULT
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Union, cast, get_args, get_origin, get_type_hints

from omegaconf import MISSING, OmegaConf

from rlco.errors import ConfigError, suggest
from rlco.files import shown

#: The default of an option that somebody must give.
REQUIRED: str = MISSING
_LONGEST_NAME = 100
#: Defaults of other options, by the value of one.
type Implied = Mapping[Any, Mapping[str, Any]]
#: What NumPy and torch count with takes 64 bits.
_LARGEST = 2**63 - 1
#: Where an earlier run's value of an option is the default of today.
AS_NOW: Any = object()


def rename_map(text: str) -> dict[str, str]:
    """Read ``THEIRS:OURS,THEIRS:OURS``; what is theirs may hold colons.

    Raises:
        ConfigError: The text has another form.

    Example:
        >>> rename_map("state:observation.state,actions:action")
        {'state': 'observation.state', 'actions': 'action'}
    """
    pairs = [pair.rpartition(":") for pair in text.split(",") if pair]
    if not all(theirs and ours for theirs, _, ours in pairs):
        raise ConfigError([f"rename={shown(text)} is not THEIRS:OURS,THEIRS:OURS"])
    return {theirs: ours for theirs, _, ours in pairs}


def scale_map(text: str) -> dict[str, float]:
    """Read ``THEIRS:NUMBER,THEIRS:NUMBER``; what is theirs may hold colons.

    Raises:
        ConfigError: The text has another form.

    Example:
        >>> scale_map("actual_current_0:12.5,actual_current_1:9.1")
        {'actual_current_0': 12.5, 'actual_current_1': 9.1}
    """
    pairs = [pair.rpartition(":") for pair in text.split(",") if pair]
    try:
        found = {theirs: float(number) for theirs, _, number in pairs}
    except ValueError:
        found = {"": 0.0}
    if "" in found:
        raise ConfigError([f"scale={shown(text)} is not THEIRS:NUMBER,THEIRS:NUMBER"])
    return found


def folder_name(text: str) -> str | None:
    """Say why a text cannot be a part of a folder's name; None where it can.

    Example:
        >>> folder_name("rl_co beta=0.2"), folder_name("../../x")
        (None, "'../../x' is to be a part of a folder's name: at most 100 letters, \
digits and marks, no /")
    """
    if 0 < len(text) <= _LONGEST_NAME and text.isprintable() and "/" not in text:
        return None
    return (
        f"{shown(text)} is to be a part of a folder's name: at most {_LONGEST_NAME} "
        "letters, digits and marks, no /"
    )


def distinct(values: Any) -> str | None:
    """Say why a list is none of distinct values, at least one; None where it is.

    Example:
        >>> distinct(["sft"]), distinct([]), distinct(["sft", "sft"])
        (None, '[] is empty; give one or more', "['sft', 'sft'] has one of them twice")
    """
    return none_twice(values) if values else "[] is empty; give one or more"


def none_twice(values: Any) -> str | None:
    """Say that a list has a value twice; None where it has none.

    Example:
        >>> none_twice([]), none_twice(["sim", "sim"])
        (None, "['sim', 'sim'] has one of them twice")
    """
    if len(set(values)) < len(values):
        return f"{shown(list(values))} has one of them twice"
    return None


def from_home(value: Any) -> Any:
    """Return a path, or a list of them, with a leading ``~/`` as the home directory.

    Not every shell does it behind ``key=``, and none in a file of options.

    Example:
        >>> from_home("~/demos") == str(Path.home() / "demos"), from_home("a~/b")
        (True, 'a~/b')
    """
    if isinstance(value, list):
        return [from_home(item) for item in value]
    if isinstance(value, str) and value.startswith("~/"):
        return os.path.expanduser(value)
    return value


def option(
    default: Any,
    help: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    infinite: bool = False,
    may_change: bool = False,
    earlier: Any = AS_NOW,
    input: Literal["file", "folder"] | None = None,
    check: Callable[[Any], str | None] | None = None,
    implies: Implied | None = None,
) -> Any:
    """Declare one option as a dataclass field.

    Args:
        default: Its value where nobody gives one; ``REQUIRED`` where somebody must.
            A list or dict is copied for every configuration.
        help: What it means, with its unit in brackets.
        minimum: Least value allowed (of each number in a list).
        maximum: Greatest value allowed.
        infinite: Whether infinity means something; otherwise it is refused, as NaN is.
        may_change: Whether a resumed run may have another value.
        earlier: Its value where a run is resumed that was started before the option
            existed; where none is given, the default.
        input: Whether it names files, or folders, that a run reads: a resumed run must
            find them as they were.
        check: Says what is wrong with a value, None where nothing is.
        implies: By a value of this option, what other options then default to.

    Example:
        >>> @dataclass
        ... class Config:
        ...     lr: float = option(3e-4, "learning rate", minimum=0.0)
        >>> Config().lr
        0.0003
    """
    metadata = {
        "help": help,
        "minimum": minimum,
        "maximum": maximum,
        "infinite": infinite,
        "may_change": may_change,
        "earlier": earlier,
        "input": input,
        "check": check,
        "implies": implies or {},
    }
    if isinstance(default, list | dict):
        return field(default_factory=default.copy, metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Option:
    """An option as declared: its dotted name, its type and its limits."""

    key: str
    hint: Any
    default: Any
    help: str = ""
    minimum: float | None = None
    maximum: float | None = None
    infinite: bool = False
    may_change: bool = False
    earlier: Any = AS_NOW
    input: Literal["file", "folder"] | None = None
    check: Callable[[Any], str | None] | None = None
    implies: Implied = field(default_factory=dict)

    @property
    def type_name(self) -> str:
        """The type as a user would write it: ``int``, ``str | None``, ``'a' | 'b'``.

        Example:
            >>> Option("reward", Literal["shaped", "sparse"], "shaped").type_name
            "'shaped' | 'sparse'"
        """
        return " | ".join(_type_name(member) for member in _members(self.hint))

    @property
    def is_required(self) -> bool:
        """Whether somebody must give a value."""
        return bool(self.default == REQUIRED)

    @property
    def may_nest(self) -> bool:
        """Whether what a list of it holds may be lists or mappings themselves."""
        held = (part for member in _members(self.hint) for part in get_args(member))
        return any(get_origin(part) is not None for part in held)

    def from_text(self, text: str) -> Any:
        """Read the text behind ``key=``: as it is for text, as YAML for the rest.

        Raises:
            yaml.YAMLError: The text of a number, flag or list is no YAML.
            ValueError: It is a number of thousands of digits.

        Example:
            >>> Option("out", str | None, None).from_text("007")
            '007'
            >>> Option("lr", float, 1.0).from_text("1e-3")
            0.001
        """
        members = _members(self.hint)
        if text in ("null", "~") and type(None) in members:
            return None
        if any(isinstance(c, str) for c in _choices(self.hint)) or any(
            member in (str, Path) for member in members
        ):
            return text
        # OmegaConf's own reading of YAML, for which 1e-3 is a number.
        read = OmegaConf.to_container(OmegaConf.from_dotlist([f"value={text}"]))
        return cast(dict[str, Any], read)["value"]

    def complaint(self, value: Any) -> str | None:
        """Say what is wrong with a value that the type alone would let through."""
        if value == REQUIRED:
            return "a value is missing"
        if isinstance(value, str) and "\0" in value:
            return f"{shown(value)} holds a NUL, which no name of a file may"
        choices = _choices(self.hint)
        if choices and value not in choices and value is not None:
            allowed = ", ".join(repr(choice) for choice in choices)
            near = suggest(str(value), [str(choice) for choice in choices])
            return f"{shown(value)} is not one of {allowed}{near}"
        # OmegaConf takes any number for a flag; 2 is more likely a mistake.
        if bool in _members(self.hint) and isinstance(value, int | float):
            return (
                None
                if isinstance(value, bool)
                else f"{shown(value)} is not of type bool"
            )
        return None

    def out_of_range(self, value: Any) -> str | None:
        """Say which limit a value, or a number in a list, breaks; its type is right."""
        if value is None:
            return None
        listed = isinstance(value, Iterable) and not isinstance(value, str)
        # OmegaConf looks at no more than that a list in a list is one.
        if listed and any(map(OmegaConf.is_config, value)) and not self.may_nest:
            return f"{shown(list(value))} is not of type {self.type_name}"
        if self.check is not None and (complaint := self.check(value)):
            return complaint
        return self._broken_limit(value)

    def _broken_limit(self, value: Any) -> str | None:
        if isinstance(value, Iterable) and not isinstance(value, str):
            return next(filter(None, map(self._broken_limit, value)), None)
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
        if math.isnan(value):
            return "nan is not a number"
        if math.isinf(value) and not self.infinite:
            return f"{shown(value)} is not a finite number"
        if self.minimum is not None and value < self.minimum:
            return f"{shown(value)} is below the least allowed, {self.minimum!r}"
        if self.maximum is not None and value > self.maximum:
            return f"{shown(value)} is above the greatest allowed, {self.maximum!r}"
        if isinstance(value, int) and abs(value) > _LARGEST:
            return f"{shown(value)} is beyond the largest number allowed, {_LARGEST}"
        return None


def options_of(config_class: type, prefix: str = "") -> dict[str, Option]:
    """List a dataclass's options by dotted name, groups resolved, in their order.

    Example:
        >>> @dataclass
        ... class Config:
        ...     lr: float = option(3e-4, "learning rate")
        >>> list(options_of(Config))
        ['lr']
    """
    hints = get_type_hints(config_class)
    found: dict[str, Option] = {}
    for entry in dataclasses.fields(config_class):
        key, hint = f"{prefix}{entry.name}", hints[entry.name]
        if dataclasses.is_dataclass(hint) and isinstance(hint, type):
            found |= options_of(hint, f"{key}.")
            continue
        default = entry.default
        if default is NO_DEFAULT:
            factory = entry.default_factory
            default = REQUIRED if factory is NO_DEFAULT else factory()
        found[key] = Option(key, hint, default, **entry.metadata)
    return found


def unknown_option(key: str, options: Mapping[str, Option]) -> str:
    """Say that no option has this name, and which was probably meant."""
    members = [name for name in options if name.startswith(f"{key}.")]
    if members:
        return f"option {key} is a group; give one of {', '.join(members)}"
    near = suggest(key, [*options, "config"])
    # A group's option that was given without its group's name.
    inner = [name for name in options if name.rpartition(".")[2] == key]
    if inner and not near:
        near = f" (did you mean {inner[0]!r}?)"
    return f"unknown option {shown(key)}{near}; 'help' lists them all"


def started_by_rlco() -> bool:
    """Return whether this process is the command `rlco` of an installed package."""
    return Path(sys.argv[0]).name == "rlco"


def _members(hint: Any) -> tuple[Any, ...]:
    """The alternatives of a union; a type alone is its own only alternative."""
    return get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)


def _choices(hint: Any) -> list[Any]:
    members = _members(hint)
    return [c for m in members if get_origin(m) is Literal for c in get_args(m)]


def _type_name(hint: Any) -> str:
    if get_origin(hint) is Literal:
        return " | ".join(repr(choice) for choice in get_args(hint))
    if hint is type(None):
        return "null"
    return hint.__name__ if get_origin(hint) is None else str(hint)
