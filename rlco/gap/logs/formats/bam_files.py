"""BAM's JSON: one servo on a pendulum bench, one file per run (Rhoban's `bam`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from rlco.errors import DataError
from rlco.files import Fields, read_json, reading
from rlco.files.fields import is_number
from rlco.gap.logs.table import Column, Kind, Table

_KINDS: dict[str, Kind] = {
    "position": "position",
    "speed": "velocity",
    "goal_position": "command",
}


def read_bam(path: Path) -> list[Table]:
    """Read one run: ``entries`` of position, speed, goal_position and more.

    The bench's numbers (``mass``, ``arm_mass``, ``length``, ``kp``, ``vin``) are the
    recording's facts, its ``motor`` is the device; ``load``, ``input_volts``, ``temp``
    and ``torque_enable`` are its extra channels, the load with its sign.

    Raises:
        DataError: The file is not of that form, or an entry lacks what others have.
    """
    content = read_json(path)
    entries = content.groups("entries")
    if not entries:
        raise content.refuse("entries", "a list of entries as BAM's logs have")
    keys = [key for key, value in entries[0].content.items() if _is_number(value)]
    channels = {
        key: np.array([_number(entry, key) for entry in entries]) for key in keys
    }
    time = channels.pop("timestamp", None)
    if time is None or "position" not in channels:
        raise DataError(
            f"the entries of {str(path)!r} have no timestamp or no position; give one "
            "of BAM's logs."
        )
    notes = []
    if "load" in channels and channels["load"].max() > 32767:
        channels["load"] -= 65536.0 * (channels["load"] > 32767)
        notes.append("Loads were read as 16-bit numbers with a sign.")
    columns = tuple(
        (Column(_KINDS.get(key, "extra"), "" if key in _KINDS else key, key), values)
        for key, values in channels.items()
    )
    facts = {k: float(v) for k, v in content.content.items() if _is_number(v)}
    name = " ".join(filter(None, [path.stem, content.text("trajectory", None)]))
    device = content.text("motor", "")
    return [Table(name, time, columns, facts, tuple(notes), device)]


def is_bam(path: Path) -> bool:
    """Whether a JSON file has the form of BAM's logs."""
    # Its header is a few numbers; the entries are a megabyte.
    with reading(path), path.open("rb") as file:
        return b'"entries"' in file.read(4096)


def _number(entry: Fields, key: str) -> float:
    value = entry.content.get(key)
    return float(value) if isinstance(value, bool) else entry.number(key)


def _is_number(value: Any) -> bool:
    return isinstance(value, bool) or is_number(value)
