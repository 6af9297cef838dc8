"""Topics in one table: rows at the times of all, blank where one has no message."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rlco.files import few
from rlco.gap.logs.log import Array
from rlco.gap.logs.table import Column, Table

Rows = NDArray[np.bool_]


def aligned(table: Table) -> Table:
    """Return the rows at which positions were measured, what was sent held until then.

    A blank is no fault where other topics have a message at that time and this one's
    own columns are blank together. Without topics in the headers nothing changes.

    Example:
        >>> blank = np.nan
        >>> measured = Column("position", "j", "q", source="/joint_states")
        >>> sent = Column("command", "j", "c", source="/commands")
        >>> columns = ((measured, np.array([1.0, blank, 2.0])),
        ...            (sent, np.array([blank, 5.0, blank])))
        >>> table = aligned(Table("log", np.array([0.0, 0.1, 0.2]), columns))
        >>> table.time, table.columns[1][1]
        (array([0. , 0.2]), array([5., 5.]))
    """
    topics = _topics(table.columns)
    messages = {topic: _messages(columns) for topic, columns in topics.items()}
    whole = {topic: rows for topic, rows in messages.items() if rows is not None}
    sparse = [topic for topic, rows in whole.items() if not rows.all()]
    places = [c.source for c, _ in table.columns if c.kind == "position" and c.source]
    first = next((topic for topic in places if topic in whole), None)
    if first is None or not sparse or not whole[first].any():
        return table
    kept = whole[first]
    others = np.any([rows for topic, rows in whole.items() if topic != first], axis=0)
    if not kept.all() and not np.all(kept | others):
        return table  # rows in which no topic has a message: reported elsewhere
    columns = tuple(
        (
            c,
            _held(values, whole[c.source])[kept]
            if c.source in sparse
            else values[kept],
        )
        for c, values in table.columns
    )
    later = [topic for topic in sparse if topic != first]
    note = f"Topics have times of their own: rows are those of {first}"
    note += f", and {few(later)} is held from message to message." if later else "."
    return replace(
        table, time=table.time[kept], columns=columns, notes=(*table.notes, note)
    )


def _topics(columns: Sequence[tuple[Column, Array]]) -> dict[str, list[Array]]:
    found: dict[str, list[Array]] = {}
    for column, values in columns:
        if column.source:
            found.setdefault(column.source, []).append(values)
    return found


def _messages(columns: Sequence[Array]) -> Rows | None:
    """Return in which rows a topic has a message; None where its columns differ."""
    there = np.isfinite(np.stack(columns))
    same = bool((there == there[0]).all())
    return np.asarray(there[0]) if same else None


def _held(values: Array, messages: Rows) -> Array:
    """Return the last message at each row; before any, the first."""
    at = np.flatnonzero(messages)
    rows = np.searchsorted(at, np.arange(len(values)), side="right") - 1
    return np.asarray(values[at[np.clip(rows, 0, None)]])
