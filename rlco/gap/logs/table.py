"""One recording as its file has it, before its columns are matched to a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from rlco.errors import DataError
from rlco.gap.logs.log import Array

Kind = Literal["position", "velocity", "command", "torque", "pose", "extra"]
Angles = Literal["degrees", "radians"]


@dataclass(frozen=True)
class Column:
    """The meaning of a column, from its header.

    Attributes:
        kind: What was measured or sent.
        stem: Whose: a joint's or an actuator's name, a number that says which, or
            empty where there is only one; of a pose the axis, such as ``x``.
        header: The column's name in the file, for messages.
        angles: The unit of angles that the header gives, where it gives one.
        source: The topic that it is of, where the header gives one, such as
            ``/joint_states``: several may report the same quantity.
    """

    kind: Kind
    stem: str
    header: str
    angles: Angles | None = None
    source: str = ""


#: What a number of a log may be: squares and products of such are finite, too.
LARGEST = 1e30


@dataclass(frozen=True)
class Table:
    """One recording as its file has it.

    Attributes:
        name: For messages and reports.
        time: Seconds, (T,) [s].
        columns: The columns with their values, (T,) each.
        facts: Numbers that hold for the whole recording.
        device: What was recorded, as its file names it; empty where it does not.
        notes: What was noticed while reading, one sentence each.
    """

    name: str
    time: Array
    columns: tuple[tuple[Column, Array], ...]
    facts: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    device: str = ""

    def of_kind(self, kind: Kind) -> dict[str, Array]:
        """Return the columns of a kind by their stems."""
        return {c.stem: values for c, values in self.columns if c.kind == kind}


def require_finite(where: str, header: str, values: Array, time: Array | None) -> None:
    """Raise if a column has a value that is not finite, or one that nothing measures.

    Raises:
        DataError: Names the column and the first such row.
    """
    bad = ~np.isfinite(values)
    if not bad.any():
        large = np.abs(values) > LARGEST
        if large.any():
            row = int(large.argmax())
            raise DataError(
                f"column {header!r} of {where} holds {values[row]:g} in row {row + 1}, "
                "which nothing measures; correct it, or leave the column or these rows "
                "out."
            )
        return
    row = int(bad.argmax())
    known = time is not None and bool(np.isfinite(time[row]))
    when = f" at {time[row]:.3f} s" if known and time is not None else ""
    raise DataError(
        f"column {header!r} of {where} is NaN, infinite or empty in {int(bad.sum())} "
        f"of {len(values)} rows, first in row {row + 1}{when}; correct it, or leave "
        "the column or these rows out."
    )
