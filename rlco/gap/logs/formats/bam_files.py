"""BAM's JSON: one servo on a pendulum bench, one file per run (Rhoban's `bam`)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from rlco.errors import DataError
from rlco.gap.logs.log import Array
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
    content = _content(path)
    entries: list[dict[str, Any]] = content["entries"]
    keys = [key for key, value in entries[0].items() if isinstance(value, (int, float))]
    channels = {key: _channel(path, entries, key) for key in keys}
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
    facts = {k: float(v) for k, v in content.items() if isinstance(v, (int, float))}
    name = " ".join([path.stem, *filter(None, [str(content.get("trajectory") or "")])])
    device = str(content.get("motor") or "")
    return [Table(name, time, columns, facts, tuple(notes), device)]


def is_bam(path: Path) -> bool:
    """Whether a JSON file has the form of BAM's logs."""
    with path.open() as file:
        # Its header is a few numbers; the entries are a megabyte.
        return '"entries"' in file.read(4096)


def _content(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text())
    except ValueError as error:
        raise DataError(f"file {str(path)!r} is not valid JSON ({error}).") from None
    entries = content.get("entries") if isinstance(content, dict) else None
    if not isinstance(entries, list) or not entries or not isinstance(entries[0], dict):
        raise DataError(
            f"file {str(path)!r} has no list of entries as BAM's logs have."
        )
    return dict(content)


def _channel(path: Path, entries: list[dict[str, Any]], key: str) -> Array:
    for row, entry in enumerate(entries):
        if not isinstance(entry.get(key), (int, float)):
            raise DataError(
                f"entry {row + 1} of {str(path)!r} has no number {key!r}; correct or "
                "delete that entry."
            )
    return np.array([entry[key] for entry in entries], dtype=float)
