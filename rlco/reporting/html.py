"""Pieces of an HTML page that needs nothing but itself; all text is escaped."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files


def page(title: str, body: str, *, style: str = "") -> str:
    """Return a whole page.

    Args:
        title: Its title, plain text.
        body: What it shows, as HTML.
        style: CSS beside that of all reports.
    """
    common = (files("rlco") / "reporting" / "report.css").read_text("utf-8")
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{common}{style}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


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
    """List words and what they mean.

    Example:
        >>> definitions([("speed", "> 1 m/s")])
        '<dl><dt>speed</dt><dd>&gt; 1 m/s</dd></dl>'
    """
    pairs = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in items)
    return f"<dl>{pairs}</dl>"


def bullets(words: Iterable[str]) -> str:
    """Lay out words as a list."""
    return f"<ul>{''.join(f'<li>{escape(word)}</li>' for word in words)}</ul>"


def paragraphs(words: Iterable[str]) -> str:
    """Lay out sentences as paragraphs, empty ones left out."""
    return "".join(f"<p>{escape(word)}</p>" for word in words if word)


def bar(share: float) -> str:
    """Draw a share as a bar."""
    part = f'<span class="part" style="width:{100 * share:.0f}%"></span>'
    return f'<div class="track">{part}</div>'


def figure(png: bytes, alt: str, caption: str = "") -> str:
    """Put a PNG into the page.

    Args:
        png: The file's content.
        alt: What it shows, for those who do not see it.
        caption: Text below it.
    """
    below = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    source = data_address(png, "image/png")
    return f'<figure><img src="{source}" alt="{escape(alt)}">{below}</figure>'


def data_address(content: bytes, kind: str) -> str:
    """Return an address that holds a file's content, of a kind such as image/png."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
