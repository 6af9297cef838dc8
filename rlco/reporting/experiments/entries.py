"""What the methods of an experiment came to, by group, seed and domain."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from rlco.errors import DataError
from rlco.reporting.plots import Curve
from rlco.runs.compare.cells import EVALUATED, ROLLOUT
from rlco.runs.compare.experiment import value_name

State = Literal["done", "older", "failed", "missing"]
#: Shares by method, seed and domain.
Found = Mapping[str, Mapping[Any, Mapping[str, "Rates"]]]


@dataclass(frozen=True)
class Entry:
    """What one method came to with one seed.

    Attributes:
        label: The method.
        group: What the table is of: the values of its variables, "" where it is one.
        seed: Which run.
        state: Whether there is a result: ``done``, ``older`` (by an older version of
            the code), ``failed`` or ``missing``.
        rows: Of results.json, one a domain.
        curve: Evaluations on the way, rows of metrics.csv; empty where none are drawn.
        minutes: Of a processor, that the job took which this is a result of [min].
        values: Those of the group's variables.
        always: Values that the method has in every group, whatever the group's.
        line: The method's place in the tables.
    """

    label: str
    group: str
    seed: Any
    state: State
    rows: tuple[Mapping[str, Any], ...] = ()
    curve: tuple[Mapping[str, float], ...] = ()
    minutes: float | None = None
    values: Mapping[str, Any] = field(default_factory=dict)
    always: Mapping[str, Any] = field(default_factory=dict)
    line: int = 0


def labels_of(entries: Iterable[Entry]) -> list[str]:
    """Return the methods in the order of the table's lines.

    The first group need not have all that others have.

    Example:
        >>> labels_of([Entry("b", "x", 0, "done", line=1), Entry("a", "y", 0, "done")])
        ['a', 'b']
    """
    ordered = sorted(entries, key=lambda entry: entry.line)
    return list(dict.fromkeys(entry.label for entry in ordered))


def group_name(values: Mapping[str, Any]) -> str:
    """Return what a group is called, by the values of its variables.

    Example:
        >>> group_name({"task": "push_cube", "place": "domains/yaw30.yaml"})
        'task push_cube, place yaw30'
    """
    return ", ".join(f"{name} {value_name(value)}" for name, value in values.items())


@dataclass(frozen=True)
class Rates:
    """Shares of the episodes of one run in one domain.

    Attributes:
        end: Solved at the end.
        ever: Solved at some time; None where it was not counted.
        lost: Solved at some time and not at the end; None likewise.
    """

    end: float
    ever: float | None
    lost: float | None


def rates(row: Mapping[str, Any]) -> Rates:
    """Return the shares that a row of results.json counts.

    Example:
        >>> rates({"successes": 1, "episodes": 2, "outcomes": [1, 0], "ever": [1, 1]})
        Rates(end=0.5, ever=1.0, lost=0.5)
    """
    end = row["successes"] / row["episodes"]
    ever = row.get("ever")
    if not isinstance(ever, list) or not ever:
        return Rates(end, None, None)
    share = sum(map(bool, ever)) / len(ever)
    return Rates(end, share, share - end)


def by_domain(rows: Iterable[Mapping[str, Any]], label: str) -> dict[str, Rates]:
    """Return a run's shares by domain, its variation with it where there is one.

    Raises:
        DataError: Two rows are of one domain.
    """
    found: dict[str, Rates] = {}
    for row in rows:
        variation = row.get("variation")
        name = row["domain"] + (f", {variation}" if variation else "")
        if name in found:
            raise DataError(
                f"method {label!r} has several results in {name!r}; say which by "
                "method= in the table of the experiment."
            )
        found[name] = rates(row)
    return found


def found_runs(entries: Iterable[Entry]) -> dict[str, dict[Any, dict[str, Rates]]]:
    """Return the shares by method, seed and domain, of the runs that there are."""
    found: dict[str, dict[Any, dict[str, Rates]]] = {}
    for entry in entries:
        runs = found.setdefault(entry.label, {})
        if entry.rows:
            runs[entry.seed] = by_domain(entry.rows, entry.label)
    return found


def domains_of(found: Found) -> list[str]:
    """Return every domain that a run was evaluated in."""
    runs = [run for by_seed in found.values() for run in by_seed.values()]
    return list(dict.fromkeys(domain for run in runs for domain in run))


def ends_of(runs: Mapping[Any, Mapping[str, Rates]], domain: str) -> dict[Any, float]:
    """Return what each seed's run solved at the end in a domain."""
    return {seed: run[domain].end for seed, run in runs.items() if domain in run}


def gains_of(found: Found, first: str, second: str, domain: str) -> list[float]:
    """Return by how much a method ends above another, for each seed of both."""
    one, other = (ends_of(found.get(label, {}), domain) for label in (first, second))
    return [one[seed] - other[seed] for seed in one if seed in other]


def curves_of(entries: Sequence[Entry], episodes: int | None = None) -> list[Curve]:
    """Return success over the length of RL, all seeds of each method in each domain.

    Seeds whose evaluations were at other steps than the first seed's are left out.

    Args:
        entries: Of one group; those without a curve are left out.
        episodes: Of an evaluation on the way; None: as many as at the end.
    """
    found = []
    for label in dict.fromkeys(entry.label for entry in entries):
        runs = [e for e in entries if e.label == label and e.curve and e.rows]
        if not runs:
            continue
        frames = [row["frames"] for row in runs[0].curve]
        alike = [e for e in runs if [row["frames"] for row in e.curve] == frames]
        count = episodes or runs[0].rows[0]["episodes"]
        for name in runs[0].curve[0]:
            if name.startswith(EVALUATED) and name != ROLLOUT:
                domain = name.removeprefix(EVALUATED)
                success = [[row[name] for row in entry.curve] for entry in alike]
                found.append(Curve(label, domain, frames, success, count))
    return found
