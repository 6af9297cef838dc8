"""The tables of a report: success by method and place, and paired differences."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from rlco.reporting.differences import (
    Column,
    Difference,
    cell,
    columns,
    last_differences,
)
from rlco.reporting.plot_style import styles
from rlco.reporting.statistics import Interval, ResultRow, rate_interval


def success_table(rows: Sequence[ResultRow]) -> str:
    """Return success at the end, at some time and lost again, methods by columns."""
    if not rows:
        return ""
    lines = {
        method: [_success(cell(rows, method, column)) for column in columns(rows)]
        for method in styles(row["method"] for row in rows)
    }
    several = len({row["seed"] for row in rows}) > 1
    kind = "t intervals of the mean over seeds" if several else "Wilson intervals"
    note = f"Success at the end of an episode, with 95 % {kind}."
    if any("ever" in row for row in rows):
        note += (
            " Ever: solved after some decision. Lost again: ever solved, but not at "
            "the end; a method can gain by keeping still as well as by reaching more."
        )
    return f"<h2>Success</h2>\n{_table('method', columns(rows), lines, note)}"


def difference_table(rows: Sequence[ResultRow]) -> str:
    """Return the last method's paired differences from the others, by columns."""
    differences = last_differences(rows)
    if not differences:
        return ""
    places = list(dict.fromkeys(one.column for one in differences))
    lines = {
        f"{first} minus {second}": [
            _difference([d for d in differences if (d.second, d.column) == (second, c)])
            for c in places
        ]
        for first, second in dict.fromkeys((d.first, d.second) for d in differences)
    }
    note = (
        "Success at the end, paired over the same initial states, with 95 % intervals: "
        "of one seed Newcombe's, which holds for these two policies; of several "
        "Student's t over the seeds' differences. An interval that contains 0 does not "
        "separate two methods."
    )
    return f"<h2>Differences</h2>\n{_table('difference', places, lines, note)}"


def percent(rate: float) -> str:
    """Return a rate as a whole percentage."""
    return f"{100 * rate:.0f} %"


def _table(
    corner: str, places: Sequence[Column], lines: dict[str, list[str]], note: str
) -> str:
    head = "".join(f"<th>{_title(*place)}</th>" for place in places)
    body = "\n".join(
        f"<tr><th>{escape(name)}</th>{''.join(cells)}</tr>"
        for name, cells in lines.items()
    )
    return (
        f"<table>\n<thead><tr><th>{corner}</th>{head}</tr></thead>\n"
        f'<tbody>\n{body}\n</tbody>\n</table>\n<p class="quiet">{note}</p>'
    )


def _title(task: str, domain: str, variation: str | None) -> str:
    return escape(f"{task} in {domain}" + (f", {variation}" if variation else ""))


def _success(rows: Sequence[ResultRow]) -> str:
    if not rows:
        return "<td>not tried</td>"
    interval = rate_interval(rows)
    episodes = sum(row["episodes"] for row in rows)
    count = f"{sum(row['successes'] for row in rows)} of {episodes}"
    if len(rows) > 1:
        count += f", {len(rows)} seeds"
    return (
        f'<td><span class="rate">{percent(interval.estimate)}</span> '
        f'<span class="interval">{_reach(interval)} · {count}</span>'
        f"{_track(interval)}{_ever(rows)}</td>"
    )


def _ever(rows: Sequence[ResultRow]) -> str:
    """Return the means over the rows of what was ever solved, and lost again."""
    if not all("ever_successes" in row and "lost" in row for row in rows):
        return ""
    ever = sum(row["ever_successes"] / row["episodes"] for row in rows) / len(rows)
    lost = sum(row["lost"] / row["episodes"] for row in rows) / len(rows)
    text = f"ever {percent(ever)} · lost again {percent(lost)}"
    return f'<span class="interval">{text}</span>'


def _difference(found: Sequence[Difference]) -> str:
    if not found:
        return "<td>not tried</td>"
    (one,) = found
    estimate, low, high = (100 * value for value in one.interval)
    reach = "no interval" if math.isnan(low) else f"{low:+.0f} to {high:+.0f}"
    count = f"{one.seeds} seeds" if one.seeds > 1 else f"{one.episodes} states"
    return (
        f'<td><span class="rate">{estimate:+.0f} points</span> '
        f'<span class="interval">{reach} · {count}</span></td>'
    )


def _reach(interval: Interval) -> str:
    if math.isnan(interval.low):
        return "no interval"
    low, high = max(interval.low, 0), min(interval.high, 1)
    return f"{100 * low:.0f} to {100 * high:.0f} %"


def _track(interval: Interval) -> str:
    """Return a bar from 0 to 100 % with the interval."""
    point = f'<span class="point" style="left:{100 * interval.estimate:.1f}%"></span>'
    if math.isnan(interval.low):
        return f'<div class="track">{point}</div>'
    low, high = max(interval.low, 0), min(interval.high, 1)
    place = f"left:{100 * low:.1f}%;width:{100 * (high - low):.1f}%"
    return (
        f'<div class="track"><span class="range" style="{place}"></span>{point}</div>'
    )
