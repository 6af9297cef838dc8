"""One source for each quantity, where several topics tell the same."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from rlco.files import few
from rlco.gap.logs.formats.topics import rank
from rlco.gap.logs.matching import MEASURED
from rlco.gap.logs.table import Column, Kind, Table

_PLURAL: dict[Kind, str] = {
    "position": "Positions",
    "velocity": "Velocities",
    "torque": "Torques",
    "command": "Commands",
}


def one_source(table: Table, named: Collection[str] = ()) -> Table:
    """Set aside all but one topic of each quantity, with a note.

    What was measured is taken from ``joint_states`` where it is there; what was sent,
    from the topic that is nearest to the hardware; before both comes a topic of which
    the user named a column.

    Args:
        table: One recording.
        named: Headers of such columns.

    Example:
        >>> from rlco.gap.logs.formats.headers import parse_header
        >>> import numpy as np
        >>> names = ["/joint_states/j/position", "/c/state/actual/positions[0]",
        ...          "/c/state/output/positions[0]", "/c/state/desired/positions[0]"]
        >>> columns = tuple((parse_header(name), np.zeros(2)) for name in names)
        >>> found = one_source(Table("log", np.arange(2.0), columns))
        >>> [column.kind for column, _ in found.columns]
        ['position', 'extra', 'command', 'extra']
    """
    chosen: dict[Kind, str] = {}
    notes = []
    first = {_source(c, table) for c, _ in table.columns if c.header in named}
    for kind in (*MEASURED, "command"):
        sources = [_source(c, table) for c, _ in table.columns if c.kind == kind]
        # Of two that are alike the later one counts.
        counts = {source: sources.count(source) for source in reversed(sources)}
        if len(counts) < 2:
            continue
        best = min(counts, key=lambda s: (s not in first, _order(kind, s), -counts[s]))
        chosen[kind] = best
        left = [source for source in reversed(counts) if source != best]
        notes.append(f"{_PLURAL[kind]} are those of {best}; left out: {few(left)}.")
    columns = tuple(
        (
            replace(c, kind="extra", stem=c.header)
            if c.kind in chosen and chosen[c.kind] != _source(c, table)
            else c,
            values,
        )
        for c, values in table.columns
    )
    return replace(table, columns=columns, notes=(*table.notes, *notes))


def _source(column: Column, table: Table) -> str:
    """Return the topic of a column; where it has none, its header without its joint.

    Plain headers are of one source, unless two of them tell the same.
    """
    if column.source:
        return column.source
    stems = [c.stem for c, _ in table.columns if c.kind == column.kind and not c.source]
    if len(set(stems)) == len(stems):
        return "plain columns"
    before, _, after = column.header.rpartition(column.stem)
    return f"{before}*{after}" if column.stem else column.header


def _order(kind: Kind, source: str) -> int:
    if kind == "command":
        return rank(source)
    return 0 if source.endswith("joint_states") else 1
