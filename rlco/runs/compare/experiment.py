"""What an experiment consists of: variables, jobs, and a table."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rlco.runs.compare.templates import filled, names_in


@dataclass(frozen=True)
class JobKind:
    """A job as written: one for all values of its variables.

    Attributes:
        name: Its name, by which later jobs and the table refer to it.
        script: As the file gives it; it is part of a job's key.
        path: The script's file.
        options: Templates by option, groups dotted.
        minutes: Expected time on one processor [min].
        curves: Tables in its run folder, as glob patterns, whose evaluations are kept.
        results: Whether it writes a results.json; one that makes data does not.
        needs: Jobs whose folders its options name.
        variables: What it varies with, those of the jobs it needs among them.
    """

    name: str
    script: str
    path: Path
    options: Mapping[str, Any]
    minutes: float
    curves: tuple[str, ...]
    results: bool
    needs: tuple[str, ...]
    variables: tuple[str, ...]


@dataclass(frozen=True)
class Line:
    """A method of the table.

    Attributes:
        label: What it is called; a template.
        job: Whose results it is.
        method: Which rows of them; None: there are no others.
        curve: The table of the job's that is drawn; None: none.
        at: Values of variables that it has in every table, whatever the table's.
    """

    label: str
    job: str
    method: str | None
    curve: str | None
    at: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Prediction:
    """That a method's gain over another falls where a third succeeds.

    Attributes:
        gain: Two labels, first minus second.
        falls_with: The label of the third.
        domain: Where all three are counted.
    """

    gain: tuple[str, str]
    falls_with: str
    domain: str


@dataclass(frozen=True)
class Published:
    """What others reported on the same question, to stand beside ours.

    Attributes:
        source: Who, on what.
        at: Values of variables that it belongs beside.
        success: Success rates by method's label, in [0, 1].
    """

    source: str
    at: Mapping[str, Any]
    success: Mapping[str, float]


@dataclass(frozen=True)
class Table:
    """What is compared.

    Attributes:
        by: Variables that have a table for each of their values.
        seed: The variable that is averaged over.
        lines: The methods.
        differences: Pairs of labels, first minus second.
        predictions: Rank correlations over the tables that ``by`` makes.
        curve_episodes: Episodes behind a point of a curve; None: as many as at the end.
        mean: Those of ``by`` that a mean is taken over; of none there is no mean.
        axis: The one of ``by`` over which success is drawn; None: it is not.
        domains: Where success is tabulated, in this order; (): all that there are.
        published: What others reported.
    """

    by: tuple[str, ...]
    seed: str
    lines: tuple[Line, ...]
    differences: tuple[tuple[str, str], ...]
    predictions: tuple[Prediction, ...]
    curve_episodes: int | None
    mean: tuple[str, ...] = ()
    axis: str | None = None
    domains: tuple[str, ...] = ()
    published: tuple[Published, ...] = ()


#: Values of some variables, combinations of which are not run.
Without = Mapping[str, tuple[Any, ...]]


@dataclass(frozen=True)
class Experiment:
    """What is run and compared; see `rlco.runs.compare.reading.read_experiment`."""

    name: str
    over: Mapping[str, tuple[Any, ...]]
    jobs: Mapping[str, JobKind]
    table: Table
    without: tuple[Without, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)


def left_out(values: Mapping[str, Any], without: Iterable[Without]) -> bool:
    """Return whether values are a combination that is not run.

    Example:
        >>> without = [{"task": ("open_drawer",), "seed": (3, 4)}]
        >>> left_out({"task": "open_drawer", "seed": 4, "beta": 0.2}, without)
        True
        >>> left_out({"seed": 4}, without)  # of a job that all tasks share
        False
    """
    return any(
        all(name in values and values[name] in given for name, given in one.items())
        for one in without
    )


def value_name(value: Any) -> str:
    """Return what a value of a variable is called: a file by its name alone.

    Example:
        >>> value_name(0.2), value_name("benchmarks/domains/yaw30.yaml")
        ('0.2', 'yaw30')
    """
    text = str(value)
    return Path(text).stem if text.endswith(".yaml") else text


def named_in(label: str, over: Mapping[str, tuple[Any, ...]]) -> list[str]:
    """Return the variables that a label names, each once.

    Example:
        >>> named_in("beta {beta}", {"beta": (0, 0.2), "seed": (1,)})
        ['beta']
    """
    try:
        return [name for name in dict.fromkeys(names_in(label)) if name in over]
    except ValueError:
        return []  # what is wrong in it is reported where it is read


def labels_of(label: str, over: Mapping[str, tuple[Any, ...]]) -> list[str]:
    """Return a label with all values of the variables that it names.

    Example:
        >>> labels_of("beta {beta}", {"beta": (0, 0.2), "seed": (1,)})
        ['beta 0', 'beta 0.2']
    """
    names = named_in(label, over)
    try:
        return [
            filled(label, dict(zip(names, values, strict=True)))
            for values in itertools.product(*(over[name] for name in names))
        ]
    except (ValueError, LookupError, OverflowError):
        return []  # as above
