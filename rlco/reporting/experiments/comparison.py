"""Tables of methods over seeds: means, worst seeds, and differences by seed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from rlco.reporting.experiments.entries import (
    Entry,
    Rates,
    domains_of,
    ends_of,
    found_runs,
    gains_of,
    labels_of,
)
from rlco.reporting.experiments.rank_correlation import (
    LEAST_GROUPS,
    Runs,
    rank_correlation,
)
from rlco.reporting.statistics import Interval, mean_interval
from rlco.runs.compare.experiment import Prediction, Published


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
    found = found_runs(entries)
    domains = domains_of(found)
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
    lines = [row_of([*head, "seeds"]), "|---" * (len(head) + 1) + "|"]
    for label in dict.fromkeys(entry.label for entry in entries):
        mine = [entry for entry in entries if entry.label == label]
        cells = [label + (" \\*" if any(e.state == "older" for e in mine) else "")]
        for domain in domains or ["success"]:
            runs = [run[domain] for run in found[label].values() if domain in run]
            # Of a method that has all its runs nothing more is to come.
            finished = all(entry.state == "done" for entry in mine)
            cells += _cells(runs, counted, "-" if finished else "missing")
        lines.append(row_of([*cells, _seeds(mine)]))
    return "\n".join(lines)


def _cells(runs: Sequence[Rates], counted: bool, none: str) -> list[str]:
    """Return one domain's cells of a method, ``none`` where it has no run."""
    if not runs:
        return [none, *["-"] * (3 if counted else 1)]
    end = [run.end for run in runs]
    cells = [share(mean_interval(end)), f"{min(end):.0%}"]
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
    found = found_runs(entries)
    domains = domains_of(found) or ["success"]
    head = ["difference, points", *domains, "seeds of both"]
    lines = [row_of(head), "|---" * len(head) + "|"]
    # A group need not have all methods.
    for first, second in (pair for pair in pairs if set(pair) <= found.keys()):
        cells, numbers = [f"{first} - {second}"], set()
        for domain in domains:
            gains = gains_of(found, first, second, domain)
            cells.append(points(mean_interval(gains)) if gains else "missing")
            numbers.add(len(gains))
        lines.append(row_of([*cells, " / ".join(map(str, sorted(numbers)))]))
    return "\n".join(lines)


def row_of(cells: Iterable[str]) -> str:
    """Return a line of a table."""
    return f"| {' | '.join(cells)} |"


def share(mean: Interval) -> str:
    """Return a rate in percent with its interval, cut at 0 and 100."""
    if math.isnan(mean.low):
        return f"{mean.estimate:.0%}"
    return f"{mean.estimate:.0%} [{max(mean.low, 0):.0%}, {min(mean.high, 1):.0%}]"


def points(mean: Interval) -> str:
    """Return a difference of rates in percentage points with its interval."""
    text = f"{100 * mean.estimate:+.1f}"
    if math.isnan(mean.low):
        return text
    return f"{text} [{100 * mean.low:+.1f}, {100 * mean.high:+.1f}]"


def overview_table(
    entries: Sequence[Entry],
    differences: Sequence[tuple[str, str]] = (),
    published: Sequence[Published] = (),
) -> str:
    """Return one table of all groups, in Markdown: a line each for every domain.

    It has the methods' means over seeds, and the differences with Student's t interval
    of 95 %, paired by seed; `comparison_table` says how many there were. What others
    reported stands below the group that it belongs beside.

    Raises:
        DataError: A method has several results in one domain.
    """
    labels = labels_of(entries)
    head = ["success in", *labels, *(f"{a} - {b}" for a, b in differences)]
    lines = [row_of(head), "|---" * len(head) + "|"]
    for group in dict.fromkeys(entry.group for entry in entries):
        found = found_runs(entry for entry in entries if entry.group == group)
        for domain in domains_of(found):
            cells = [", ".join(part for part in (group, domain) if part)]
            for label in labels:
                values = ends_of(found.get(label, {}), domain).values()
                cells.append(f"{sum(values) / len(values):.0%}" if values else "-")
            for first, second in differences:
                gains = gains_of(found, first, second, domain)
                cells.append(points(mean_interval(gains)) if gains else "-")
            lines.append(row_of(cells))
        about = next(entry.values for entry in entries if entry.group == group)
        beside = [one for one in published if one.at.items() <= about.items()]
        lines += published_rows(beside, labels, len(differences))
    return "\n".join(lines) + "\n"


def published_rows(
    published: Iterable[Published], labels: Sequence[str], further: int
) -> list[str]:
    """Return a line of a table for each, with so many further columns."""
    return [
        row_of(
            [
                f"*{one.source}*",
                *(
                    f"*{one.success[n]:.0%}*" if n in one.success else ""
                    for n in labels
                ),
                *[""] * further,
            ]
        )
        for one in published
    ]


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
        row_of(["over the tables above, in", "rank correlation", "tables, seeds"]),
        "|---|---|---|",
    ]
    for prediction in predictions:
        groups = list(prediction_runs(entries, prediction).values())
        first, second = prediction.gain
        what = f"{first} - {second} against {prediction.falls_with}"
        lines.append(
            row_of(
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
        found = found_runs(entry for entry in entries if entry.group == group)
        third, first, second = (
            ends_of(found.get(label, {}), domain)
            for label in (prediction.falls_with, *prediction.gain)
        )
        seeds = [seed for seed in third if seed in first and seed in second]
        if seeds:
            gains = [first[seed] - second[seed] for seed in seeds]
            groups[group] = Runs([third[seed] for seed in seeds], gains)
    return groups


def _correlation(groups: Sequence[Runs]) -> str:
    if len(groups) < LEAST_GROUPS:
        return "missing"
    try:
        found = rank_correlation(groups)
    except ValueError:  # all alike
        return "none: all tables are equal"
    return f"{found.estimate:+.2f} [{found.low:+.2f}, {found.high:+.2f}]"


def cost_table(entries: Sequence[Entry]) -> str:
    """Return what the methods' jobs cost, means over seeds, in Markdown.

    Of several groups there is a line for each, and one for the mean over all jobs.
    """
    labels = labels_of(entries)
    groups = list(dict.fromkeys(entry.group for entry in entries))
    if len(groups) == 1:
        head = "| method | its job, minutes of a processor |"
        rows = [[label, _mean_minutes(entries, label)] for label in labels]
    else:
        head = row_of(["minutes of a processor, a job", *labels])
        of = {group: [e for e in entries if e.group == group] for group in groups}
        rows = [
            [name, *(_mean_minutes(mine, label) for label in labels)]
            for name, mine in (of | {"mean": list(entries)}).items()
        ]
    rule = "|" + "---|" * len(rows[0])
    return "\n".join(["", "## Cost", "", head, rule, *map(row_of, rows)]) + "\n"


def _mean_minutes(entries: Iterable[Entry], label: str) -> str:
    minutes = [e.minutes for e in entries if e.label == label and e.minutes]
    return f"{sum(minutes) / len(minutes):.1f}" if minutes else "missing"
