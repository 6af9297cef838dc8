"""What the last method of a comparison gains over the others, paired."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from rlco.reporting.plot_style import styles
from rlco.reporting.statistics import (
    Interval,
    ResultRow,
    paired_over_seeds,
    paired_rows,
)

#: Task, domain and variation: what methods are compared within.
Column = tuple[str, str, str | None]


@dataclass(frozen=True)
class Difference:
    """Success at the end of one method minus that of another, in one column.

    Attributes:
        first: The method that the other is subtracted from.
        second: The other.
        column: Task, domain and variation.
        interval: The difference, in [-1, 1], with its paired interval of 95 %.
        seeds: How many seeds it is the mean of. With one the interval is over initial
            states, for these two policies; with several it is over seeds.
        episodes: Initial states per seed.
    """

    first: str
    second: str
    column: Column
    interval: Interval
    seeds: int
    episodes: int

    def __str__(self) -> str:
        estimate, low, high = (100 * value for value in self.interval)
        reach = "" if math.isnan(low) else f" [{low:+.1f}, {high:+.1f}]"
        over = f"{self.seeds} seeds" if self.seeds > 1 else "initial states"
        return f"{estimate:+.1f} points{reach}, paired over {over}"


def columns(rows: Sequence[ResultRow]) -> list[Column]:
    """Return what the rows were evaluated in, in their order."""
    found = ((row["task"], row["domain"], row["variation"]) for row in rows)
    return list(dict.fromkeys(found))


def cell(rows: Sequence[ResultRow], method: str, column: Column) -> list[ResultRow]:
    """Return one method's rows in one column, one per seed."""
    return [
        row
        for row in rows
        if row["method"] == method
        and (row["task"], row["domain"], row["variation"]) == column
    ]


def last_differences(rows: Sequence[ResultRow]) -> list[Difference]:
    """Return the last method's differences from all others, in each column.

    Methods are ordered as in figures. Seeds that only one of two methods has are left
    out, and so are rows without outcomes per episode, of older files.

    Raises:
        RlcoError: Rows of one seed do not have the same initial states.

    Example:
        >>> def row(method, outcomes):
        ...     return dict(
        ...         method=method, task="push_cube", domain="sim", variation=None,
        ...         seed=0, episodes=10, outcomes=outcomes)
        >>> rows = [row("sft", [1] * 4 + [0] * 6), row("rl_co", [1] * 9 + [0])]
        >>> for found in last_differences(rows):
        ...     print(found.first, "-", found.second, found)
        rl_co - sft +50.0 points [+8.2, +74.6], paired over initial states
    """
    counted = [row for row in rows if "outcomes" in row]
    methods = list(styles(row["method"] for row in counted))
    found = []
    for column in columns(counted):
        for former in methods[:-1]:
            both = [cell(counted, name, column) for name in (methods[-1], former)]
            seeds = set.intersection(*({row["seed"] for row in one} for one in both))
            if not seeds:
                continue
            first, second = ([r for r in one if r["seed"] in seeds] for one in both)
            several = len(first) > 1 or len(second) > 1
            interval = (
                paired_over_seeds(first, second)
                if several
                else paired_rows(first[0], second[0])
            )
            episodes = first[0]["episodes"]
            found.append(
                Difference(methods[-1], former, column, interval, len(seeds), episodes)
            )
    return found
