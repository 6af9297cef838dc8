"""Fields of JSON, YAML and parquet rows by their types: each one checked when taken."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

from rlco.errors import DataError, RlcoError
from rlco.files.reading import shown

_REQUIRED: Any = object()


@dataclass(frozen=True)
class Fields:
    """A mapping that was read from a file; each method takes one field of it.

    A field that is missing or null has the default, where one is given.

    Attributes:
        content: The mapping.
        place: Where it stands, for messages: ``file 'meta/info.json'``.
        error: What is raised.
        advice: What to do about a field that is not as expected.

    Raises:
        RlcoError: Of the class `error`, if the content is no mapping.

    Example:
        >>> info = Fields({"fps": 20, "name": "arm"}, "file 'info.json'")
        >>> info.number("fps"), info.text("name"), info.integer("episodes", 0)
        (20.0, 'arm', 0)
        >>> info.number("name")
        Traceback (most recent call last):
        ...
        rlco.errors.DataError: 'name' of file 'info.json' is 'arm', not a number; \
correct it, or copy the file again.
    """

    content: Mapping[str, Any]
    place: str
    error: type[RlcoError] = DataError
    advice: str = "correct it, or copy the file again"

    def __post_init__(self) -> None:
        if not isinstance(self.content, Mapping):
            raise self.error(
                f"{self.place} holds {shown(self.content)}, not names with values; "
                f"{self.advice}."
            )

    def text[T](self, key: str, default: T = _REQUIRED) -> str | T:
        """Return a text."""
        found: str | T
        found = self._take(key, default, lambda v: isinstance(v, str), "a text")
        return found

    def number[T](
        self,
        key: str,
        default: T = _REQUIRED,
        *,
        above: float = -math.inf,
        up_to: float = math.inf,
    ) -> float | T:
        """Return a finite number, larger than `above` and at most `up_to`."""

        def fits(value: Any) -> bool:
            return is_number(value) and above < value <= up_to

        wanted = "a number" + _limits(above, up_to, "above")
        value = self._take(key, default, fits, wanted)
        return float(value) if is_number(value) else value

    def integer[T](
        self,
        key: str,
        default: T = _REQUIRED,
        *,
        minimum: float = -math.inf,
        maximum: float = 2**62,
    ) -> int | T:
        """Return a whole number within limits."""

        def fits(value: Any) -> bool:
            whole = is_number(value) and float(value).is_integer()
            return whole and minimum <= value <= maximum

        wanted = "a whole number" + _limits(minimum, maximum, "of at least")
        value = self._take(key, default, fits, wanted)
        return int(value) if is_number(value) else value

    def flag[T](self, key: str, default: T = _REQUIRED) -> bool | T:
        """Return true or false."""
        found: bool | T
        found = self._take(key, default, lambda v: isinstance(v, bool), "true or false")
        return found

    def sequence[T](self, key: str, default: T = _REQUIRED) -> list[Any] | T:
        """Return a list, of whatever."""
        found: list[Any] | T
        found = self._take(key, default, lambda v: isinstance(v, list), "a list")
        return found

    def mapping[T](self, key: str, default: T = _REQUIRED) -> dict[str, Any] | T:
        """Return names with values, of whatever."""

        def fits(value: Any) -> bool:
            return isinstance(value, dict) and all(isinstance(k, str) for k in value)

        found: dict[str, Any] | T
        found = self._take(key, default, fits, "names with values")
        return found

    def group(self, key: str) -> Self:
        """Return the fields of a mapping in this one; it may be missing."""
        return self._inner(self.mapping(key, {}), f"{key!r} of {self.place}")

    def groups(self, key: str) -> list[Self]:
        """Return the fields of each mapping in a list."""
        return [
            self._inner(entry, f"entry {number} of {key!r} of {self.place}")
            for number, entry in enumerate(self.sequence(key), 1)
        ]

    def refuse(self, key: str, wanted: str) -> RlcoError:
        """Return the error for a field that is not what is wanted, to be raised."""
        return self.error(
            f"{key!r} of {self.place} is {shown(self.content.get(key))}, not {wanted}; "
            f"{self.advice}."
        )

    def _inner(self, content: Any, place: str) -> Self:
        return type(self)(content, place, self.error, self.advice)

    def _take(
        self, key: str, default: Any, fits: Callable[[Any], bool], wanted: str
    ) -> Any:
        value = self.content.get(key)
        if value is None and default is not _REQUIRED:
            return default
        if key not in self.content:
            raise self.error(f"{self.place} lacks {key!r}; {self.advice}.")
        if not fits(value):
            raise self.refuse(key, wanted)
        return value


def is_number(value: Any) -> bool:
    """Return whether a value is a finite number that a float can hold, and no flag.

    Example:
        >>> is_number(2), is_number(True), is_number(10**400), is_number("2")
        (True, False, False, False)
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _limits(low: float, high: float, word: str) -> str:
    parts = [f"{word} {low:g}"] if math.isfinite(low) else []
    parts += [f"at most {high:g}"] if high < 2**62 else []
    return f" {' and '.join(parts)}" if parts else ""
