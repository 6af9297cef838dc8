"""Looks as names and numbers, as domain files hold them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

from rlco.errors import DataError, RlcoError, suggest
from rlco.files import shown
from rlco.files.fields import is_number
from rlco.physics.spec.look import Light, Look, Surface, View

Reader = Callable[[Any, str], Any]


def look_of(content: Any, place: str) -> Look:
    """Return a look from names and numbers, as in a file.

    Args:
        content: A map; what is left out is as in ``sim``.
        place: Its location, for error messages.

    Raises:
        DataError: If a name is unknown, or a value is of another kind or out of range.

    Example:
        >>> look_of({"surfaces": {"table": {"texture": "dark-wood"}}}, "here").surfaces
        {'table': Surface(texture='dark-wood', colour=(1.0, 1.0, 1.0), \
saturation=1.0, gloss=None)}
    """
    look: Look = _record(Look, content, place)
    return look


def content_of_look(look: Look) -> dict[str, Any]:
    """Return a look as names and numbers, the inverse of `look_of`."""
    return _content(look)


def _content(record: Any) -> dict[str, Any]:
    """Return what of a record is not as in ``sim``."""
    plain = type(record)()
    return {
        one.name: _plain(getattr(record, one.name))
        for one in fields(record)
        if getattr(record, one.name) != getattr(plain, one.name)
    }


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _content(part) for name, part in value.items()}
    if isinstance(value, tuple):
        return [_plain(part) for part in value]
    return _content(value) if isinstance(value, Light) else value


def _record(kind: Any, content: Any, place: str) -> Any:
    """Return a record of a kind, its fields read by `_READERS`."""
    if not isinstance(content, Mapping):
        raise DataError(
            f"{place} is {shown(content)}; give a map from names to values."
        )
    known = [one.name for one in fields(kind)]
    found = {}
    for name, value in content.items():
        if name not in known:
            raise DataError(
                f"unknown entry {shown(name)} in {place}{suggest(str(name), known)}; "
                f"known: {', '.join(known)}."
            )
        found[name] = _READERS[kind, name](value, f"{name} in {place}")
    try:
        return kind(**found)
    except DataError:
        raise
    except RlcoError as error:  # a number out of range
        raise DataError(f"{place}: {error}") from None


def _number(value: Any, place: str) -> float:
    if not is_number(value):
        raise DataError(f"{place} is {shown(value)}; give a number.")
    return float(value)


def _numbers(count: int) -> Reader:
    def read(value: Any, place: str) -> tuple[float, ...]:
        if not (
            isinstance(value, list | tuple)
            and len(value) == count
            and all(map(is_number, value))
        ):
            raise DataError(f"{place} is {shown(value)}; give {count} numbers.")
        return tuple(map(float, value))

    return read


def _text(value: Any, place: str) -> str:
    if not isinstance(value, str):
        raise DataError(f"{place} is {shown(value)}; give a name.")
    return value


def _or_null(reader: Reader) -> Reader:
    return lambda value, place: None if value is None else reader(value, place)


def _map(kind: Any) -> Reader:
    def read(value: Any, place: str) -> dict[str, Any]:
        if not isinstance(value, Mapping):
            raise DataError(f"{place} is {shown(value)}; give a map from names.")
        return {
            _text(name, f"a name in {place}"): _record(kind, part, f"{name} of {place}")
            for name, part in value.items()
        }

    return read


def _lights(value: Any, place: str) -> tuple[Light, ...]:
    if not isinstance(value, list | tuple):
        raise DataError(f"{place} is {shown(value)}; give a list of lights.")
    return tuple(
        _record(Light, part, f"light {number} of {place}")
        for number, part in enumerate(value, 1)
    )


def _light(value: Any, place: str) -> Any:
    return _record(Light, value, place)


_READERS: dict[tuple[Any, str], Reader] = {
    (Surface, "texture"): _or_null(_text),
    (Surface, "colour"): _numbers(3),
    (Surface, "saturation"): _number,
    (Surface, "gloss"): _or_null(_number),
    (Light, "direction"): _numbers(3),
    (Light, "position"): _or_null(_numbers(3)),
    (Light, "ambient"): _numbers(3),
    (Light, "diffuse"): _numbers(3),
    (Light, "specular"): _numbers(3),
    (View, "shift"): _numbers(3),
    (View, "turn"): _numbers(3),
    (View, "field_of_view"): _or_null(_number),
    (View, "crop"): _number,
    (View, "sensor_shift"): _numbers(2),
    (Look, "surfaces"): _map(Surface),
    (Look, "lights"): _or_null(_lights),
    (Look, "headlight"): _or_null(_light),
    (Look, "cameras"): _map(View),
    (Look, "exposure"): _number,
    (Look, "white_balance"): _numbers(2),
    (Look, "vignette"): _number,
    (Look, "blur"): _number,
    (Look, "noise"): _number,
}
