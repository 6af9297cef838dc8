"""Pieces of an HTML page: tables, lists, figures; all text is escaped."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape

from matplotlib.figure import Figure

from rlco.gap.figures import png
from rlco.gap.problem import Candidate
from rlco.gap.words import title
from rlco.physics.effects import AppliedEffect


def table(head: Iterable[str], rows: Iterable[Sequence[str]]) -> str:
    """Lay out rows of cells that are HTML already; the head is plain text."""
    top = "".join(f"<th>{escape(word)}</th>" for word in head)
    body = "\n".join(
        f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows
    )
    return (
        f"<table>\n<thead><tr>{top}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table>\n"
    )


def definitions(items: Iterable[tuple[str, str]]) -> str:
    """List words and what they mean."""
    pairs = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in items)
    return f"<dl>{pairs}</dl>"


def lines(words: Iterable[str]) -> str:
    """Lay out words as a list."""
    return f"<ul>{''.join(f'<li>{escape(word)}</li>' for word in words)}</ul>"


def paragraphs(words: Iterable[str]) -> str:
    """Lay out sentences as paragraphs, empty ones left out."""
    return "".join(f"<p>{escape(word)}</p>" for word in words if word)


def bar(share: float) -> str:
    """Draw a share as a bar."""
    part = f'<span class="part" style="width:{100 * share:.0f}%"></span>'
    return f'<div class="track">{part}</div>'


def image(figure: Figure) -> str:
    """Put a figure into the page."""
    alt = f"{figure.get_suptitle()}. {figure.get_label()}"
    data = base64.b64encode(png(figure)).decode()
    source = f"data:image/png;base64,{data}"
    return f'<figure><img src="{source}" alt="{escape(alt)}"></figure>'


def plain(value: object) -> str:
    """Write a value of any kind.

    Example:
        >>> plain(0.1234567), plain(True), plain([AppliedEffect("payload", "hand", {})])
        ('0.1235', 'yes', 'payload at hand')
    """
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, AppliedEffect | Candidate):
        return title(value)
    if isinstance(value, list | tuple):
        return ", ".join(map(plain, value)) or "nothing"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
