"""What a calibration fitted, and what was known before, for programs and for people."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import cast

import mujoco

from rlco.gap.calibrate.summary import Before, Summary
from rlco.gap.compare.verdict import NamedEffect
from rlco.gap.compare.wording import amount, in_words, number, title_of
from rlco.gap.report.report_json import effect_json
from rlco.reporting import html

_SHOWN = 12  # numbers in the page's table


def effects_json(
    found: Sequence[NamedEffect],
    beyond: Sequence[NamedEffect],
    model: mujoco.MjModel,
    known: mujoco.MjModel,
) -> dict[str, object]:
    """Return ``effects`` of ``report.json``, which tells what a calibration found.

    Args:
        found: By the search.
        beyond: By the calibration.
        model: The model without the calibration.
        known: The model with it.
    """
    rows = [effect_json(one, known) for one in found]
    rows += [effect_json(one, model) for one in beyond]
    marks = [one.calibrated for one in (*found, *beyond)]
    return {
        "effects": [
            row | {"calibrated": mark} for row, mark in zip(rows, marks, strict=True)
        ]
    }


def calibration_json(summary: Summary, model: mujoco.MjModel) -> dict[str, object]:
    """Return ``calibration`` of ``report.json``.

    Args:
        summary: The calibration.
        model: The model without it.
    """
    channels = zip(
        summary.channels,
        summary.units,
        summary.nominal,
        summary.calibrated,
        strict=True,
    )
    return {
        "channels": [
            {
                "name": name,
                "unit": unit,
                "nominal_rms": float(nominal),
                "calibrated_rms": float(calibrated),
            }
            for name, unit, nominal, calibrated in channels
        ],
        "numbers": summary.rows(model) or _numbers(summary.lacking, model),
    }


def _numbers(
    lacking: Sequence[NamedEffect], model: mujoco.MjModel
) -> list[dict[str, object]]:
    """Return the parameters of effects as rows of ``numbers``."""
    rows = []
    for one in lacking:
        found = effect_json(one, model)
        known = {"name": found["name"], "target": found["target"]}
        parameters = cast("dict[str, dict[str, object]]", found["parameters"])
        rows += [
            {**known, "parameter": name, **value} for name, value in parameters.items()
        ]
    return rows


def reference_json(summary: Summary, before: Before) -> dict[str, object]:
    """Return ``reference`` of ``report.json``: before, after, and the difference."""
    channels = zip(
        summary.channels,
        summary.units,
        summary.nominal,
        summary.calibrated,
        before.explained,
        before.unknown,
        before.after,
        before.changed,
        strict=True,
    )
    names = (
        "nominal_rms",
        "calibrated_rms",
        "explained_by_motion",
        "unknown",
        "difference_rms",
        "difference_left_rms",
    )
    return {
        "recordings": before.recordings,
        "seconds": before.seconds,
        "channels": [
            {"name": name, "unit": unit}
            | {key: float(value) for key, value in zip(names, values, strict=True)}
            for name, unit, *values in channels
        ],
    }


def reference_section(
    summary: Summary | None, before: Before | None, *, named: bool
) -> str:
    """Return before, after and the difference as HTML; empty without a reference."""
    if summary is None or before is None:
        return ""
    known = "calibrated" if summary.calibration is not None else "with what it lacked"
    head = ["", "before: model as it is", f"before: {known}", "what is not known"]
    head += ["after: difference to before"]
    head += ["left by what is named"] if named else []
    columns = (
        summary.nominal,
        summary.calibrated,
        before.unknown,
        before.after,
        before.changed,
    )
    rows = [
        [
            escape(name),
            *(escape(amount(float(column[i]), summary.units[i])) for column in columns),
        ][: len(head)]
        for i, name in enumerate(summary.channels)
    ]
    return (
        "<h2>Before, after, and the difference</h2>\n"
        + html.table(head, rows)
        + '<p class="quiet">Root mean squares. '
        + _of_before(summary, before)
        + " What is not known is what any difference is held against.</p>"
    )


def _of_before(summary: Summary, before: Before) -> str:
    """Return in a sentence what the recordings before were used for."""
    made = f"The recordings before ({before.recordings}, {before.seconds:.0f} s)"
    if summary.calibration is None:
        return f"{made} tell what the simulator lacks, which is taken as known."
    return (
        f"{made} calibrated the model; what it still lacks there is taken as known "
        "where the later motion is alike."
    )


def calibration_section(
    summary: Summary | None,
    beyond: Sequence[NamedEffect],
    model: mujoco.MjModel | None,
    *,
    sizes: bool,
) -> str:
    """Return the calibrated numbers as HTML; empty without a calibration.

    Args:
        summary: The calibration.
        beyond: What it found beyond what is usual.
        model: The model without it.
        sizes: Whether the disagreement without and with it is listed, too.
    """
    if summary is None or model is None:
        return ""
    if summary.calibration is None:
        return _lacking_section(summary, model)
    rows = []
    for row in summary.rows(model)[:_SHOWN]:
        unit = str(row["unit"])
        value, low, high = (_text(row[key]) for key in ("value", "low", "high"))
        mark = "beyond 95 %" if row["beyond_prior"] else ""
        rows.append(
            [
                escape(title_of(f"{row['name']} {row['target']}")),
                escape(in_words(str(row["parameter"]))),
                escape(f"{value} {unit}".strip()) + f"<br>{low} to {high}",
                f"{row['prior_deviations']:+.1f}",
                mark,
            ]
        )
    fitted = len(summary.calibration.amounts)
    count = "1 effect is" if len(beyond) == 1 else f"{len(beyond)} effects are"
    told = f"{count} listed above as found by it." if beyond else ""
    return (
        "<h2>Calibration</h2>\n"
        + (_sizes_table(summary) if sizes else "")
        + f"<p>{fitted} numbers that are always a little wrong were fitted under their "
        f"priors before the search. {escape(told)} The furthest from the model:</p>\n"
        + html.table(
            ["number", "", "fitted, 90 %", "standard deviations of its prior", ""], rows
        )
        + '<p class="quiet">Numbers of a link are relative to its own size; mass is '
        "half a logarithm. A number by itself may be undetermined where another makes "
        "up for it.</p>"
    )


def _sizes_table(summary: Summary) -> str:
    """Return each channel's disagreement without and with a calibration as HTML."""
    both = zip(summary.nominal, summary.calibrated, strict=True)
    rows = [
        [escape(name), *(escape(amount(float(size), unit)) for size in sizes)]
        for name, unit, sizes in zip(summary.channels, summary.units, both, strict=True)
    ]
    return html.table(["all recordings", "model as it is", "calibrated"], rows)


def _lacking_section(summary: Summary, model: mujoco.MjModel) -> str:
    """Return what a search named in recordings before as HTML."""
    rows = [
        [
            escape(title_of(f"{row['name']} {row['target'] or ''}".strip())),
            escape(in_words(str(row["parameter"]))),
            escape(f"{_text(row['value'])} {row['unit']}".strip())
            + f"<br>{_text(row['low'])} to {_text(row['high'])}",
        ]
        for row in _numbers(summary.lacking, model)
    ]
    heading = "<h2>What the simulator lacked before</h2>\n"
    if not rows:
        return heading + "<p>Nothing that the library could name.</p>\n"
    return (
        heading
        + "<p>Named in the recordings before by a search of its own, and taken as "
        "known in the later ones.</p>\n"
        + html.table(["effect", "", "fitted, 90 %"], rows)
    )


def _text(value: object) -> str:
    return number(float(str(value)))
