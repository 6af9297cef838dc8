"""Parameter sets of a domain: its effects' numbers, as far as they are known.

What was identified from recordings has intervals, and the numbers of one effect go with
those of another. A sample of them is a list of parameter sets that are about equally
believable; an environment can draw one for each episode.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rlco.errors import DataError, suggest
from rlco.files import Fields, shown
from rlco.files.fields import is_number
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.apply import library_effect

#: What a file may hold at most, of parameters and of sets.
MOST_COLUMNS, MOST_ROWS = 200, 10_000
_TOP = ("columns", "rows")
_COLUMN = ("effect", "name", "target", "parameter")


@dataclass(frozen=True)
class Sample:
    """Parameter sets of a list of effects.

    Attributes:
        columns: The numbers that differ: index of the effect, name of its parameter.
        rows: The parameter sets, K of them, one number for each column.

    Example:
        >>> friction = AppliedEffect("coulomb_friction", "j", {"frictionloss": 0.5})
        >>> sample = Sample(((0, "frictionloss"),), ((0.4,), (0.6,)))
        >>> len(sample), sample.drawn(1, [friction])[0].parameters
        (2, {'frictionloss': 0.6})
    """

    columns: tuple[tuple[int, str], ...]
    rows: tuple[tuple[float, ...], ...]

    def __len__(self) -> int:
        return len(self.rows)

    def drawn(
        self, row: int, effects: Sequence[AppliedEffect]
    ) -> tuple[AppliedEffect, ...]:
        """Return the effects with the numbers of one parameter set."""
        numbers = [dict(effect.parameters) for effect in effects]
        for (index, parameter), value in zip(self.columns, self.rows[row], strict=True):
            numbers[index][parameter] = value
        return tuple(
            replace(effect, parameters=mine)
            for effect, mine in zip(effects, numbers, strict=True)
        )

    def moved(self, places: Mapping[int, int]) -> Sample:
        """Return the sample of a list in which effects stand elsewhere.

        Args:
            places: From each effect's index to its index in the other list.
        """
        return replace(
            self, columns=tuple((places[index], name) for index, name in self.columns)
        )


def content_of(
    sample: Sample, effects: Sequence[AppliedEffect]
) -> dict[str, list[Any]]:
    """Return a sample as an entry of a file, the inverse of `sample_of`."""
    columns = [
        dict(
            zip(
                _COLUMN,
                (index + 1, effects[index].name, effects[index].target, parameter),
                strict=True,
            )
        )
        for index, parameter in sample.columns
    ]
    return {"columns": columns, "rows": [list(row) for row in sample.rows]}


def sample_of(
    content: Mapping[str, Any], effects: Sequence[AppliedEffect], place: str
) -> Sample:
    """Return a sample from the entry of a file.

    Args:
        content: ``columns``, each with the number of an effect in the file, from 1, its
            name and target, and the name of a parameter; and ``rows`` of a value for
            each column.
        effects: The file's effects.
        place: The file, for error messages.

    Raises:
        DataError: If the entry has another form or size, a number is not finite, or a
            column is not a parameter of the effect that it names.

    Example:
        >>> friction = AppliedEffect("coulomb_friction", "j", {"frictionloss": 0.5})
        >>> column = {"effect": 1, "name": "coulomb_friction", "target": "j"}
        >>> column["parameter"] = "frictionloss"
        >>> sample_of({"columns": [column], "rows": [[0.4]]}, [friction], "here").rows
        ((0.4,),)
    """
    fields = Fields(
        content, f"the sample of {place}", advice="let the gap workflow write it again"
    )
    for key in content:
        if key not in _TOP:
            raise DataError(
                f"the sample of {place} has an unknown entry {shown(key)}"
                f"{suggest(str(key), _TOP)}; known: {', '.join(_TOP)}."
            )
    for key, most in zip(_TOP, (MOST_COLUMNS, MOST_ROWS), strict=True):
        count = len(fields.sequence(key))
        if not 1 <= count <= most:
            raise DataError(
                f"the sample of {place} has {count} {key}; give 1 to {most}."
            )
    columns = tuple(_column(one, effects, place) for one in fields.groups("columns"))
    if len(set(columns)) < len(columns):
        raise DataError(
            f"the sample of {place} has a parameter twice among its columns; give each "
            "once."
        )
    rows = fields.sequence("rows")
    return Sample(
        columns,
        tuple(_row(row, n, len(columns), place) for n, row in enumerate(rows, 1)),
    )


def _row(row: Any, number: int, columns: int, place: str) -> tuple[float, ...]:
    if not (isinstance(row, list) and len(row) == columns and all(map(is_number, row))):
        raise DataError(
            f"row {number} of the sample of {place} is {shown(row)}; give a finite "
            f"number for each of the {columns} columns."
        )
    return tuple(float(value) for value in row)


def _column(
    column: Fields, effects: Sequence[AppliedEffect], place: str
) -> tuple[int, str]:
    name, parameter = column.text("name"), column.text("parameter")
    target = column.text("target", None)
    number = column.integer("effect", minimum=1)
    effect = effects[number - 1] if number <= len(effects) else None
    same = effect is not None and (effect.name, effect.target) == (name, target)
    if effect is None or not same or parameter not in effect.parameters:
        where = "" if target is None else f" at {shown(target)}"
        raise DataError(
            f"the sample of {place} has a column for {shown(parameter)} of effect "
            f"{number}, {shown(name)}{where}, which the file's effect {number} has "
            "not; leave out the sample, or give it the effects that it was written for."
        )
    if library_effect(name).of_task:
        raise DataError(
            f"the sample of {place} has a column for {shown(name)}, which a task reads "
            "only while it is built; leave it out of the sample."
        )
    return number - 1, parameter
