"""Errors of a robot's sensors and camera, as data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from rlco.errors import DataError, suggest
from rlco.files import shown


@dataclass(frozen=True)
class Sensors:
    """Errors of observations; those left out are as in the simulator ``sim``.

    Attributes:
        camera_yaw: Rotation, about the table's centre, of the frame in which object
            positions are reported [rad].
        camera_shift: Shift of that frame along the base's x and y [m].
        object_noise: Standard deviation of reported object positions [m]. Simulated
            cameras have noise too, because a perfect one would be unfair to every
            method.
        state_noise: Standard deviation of the reported tool position [m].
        tool_offset: Error of the reported tool height: the mounted fingertip is
            longer than the modelled one [m].
        gripper_offset: Error of the reported gripper opening [m].

    Example:
        >>> Sensors(camera_yaw=0.1).object_noise
        0.001
    """

    camera_yaw: float = 0.0
    camera_shift: tuple[float, float] = (0.0, 0.0)
    object_noise: float = 0.001
    state_noise: float = 0.0
    tool_offset: float = 0.0
    gripper_offset: float = 0.0


def sensors_of(content: Mapping[str, Any], place: str) -> Sensors:
    """Return sensors from names and numbers, as in a file.

    Args:
        content: The numbers; those left out are as in ``sim``.
        place: Their location, for error messages.

    Raises:
        DataError: If a name is unknown, or a value is not a number.

    Example:
        >>> sensors_of({"camera_shift": [0.02, 0]}, "here").camera_shift
        (0.02, 0.0)
    """
    known = [field.name for field in fields(Sensors)]
    found: dict[str, Any] = {}
    for name, value in content.items():
        if name not in known:
            raise DataError(
                f"unknown sensor error {shown(name)} in {place}"
                f"{suggest(str(name), known)}; known: {', '.join(known)}."
            )
        pair = name == "camera_shift"
        numbers = value if pair else [value]
        if not (isinstance(numbers, list | tuple) and all(map(_is_number, numbers))):
            numbers = []
        if len(numbers) != 1 + pair:
            wanted = "two numbers, x and y" if pair else "a number"
            raise DataError(f"{name} in {place} is {shown(value)}; give {wanted}.")
        if name.endswith("_noise") and numbers[0] < 0.0:
            raise DataError(f"{name} in {place} is {shown(value)}; give 0 or more.")
        floats = tuple(float(number) for number in numbers)
        found[name] = floats if pair else floats[0]
    return Sensors(**found)


def content_of(sensors: Sensors) -> dict[str, Any]:
    """Return sensors as names and numbers, the inverse of `sensors_of`."""
    rows: dict[str, Any] = {f.name: getattr(sensors, f.name) for f in fields(Sensors)}
    return {**rows, "camera_shift": list(sensors.camera_shift)}


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return math.isfinite(value)
