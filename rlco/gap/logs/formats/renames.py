"""What one rename says of its family: of a topic, and of columns that are counted."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from rlco.errors import DataError, suggest
from rlco.files import few
from rlco.gap.logs.table import Table
from rlco.gap.model import LoadedModel

#: The new name of a column to leave out.
LEFT_OUT = "-"
_NUMBER = re.compile(r"\d+(?!.*\d)")


def of_families(
    table: Table, rename: Mapping[str, str], model: LoadedModel | None
) -> dict[str, str]:
    """Return renames of single columns and stems, those of whole families spread.

    A family is all columns of a topic, all that begin with one word and go on with a
    number, and, where a column was not understood, those that differ from it in their
    number or in the name of their joint alone. A column that is left out leaves out no
    sibling; a topic or a word does.

    Raises:
        DataError: A rename names nothing that the log has.

    Example:
        >>> from rlco.gap.logs.formats.headers import parse_header
        >>> import numpy as np
        >>> columns = tuple((parse_header(f"enc{i}"), np.zeros(1)) for i in range(3))
        >>> table = Table("log", np.zeros(1), columns)
        >>> of_families(table, {"enc0": "q1"}, None)
        {'enc0': 'q1', 'enc1': 'q2', 'enc2': 'q3'}
        >>> of_families(table, {"enc": "position"}, None)
        {'enc0': 'position.0', 'enc1': 'position.1', 'enc2': 'position.2'}
    """
    known = _known(table)
    found: dict[str, str] = {}
    for theirs, ours in rename.items():
        if theirs in known:
            found[theirs] = ours
            continue
        members = _members(table, theirs)
        if not members:
            headers = few([column.header for column, _ in table.columns], 16)
            raise DataError(
                f"rename names {theirs!r}{suggest(theirs, known)}, which the log does "
                f"not have; it has {headers}."
            )
        for header, stem in members.items():
            found[header] = ours if ours == LEFT_OUT else f"{ours}.{stem}"
    for theirs, ours in rename.items():
        if theirs in known and ours != LEFT_OUT:
            for header, new in _siblings(table, theirs, ours, model):
                found.setdefault(header, new)
    return found


def _known(table: Table) -> list[str]:
    return [
        name
        for c, _ in table.columns
        for name in (c.stem, c.header, f"{c.source}/{c.stem}" if c.source else "")
        if name
    ]


def _members(table: Table, theirs: str) -> dict[str, str]:
    """Return the stems of the columns of a topic or behind a word, by header."""
    word = re.compile(rf"{re.escape(theirs)}[\s._\-]?\[?(\d+)\]?")
    members = {}
    for column, _ in table.columns:
        counted = word.fullmatch(column.header)
        if counted is not None:
            members[column.header] = counted[1]
        elif column.source == theirs:
            members[column.header] = column.stem
    return members


def _siblings(
    table: Table, theirs: str, ours: str, model: LoadedModel | None
) -> Iterator[tuple[str, str]]:
    names = () if model is None else (*model.joints, *model.actuators)
    others = [c.header for c, _ in table.columns if c.kind == "extra"]
    extra = [header for header in others if header not in (theirs, *names)]
    one, other = _NUMBER.search(theirs), _NUMBER.search(ours)
    named = any(name in ours for name in names)
    if one is not None and other is not None and not named:
        first = int(other[0]) - int(one[0])
        for header in extra:
            number = _NUMBER.search(header)
            if number is None or _NUMBER.sub("#", header) != _NUMBER.sub("#", theirs):
                continue
            if int(number[0]) + first >= 0:
                yield header, _NUMBER.sub(str(int(number[0]) + first), ours)
        return
    same = sorted((n for n in names if n in theirs and n in ours), key=len)
    for name in names if same else ():
        header = theirs.replace(same[-1], name)
        if header in extra:
            yield header, ours.replace(same[-1], name)
