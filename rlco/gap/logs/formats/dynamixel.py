"""Positions and speeds as Dynamixel's control table has them, made into degrees.

Robotis, e-Manual of the X series: a position counts 4096 steps a turn, with 2048 in the
middle, and a speed units of 0.229 turns a minute.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from rlco.gap.logs.log import Array
from rlco.gap.logs.table import Table

_STEP = 360.0 / 4096.0  # [degrees]
_MIDDLE = 2048.0
_SPEED = 0.229 * 360.0 / 60.0  # [degrees/s]
_TABLE = re.compile(r"(present|goal)[\s_.]*(position|velocity)", re.IGNORECASE)
_LARGEST = 400.0  # a servo's steps go beyond this, its degrees do not


def steps_to_degrees(table: Table) -> Table:
    """Return a table with a servo's steps in degrees, and a note where there were any.

    Steps are whole numbers, in columns named as in the control table: ``Present
    Position``, ``Goal Position``, ``Present Velocity``.

    Example:
        >>> from rlco.gap.logs.formats.headers import parse_header
        >>> column = parse_header("Present_Position_1")
        >>> steps = np.array([2048.0, 3072.0])
        >>> table = Table("log", np.arange(2.0), ((column, steps),))
        >>> found = steps_to_degrees(table).columns[0]
        >>> found[0].angles, found[1]
        ('degrees', array([ 0., 90.]))
    """
    named = [
        (column, values, found[2].lower())
        for column, values in table.columns
        if (found := _TABLE.search(column.header)) and np.isfinite(values).all()
    ]
    places = [values for _, values, what in named if what == "position"]
    if not places or not all(map(_whole, places)):
        return table
    if max(float(np.abs(values).max()) for values in places) < _LARGEST:
        return table
    new: dict[str, Array] = {
        column.header: (values - _MIDDLE) * _STEP
        if what == "position"
        else values * _SPEED
        for column, values, what in named
        if what == "position" or _whole(values)
    }
    note = (
        "Positions are in a servo's steps, 4096 a turn with 2048 in the middle, and "
        "were converted."
    )
    columns = tuple(
        (replace(column, angles="degrees"), new[column.header])
        if column.header in new
        else (column, values)
        for column, values in table.columns
    )
    return replace(table, columns=columns, notes=(*table.notes, note))


def _whole(values: Array) -> bool:
    return bool((values == np.round(values)).all())
