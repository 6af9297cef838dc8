"""Means of an experiment's methods over its groups, each group counted alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rlco.reporting.experiments.comparison import points, published_rows, row_of, share
from rlco.reporting.experiments.entries import (
    Entry,
    domains_of,
    ends_of,
    found_runs,
    gains_of,
    group_name,
    labels_of,
)
from rlco.reporting.statistics import mean_of_means
from rlco.runs.compare.experiment import Published


def mean_table(
    entries: Sequence[Entry],
    differences: Sequence[tuple[str, str]],
    over: Sequence[str],
    published: Sequence[Published] = (),
) -> str:
    """Return methods' and differences' means over some of the groups' variables.

    A line for all values of the others, and every domain, in Markdown. Each group
    counts alike, whatever its seeds: `mean_of_means`. What not all groups of a line
    have is missing there.

    Args:
        entries: Of all groups.
        differences: Pairs of methods, first minus second, paired by seed.
        over: Variables of the groups that the means are over.
        published: What others reported as a mean.

    Raises:
        DataError: A method has several results in one domain.
    """
    labels = labels_of(entries)
    title = f"mean over {', '.join(over)}, in"
    head = [title, *labels, *(f"{a} - {b}" for a, b in differences), "tables"]
    lines = ["\n## Mean\n", row_of(head), "|---" * len(head) + "|"]
    kept: dict[str, dict[str, Any]] = {}
    for entry in entries:
        values = {n: value for n, value in entry.values.items() if n not in over}
        kept.setdefault(group_name(values), values)
    for name, values in kept.items():
        mine = [e for e in entries if values.items() <= e.values.items()]
        groups = [
            found_runs(entry for entry in mine if entry.group == group)
            for group in dict.fromkeys(entry.group for entry in mine)
        ]
        for domain in dict.fromkeys(d for found in groups for d in domains_of(found)):
            cells = [", ".join(part for part in (name, domain) if part)]
            for label in labels:
                rates = [
                    list(ends_of(g.get(label, {}), domain).values()) for g in groups
                ]
                cells.append(share(mean_of_means(rates)) if all(rates) else "missing")
            for first, second in differences:
                gains = [gains_of(g, first, second, domain) for g in groups]
                cells.append(points(mean_of_means(gains)) if all(gains) else "missing")
            lines.append(row_of([*cells, str(len(groups))]))
        beside = [one for one in published if one.at.items() <= values.items()]
        lines += published_rows(beside, labels, len(differences) + 1)
    return "\n".join(lines) + "\n"
