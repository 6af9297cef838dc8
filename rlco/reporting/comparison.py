"""Tables of methods over seeds: means, worst seeds, and differences by seed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from rlco.errors import DataError
from rlco.reporting.plots import Curve
from rlco.reporting.rank_correlation import LEAST_GROUPS, Runs, rank_correlation
from rlco.reporting.statistics import Interval, mean_interval, mean_of_means
from rlco.runs.compare.cells import EVALUATED, ROLLOUT
from rlco.runs.compare.experiment import Prediction

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
    """

    label: str
    group: str
    seed: Any
    state: State
    rows: tuple[Mapping[str, Any], ...] = ()
    curve: tuple[Mapping[str, float], ...] = ()
    minutes: float | None = None


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


def comparison_table(
    entries: Sequence[Entry], differences: Sequence[tuple[str, str]] = ()
) -> str:
    """Return the tables of an experiment, in Markdown.

    For each group and method the mean over seeds with Student's t interval of 95 %, the
    worst seed, what was solved at some time and what was lost again; below it the
    differences of methods, paired by seed. What is missing stands there as missing.

    Raises:
        DataError: A method has several results in one domain.
    """
    parts = []
    for group in dict.fromkeys(entry.group for entry in entries):
        mine = [entry for entry in entries if entry.group == group]
        if group:
            parts.append(f"## {group}")
        parts.append(_methods(mine))
        if differences:
            parts.append(_differences(mine, differences))
    if any(entry.state == "older" for entry in entries):
        parts.append("\\* with results of another version of the code")
    return "\n\n".join(parts) + "\n"


def _methods(entries: Sequence[Entry]) -> str:
    found = _found(entries)
    domains = _domains(found)
    counted = any(
        one.ever is not None
        for runs in found.values()
        for d in runs.values()
        for one in d.values()
    )
    head = ["method"]
    for domain in domains or ["success"]:
        head += [domain, "worst seed"]
        head += ["at some time", "lost again"] if counted else []
    lines = [_row([*head, "seeds"]), "|---" * (len(head) + 1) + "|"]
    for label in dict.fromkeys(entry.label for entry in entries):
        mine = [entry for entry in entries if entry.label == label]
        cells = [label + (" \\*" if any(e.state == "older" for e in mine) else "")]
        for domain in domains or ["success"]:
            runs = [run[domain] for run in found[label].values() if domain in run]
            # Of a method that has all its runs nothing more is to come.
            finished = all(entry.state == "done" for entry in mine)
            cells += _cells(runs, counted, "-" if finished else "missing")
        lines.append(_row([*cells, _seeds(mine)]))
    return "\n".join(lines)


def _cells(runs: Sequence[Rates], counted: bool, none: str) -> list[str]:
    """Return one domain's cells of a method, ``none`` where it has no run."""
    if not runs:
        return [none, *["-"] * (3 if counted else 1)]
    end = [run.end for run in runs]
    cells = [_share(mean_interval(end)), f"{min(end):.0%}"]
    if counted:
        for values in ([run.ever for run in runs], [run.lost for run in runs]):
            there = [value for value in values if value is not None]
            cells.append(f"{sum(there) / len(there):.0%}" if there else "-")
    return cells


def _seeds(entries: Sequence[Entry]) -> str:
    """Return how many seeds a line is of, and what became of the others."""
    there = sum(entry.state in ("done", "older") for entry in entries)
    parts = [
        f"{count} {state}"
        for state in ("failed", "missing")
        if (count := sum(entry.state == state for entry in entries))
    ]
    if not parts:
        return str(there)
    return f"{there} of {len(entries)}: {', '.join(parts)}"


def _differences(entries: Sequence[Entry], pairs: Sequence[tuple[str, str]]) -> str:
    found = _found(entries)
    domains = _domains(found) or ["success"]
    head = ["difference, points", *domains, "seeds of both"]
    lines = [_row(head), "|---" * len(head) + "|"]
    # A group need not have all methods.
    for first, second in (pair for pair in pairs if set(pair) <= found.keys()):
        cells, numbers = [f"{first} - {second}"], set()
        for domain in domains:
            gains = _gains(found, first, second, domain)
            cells.append(_points(mean_interval(gains)) if gains else "missing")
            numbers.add(len(gains))
        lines.append(_row([*cells, " / ".join(map(str, sorted(numbers)))]))
    return "\n".join(lines)


def _found(entries: Iterable[Entry]) -> dict[str, dict[Any, dict[str, Rates]]]:
    """Return the shares by method, seed and domain, of the runs that there are."""
    found: dict[str, dict[Any, dict[str, Rates]]] = {}
    for entry in entries:
        runs = found.setdefault(entry.label, {})
        if entry.rows:
            runs[entry.seed] = by_domain(entry.rows, entry.label)
    return found


def _domains(found: Found) -> list[str]:
    runs = [run for by_seed in found.values() for run in by_seed.values()]
    return list(dict.fromkeys(domain for run in runs for domain in run))


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _share(mean: Interval) -> str:
    if math.isnan(mean.low):
        return f"{mean.estimate:.0%}"
    return f"{mean.estimate:.0%} [{max(mean.low, 0):.0%}, {min(mean.high, 1):.0%}]"


def _points(mean: Interval) -> str:
    text = f"{100 * mean.estimate:+.1f}"
    if math.isnan(mean.low):
        return text
    return f"{text} [{100 * mean.low:+.1f}, {100 * mean.high:+.1f}]"


def overview_table(
    entries: Sequence[Entry], differences: Sequence[tuple[str, str]] = ()
) -> str:
    """Return one table of all groups, in Markdown: a line each for every domain.

    It has the methods' means over seeds, and the differences with Student's t interval
    of 95 %, paired by seed; `comparison_table` says how many there were.

    Raises:
        DataError: A method has several results in one domain.
    """
    labels = list(dict.fromkeys(entry.label for entry in entries))
    head = ["success in", *labels, *(f"{a} - {b}" for a, b in differences)]
    lines = [_row(head), "|---" * len(head) + "|"]
    for group in dict.fromkeys(entry.group for entry in entries):
        found = _found(entry for entry in entries if entry.group == group)
        for domain in _domains(found):
            cells = [", ".join(part for part in (group, domain) if part)]
            for label in labels:
                values = _ends(found.get(label, {}), domain).values()
                cells.append(f"{sum(values) / len(values):.0%}" if values else "-")
            for first, second in differences:
                gains = _gains(found, first, second, domain)
                cells.append(_points(mean_interval(gains)) if gains else "-")
            lines.append(_row(cells))
    return "\n".join(lines) + "\n"


def mean_table(entries: Sequence[Entry], differences: Sequence[tuple[str, str]]) -> str:
    """Return the differences' means over the groups that have both, in Markdown.

    Each group counts alike, whatever its seeds: `mean_of_means`.

    Raises:
        DataError: A method has several results in one domain.
    """
    groups = {
        group: _found(entry for entry in entries if entry.group == group)
        for group in dict.fromkeys(entry.group for entry in entries)
    }
    domains = dict.fromkeys(
        domain for found in groups.values() for domain in _domains(found)
    )
    head = ["difference, points, mean over the tables", *domains, "tables"]
    lines = ["\n## Mean\n", _row(head), "|---" * len(head) + "|"]
    for first, second in differences:
        cells = [f"{first} - {second}"]
        both = [found for found in groups.values() if {first, second} <= found.keys()]
        for domain in domains:
            gains = [_gains(found, first, second, domain) for found in both]
            whole = gains and all(gains)
            cells.append(_points(mean_of_means(gains)) if whole else "missing")
        lines.append(_row([*cells, str(len(both))]))
    return "\n".join(lines) + "\n"


def prediction_table(
    entries: Sequence[Entry], predictions: Sequence[Prediction]
) -> str:
    """Return how gains and successes correlate over groups, in Markdown.

    Only seeds count that all three methods have; "" where nothing was predicted.

    Raises:
        DataError: A method has several results in one domain.
    """
    if not predictions:
        return ""
    lines = [
        "\n## Predictions",
        "",
        _row(["over the tables above, in", "rank correlation", "tables, seeds"]),
        "|---|---|---|",
    ]
    for prediction in predictions:
        groups = list(prediction_runs(entries, prediction).values())
        first, second = prediction.gain
        what = f"{first} - {second} against {prediction.falls_with}"
        lines.append(
            _row(
                [
                    f"{what}, {prediction.domain}",
                    _correlation(groups),
                    f"{len(groups)}, {sum(len(runs.x) for runs in groups)} in all",
                ]
            )
        )
    return "\n".join(lines) + "\n"


def prediction_runs(
    entries: Sequence[Entry], prediction: Prediction
) -> dict[str, Runs]:
    """Return success and gain by group, of the seeds that all three methods have.

    Raises:
        DataError: A method has several results in one domain.
    """
    domain, groups = prediction.domain, {}
    for group in dict.fromkeys(entry.group for entry in entries):
        found = _found(entry for entry in entries if entry.group == group)
        third, first, second = (
            _ends(found.get(label, {}), domain)
            for label in (prediction.falls_with, *prediction.gain)
        )
        seeds = [seed for seed in third if seed in first and seed in second]
        if seeds:
            gains = [first[seed] - second[seed] for seed in seeds]
            groups[group] = Runs([third[seed] for seed in seeds], gains)
    return groups


def _ends(runs: Mapping[Any, Mapping[str, Rates]], domain: str) -> dict[Any, float]:
    """Return what each seed's run solved at the end in a domain."""
    return {seed: run[domain].end for seed, run in runs.items() if domain in run}


def _gains(found: Found, first: str, second: str, domain: str) -> list[float]:
    """Return by how much a method ends above another, for each seed of both."""
    one, other = (_ends(found.get(label, {}), domain) for label in (first, second))
    return [one[seed] - other[seed] for seed in one if seed in other]


def _correlation(groups: Sequence[Runs]) -> str:
    if len(groups) < LEAST_GROUPS:
        return "missing"
    try:
        found = rank_correlation(groups)
    except ValueError:  # all alike
        return "none: all tables are equal"
    return f"{found.estimate:+.2f} [{found.low:+.2f}, {found.high:+.2f}]"


def cost_table(entries: Sequence[Entry]) -> str:
    """Return what the methods' jobs cost, means over seeds and groups, in Markdown."""
    head = "| method | its job, minutes of a processor |"
    lines = ["", "## Cost", "", head, "|---|---|"]
    for label in dict.fromkeys(entry.label for entry in entries):
        minutes = [e.minutes for e in entries if e.label == label and e.minutes]
        mean = f"{sum(minutes) / len(minutes):.1f}" if minutes else "missing"
        lines.append(_row([label, mean]))
    return "\n".join(lines) + "\n"


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
