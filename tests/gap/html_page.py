"""An HTML page as a reader would check it: text, headline, addresses."""

from __future__ import annotations

from html.parser import HTMLParser


class Read(HTMLParser):
    """Collects the text, the first headline and the addresses of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.words: list[str] = []
        self.first: list[str] = []
        self.addresses: list[str] = []
        self.alts: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        given = dict(attrs)
        self.addresses += [str(given[n]) for n in ("src", "href") if n in given]
        self.alts += [str(given["alt"])] if "alt" in given else []

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.words += data.split()
        if "h1" in self.open:
            self.first += data.split()

    @property
    def text(self) -> str:
        return " ".join(self.words)
