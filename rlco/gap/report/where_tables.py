"""Tables of where simulation and measurement disagree, as HTML."""

from __future__ import annotations

from html import escape

from rlco.gap.compare.wording import amount, number
from rlco.gap.diagnose.regimes import REGIMES
from rlco.gap.diagnose.where import EVERYWHERE, Cell, Where
from rlco.gap.report.verdict_text import place
from rlco.reporting.html import bar, definitions, table

_CELLS = 8


def cell_table(before: Where, when: str = "Before any fit") -> str:
    """Return the most informative cells as a table, best first.

    Args:
        before: Where simulation and measurement disagree.
        when: When that was computed, as a sentence begins.
    """
    units = dict(zip(before.channels, before.units, strict=True))
    rows = [
        [
            escape(place(cell)),
            f"{100 * cell.share:.0f} %{bar(cell.share)}",
            _percent(cell.time),
            escape(amount(cell.rms, units[cell.target])),
            number(cell.size),
        ]
        for cell in before.informative[:_CELLS]
    ]
    if not rows:
        return "<p>Nowhere above the noise.</p>"
    head = ["where", "share of the error", "of the data", "size", "times the noise"]
    return table(head, rows) + (
        f'<p class="quiet">{when}, over all recordings. Rows with much of the '
        "error in little of the time come first. Regimes overlap, so shares need not "
        "add up.</p>"
    )


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.005 else "< 1 %"


def contact_line(before: Where) -> str:
    """Return whether the motion before a contact is clean, where there is a contact."""
    if before.before_contact is None:
        return ""
    share, time = before.before_contact
    clean = "The motion before any contact is clean: " if share < 0.02 else ""
    share_text = f"{100 * share:.1f} % of the error lies before anything touches"
    return f"<p>{clean}{share_text}, in {100 * time:.0f} % of the data.</p>"


def regime_table(before: Where) -> str:
    """Return each channel's disagreement in each regime as a table."""
    cells = {(cell.target, cell.regime): cell for cell in before.cells}
    # Of a model that recorded the log itself nothing is left.
    largest = max(cell.size for cell in before.cells) or 1.0
    names = [EVERYWHERE, *REGIMES]
    names = [name for name in names if any(regime == name for _, regime in cells)]
    rows = [
        [
            escape(channel),
            *(_cell_text(cells.get((channel, name)), unit, largest) for name in names),
        ]
        for channel, unit in zip(before.channels, before.units, strict=True)
    ]
    meanings = definitions((n, REGIMES[n]) for n in names if n in REGIMES)
    return (
        "<details><summary>Each joint in each regime</summary>\n"
        f'<div class="wide">{table(["", *names], rows)}</div>{meanings}</details>'
    )


def _cell_text(cell: Cell | None, unit: str, largest: float) -> str:
    if cell is None:
        return ""
    depth = 70.0 * cell.size / largest
    return (
        f'<span class="heat" style="--depth:{depth:.0f}%">'
        f"{escape(amount(cell.rms, unit))}</span>"
    )
