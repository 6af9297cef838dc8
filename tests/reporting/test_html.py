"""Pieces of an HTML page: nothing that came from a file becomes markup."""

from __future__ import annotations

import base64

from rlco.reporting import html

_BAD = "<b>&\"'"
_ESCAPED = "&lt;b&gt;&amp;&quot;&#x27;"


def test_plain_text_is_escaped_everywhere() -> None:
    pieces = [
        html.page(_BAD, ""),
        html.table([_BAD], []),
        html.definitions([(_BAD, _BAD)]),
        html.bullets([_BAD]),
        html.paragraphs([_BAD]),
        html.figure(b"", _BAD, _BAD),
    ]
    for piece in pieces:
        assert _ESCAPED in piece
        assert _BAD not in piece


def test_cells_and_bodies_are_markup_already() -> None:
    assert "<td><b>1</b></td>" in html.table(["x"], [["<b>1</b>"]])
    assert "<main>\n<h1>x</h1>\n</main>" in html.page("x", "<h1>x</h1>")


def test_a_page_holds_its_style_and_that_of_all_reports() -> None:
    style = html.page("x", "", style=".own { color: red }").split("<style>")[1]
    assert ".own { color: red }" in style.split("</style>")[0]
    assert ".kicker" in style.split("</style>")[0]


def test_a_figure_is_the_very_file() -> None:
    text = html.figure(b"\x89PNG", "alt")
    data = text.split("data:image/png;base64,")[1].split('"')[0]
    assert base64.b64decode(data) == b"\x89PNG"
    assert "figcaption" not in text
