"""Tables of where simulation and measurement disagree, as HTML."""

from __future__ import annotations

from html import escape

from rlco.gap.html_parts import bar, definitions, table
from rlco.gap.regimes import REGIMES
from rlco.gap.where import EVERYWHERE, Cell, Where
from rlco.gap.words import amount, place

_CELLS = 8


def cell_table(before: Where) -> str:
    """Rank where the disagreement is."""
    units = dict(zip(before.channels, before.units, strict=True))
    rows = [
        [
            escape(place(cell)),
            f"{100 * cell.share:.0f} %{bar(cell.share)}",
            f"{100 * cell.time:.0f} %",
            escape(amount(cell.rms, units[cell.target])),
            f"{cell.size:.1f}",
        ]
        for cell in before.telling[:_CELLS]
    ]
    if not rows:
        return "<p>Nowhere above the noise.</p>"
    head = ["where", "share of the error", "of the data", "size", "times the noise"]
    return table(head, rows) + (
        '<p class="quiet">Before any fit, over all recordings. First what holds much '
        "of the error in little of the time. Regimes overlap, so shares need not add "
        "up.</p>"
    )


def contact_line(before: Where) -> str:
    """Say whether the flight before a contact is clean, where there is one."""
    if before.before_contact is None:
        return ""
    share, time = before.before_contact
    clean = "The motion before any contact is clean: " if share < 0.02 else ""
    told = f"{100 * share:.1f} % of the error lies before anything touches"
    return f"<p>{clean}{told}, in {100 * time:.0f} % of the data.</p>"


def regime_table(before: Where) -> str:
    """Lay out each channel's disagreement in each regime."""
    cells = {(cell.target, cell.regime): cell for cell in before.cells}
    largest = max(cell.size for cell in before.cells)
    seen = [EVERYWHERE, *REGIMES]
    seen = [name for name in seen if any(regime == name for _, regime in cells)]
    rows = [
        [
            escape(channel),
            *(_cell_text(cells.get((channel, name)), unit, largest) for name in seen),
        ]
        for channel, unit in zip(before.channels, before.units, strict=True)
    ]
    meanings = definitions((n, REGIMES[n]) for n in seen if n in REGIMES)
    return (
        "<details><summary>Each joint in each regime</summary>\n"
        f'<div class="wide">{table(["", *seen], rows)}</div>{meanings}</details>'
    )


def _cell_text(cell: Cell | None, unit: str, largest: float) -> str:
    if cell is None:
        return ""
    depth = 70.0 * cell.size / largest
    return (
        f'<span class="heat" style="--depth:{depth:.0f}%">'
        f"{escape(amount(cell.rms, unit))}</span>"
    )
