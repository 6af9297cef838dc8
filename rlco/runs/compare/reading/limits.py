"""How large an experiment may be: far beyond what runs, and small enough to plan."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from typing import Any

from rlco.errors import counted
from rlco.files import shown
from rlco.files.reading import cut
from rlco.runs.compare.experiment import JobKind, Line, Without, named_in
from rlco.runs.compare.jobs import job_name
from rlco.runs.compare.reading.problems import Problems
from rlco.runs.compare.templates import names_in, plain

#: Values of a variable.
MOST_VALUES = 1_000
#: Jobs as written, each needing those above it; jobs, or rows of tables, with all
#: values: a few variables of a hundred values each are more than any memory holds.
_KINDS, _JOBS = 200, 10_000
#: Values of what is left out.
_WITHOUT = 2_000
#: Options of a job, and their characters: Linux takes 128 kB in one of them.
_OPTIONS, _CHARACTERS = 500, 100_000
_LABEL = 200  # characters
# Bytes of a job's name: a file system takes 255, and a cell's file has a hash more.
_NAME = 220
#: Of the folder of a job, which is not known yet [characters].
_FOLDER = 500


def check_options(
    problems: Problems,
    what: str,
    options: Mapping[str, Any],
    over: Mapping[str, tuple[Any, ...]],
    jobs: Collection[str],
) -> None:
    """Check that a command line takes a job's options, whatever the values."""
    lengths = {**dict.fromkeys(jobs, _FOLDER), **_lengths(over)}
    size = sum(len(name) + _length(value, lengths) for name, value in options.items())
    if len(options) > _OPTIONS or size > _CHARACTERS:
        problems.add(
            f"{what} has {counted(len(options), 'option')} of up to {size} characters, "
            f"and at most {_OPTIONS} of {_CHARACTERS} are taken; put what is long into "
            "a file"
        )


def check_jobs(
    problems: Problems,
    jobs: Collection[JobKind],
    over: Mapping[str, tuple[Any, ...]],
) -> None:
    """Check that jobs are no more than can be planned, and have short enough names."""
    every = sum(_combinations(kind.variables, over) for kind in jobs)
    if len(jobs) > _KINDS or every > _JOBS:
        problems.add(
            f"jobs holds more than {_KINDS} jobs, or more than {_JOBS} with all values "
            "of their variables; make several experiments of them"
        )
    for kind in jobs:
        longest = {
            name: max(over[name], key=lambda value: len(str(plain(value))))
            for name in kind.variables
        }
        if (size := len(job_name(kind.name, longest).encode())) > _NAME:
            problems.add(
                f"job {cut(kind.name)} has a folder whose name is of {size} bytes with "
                f"the longest values, and at most {_NAME} are taken; shorten them"
            )


def check_without(problems: Problems, without: Iterable[Without]) -> None:
    """Check that what is left out is not too much to compare each job with."""
    size = sum(len(values) for one in without for values in one.values())
    if size > _WITHOUT:
        problems.add(
            f"without holds {size} values, and at most {_WITHOUT} are taken; leave "
            "values out of over instead, or make several experiments"
        )


def fits(
    problems: Problems,
    lines: Collection[Line],
    beside: int,
    by: Iterable[str],
    over: Mapping[str, tuple[Any, ...]],
) -> bool:
    """Check a table's size; return whether all of its labels can be written out.

    Args:
        problems: What is wrong is added.
        lines: The methods.
        beside: Further rows, which are of no method alone.
        by: The variables that have a table for each of their values.
        over: The values of the variables.
    """
    lengths = _lengths(over)
    long = [line.label for line in lines if _length(line.label, lengths) > _LABEL]
    problems.extend(
        f"table's method {shown(label)} has a label of more than {_LABEL} characters "
        "with the longest values; shorten it"
        for label in long
    )
    rows = beside
    rows += sum(_combinations(named_in(line.label, over), over) for line in lines)
    rows *= _combinations((name for name in by if name in over), over)
    if rows > _JOBS:
        problems.add(
            f"table would have more than {_JOBS} rows, of all methods with all values "
            "of by; make several experiments of them"
        )
    return not long and rows <= _JOBS


def _combinations(names: Iterable[str], over: Mapping[str, tuple[Any, ...]]) -> int:
    return math.prod(len(over[name]) for name in names)


def _lengths(over: Mapping[str, tuple[Any, ...]]) -> dict[str, int]:
    """Return how long the longest value of each variable is."""
    return {
        name: max(len(str(plain(value))) for value in values)
        for name, values in over.items()
    }


def _length(value: Any, lengths: Mapping[str, int]) -> int:
    """Return how long a value can be with its names filled in."""
    if isinstance(value, list):
        return sum(_length(item, lengths) + 1 for item in value) + 1
    if not isinstance(value, str):
        return len(str(value))
    try:
        return len(value) + sum(lengths.get(name, 0) for name in names_in(value))
    except ValueError:
        return len(value)  # what is wrong in it is reported where it is read
