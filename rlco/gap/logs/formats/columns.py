"""Named columns of a CSV or NPZ file made into tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from rlco.errors import DataError
from rlco.files import few
from rlco.gap.logs.formats.headers import (
    EPISODE,
    POSE,
    parse_header,
    parse_pose,
    parse_time,
)
from rlco.gap.logs.log import Array
from rlco.gap.logs.table import Column, Table, require_finite
from rlco.gap.model import LoadedModel

#: Columns that only count rows.
_COUNTERS = ("index", "frame", "frame_index", "row", "task_index", "seq", "")


def tables_of(
    name: str,
    columns: Mapping[str, Array],
    model: LoadedModel | None,
    *,
    period: float | None = None,
    facts: Mapping[str, float] | None = None,
    lengths: Sequence[int] | None = None,
    notes: Sequence[str] = (),
) -> list[Table]:
    """Return the recordings that a file's columns hold.

    Args:
        name: The file's name.
        columns: Values by header, (T,) each.
        model: Whose joints may be headers; None for none.
        period: Seconds a row, where no column is a time.
        facts: Numbers that hold for the whole file.
        lengths: Rows of each recording in it; None for a column such as ``episode``,
            or one recording.
        notes: What was noticed so far.

    Raises:
        DataError: No column is a time and there is no period, or lengths that do not
            add up.
    """
    meanings = {header: _meaning(header, model) for header in columns}
    pose = _pose_columns(columns, model)
    time, times = _time(name, columns, period)
    split = [h for h in columns if h.lower() in EPISODE]
    aside = {*times, *split, *(h for h in columns if h.lower() in _COUNTERS)}
    whole = [
        (pose.get(header, meanings[header]), values)
        for header, values in columns.items()
        if header not in aside
    ]
    parts = _parts(name, columns[split[0]] if split else None, lengths, len(time))
    return [
        Table(
            name=name if len(parts) == 1 else f"{name} {label}",
            time=_clock(time[rows], period if not times else None),
            columns=tuple((column, values[rows]) for column, values in whole),
            facts=dict(facts or {}),
            notes=tuple(notes),
        )
        for label, rows in parts
    ]


def _meaning(header: str, model: LoadedModel | None) -> Column:
    if model is None:
        return parse_header(header)
    return parse_header(header, model.joints, model.actuators)


def _pose_columns(
    columns: Mapping[str, Array], model: LoadedModel | None
) -> dict[str, Column]:
    """Return the columns of one body's pose, where all seven axes are there.

    A model without a free body has no use for one: a tool's pose is kept aside.
    """
    if model is not None and not model.free_bodies:
        return {}
    bodies: dict[str, dict[str, str]] = {}
    for header in columns:
        found = parse_pose(header)
        if found is not None:
            bodies.setdefault(found[0], {})[found[1]] = header
    whole = {body: axes for body, axes in bodies.items() if set(axes) >= set(POSE)}
    wanted = () if model is None else model.free_bodies
    for body, axes in sorted(whole.items(), key=lambda item: item[0] not in wanted):
        if len(whole) == 1 or body in wanted:
            return {axes[a]: Column("pose", a, axes[a]) for a in POSE}
    return {}


def _time(
    name: str, columns: Mapping[str, Array], period: float | None
) -> tuple[Array, list[str]]:
    units = {h: unit for h in columns if (unit := parse_time(h)) is not None}
    lower = {header.lower(): header for header in columns}
    if "sec" in lower and "nanosec" in lower:
        pair = [lower["sec"], lower["nanosec"]]
        whole, rest = (columns[header] for header in pair)
        return np.asarray(whole - whole[0] + 1e-9 * rest, dtype=float), pair
    if units:
        first = next(iter(units))
        require_finite(repr(name), first, columns[first], None)
        return _seconds(name, first, columns[first], units[first]), list(units)
    rows = len(next(iter(columns.values())))
    if period is None:
        raise DataError(
            f"{name!r} has no column of times: name one of {few(list(columns))} "
            "'time', in seconds, or 'time_ms'."
        )
    return np.arange(rows, dtype=float) * period, []


def _seconds(name: str, header: str, values: Array, unit: float) -> Array:
    # Epoch nanoseconds keep no microseconds as seconds: count from the first row.
    time: Array = (values - values[0]) * unit
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    if step >= 1.0:
        raise DataError(
            f"column {header!r} of {name!r} rises by {step:g} per row, and seconds are "
            "expected: name it 'time_ms', 'time_us' or 'time_ns' if it counts those."
        )
    return time


def _clock(time: Array, period: float | None) -> Array:
    return time if period is None else np.arange(len(time), dtype=float) * period


def _parts(
    name: str, marks: Array | None, lengths: Sequence[int] | None, rows: int
) -> list[tuple[str, slice]]:
    if lengths is not None:
        if sum(lengths) != rows:
            raise DataError(
                f"the lengths in {name!r} add up to {sum(lengths)} rows, and it has "
                f"{rows}."
            )
        ends = np.cumsum(lengths)
        return [
            (f"part {i + 1}", slice(int(end) - int(n), int(end)))
            for i, (end, n) in enumerate(zip(ends, lengths, strict=True))
        ]
    if marks is None:
        return [("", slice(0, rows))]
    starts = np.flatnonzero(np.r_[True, marks[1:] != marks[:-1]])
    ends = np.r_[starts[1:], rows]
    return [
        (f"episode {marks[a]:g}", slice(int(a), int(b)))
        for a, b in zip(starts, ends, strict=True)
    ]
