"""Edit an XML file as text, so that the rest of it stays as its author wrote it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from xml.parsers import expat


@dataclass
class Element:
    """An element and its position in the file's bytes.

    Attributes:
        tag: Its tag.
        start: Start of its start tag.
        stop: End of its start tag.
        end: Start of its end tag; equal to `stop` where it has none.
        attributes: As written.
        children: In the file's order.
    """

    tag: str
    start: int
    stop: int
    end: int
    attributes: Mapping[str, str]
    children: list[Element] = field(default_factory=list)

    def of(self, *tags: str) -> Iterator[Element]:
        """Yield the children with one of these tags, including those within frames."""
        for child in self.children:
            if child.tag in tags:
                yield child
            elif child.tag == "frame":
                yield from child.of(*tags)


def parse(text: str) -> Element:
    """Return the root of an XML text.

    Raises:
        xml.parsers.expat.ExpatError: If the text is not XML.

    Example:
        >>> root = parse("<a x='1'><b/></a>")
        >>> root.tag, root.children[0].start
        ('a', 9)
    """
    raw = text.encode()
    parser = expat.ParserCreate("utf-8")
    open_ones: list[Element] = []
    roots: list[Element] = []

    def begin(tag: str, attributes: dict[str, str]) -> None:
        start = parser.CurrentByteIndex
        stop = _end_of_tag(raw, start)
        element = Element(tag, start, stop, stop, attributes)
        (open_ones[-1].children if open_ones else roots).append(element)
        open_ones.append(element)

    def finish(tag: str) -> None:
        element = open_ones.pop()
        if not raw[: element.stop].endswith(b"/>"):
            element.end = parser.CurrentByteIndex

    parser.StartElementHandler = begin
    parser.EndElementHandler = finish
    parser.Parse(raw, True)
    return roots[0]


class Editor:
    r"""Collect changes of an XML text, and apply them all at once.

    Args:
        text: The text.

    Example:
        >>> editor = Editor("<a>\n  <b x='1'/>\n</a>")
        >>> editor.set(editor.root.children[0], {"x": "2", "y": "3"})
        >>> editor.append(editor.root, "<c/>")
        >>> print(editor.result())
        <a>
          <b x='2' y="3"/>
          <c/>
        </a>
    """

    def __init__(self, text: str) -> None:
        self._raw = text.encode()
        self.root = parse(text)
        self._attributes: dict[int, tuple[Element, str, dict[str, str | None]]] = {}
        self._inserted: dict[int, tuple[Element, list[str]]] = {}

    def set(
        self,
        element: Element,
        attributes: Mapping[str, str | None],
        tag: str | None = None,
    ) -> None:
        """Set attributes of an element; None removes one, and `tag` renames it."""
        known = self._attributes.setdefault(element.start, (element, element.tag, {}))
        changes = {**known[2], **attributes}
        self._attributes[element.start] = (element, tag or known[1], changes)

    def append(self, element: Element, child: str) -> None:
        """Add text as the last child of an element."""
        self._inserted.setdefault(element.start, (element, []))[1].append(child)

    def result(self) -> str:
        """Return the text with all changes applied."""
        pieces: list[tuple[int, int, str]] = []
        for start in self._attributes.keys() | self._inserted.keys():
            pieces += self._pieces(start)
        raw = self._raw
        for start, stop, text in sorted(pieces, reverse=True):
            raw = raw[:start] + text.encode() + raw[stop:]
        return raw.decode()

    def _pieces(self, start: int) -> list[tuple[int, int, str]]:
        """Return the replacements of byte ranges for one element."""
        element = (self._attributes.get(start) or self._inserted[start])[0]
        written = self._raw[element.start : element.stop].decode()
        tag, changes = element.tag, dict[str, str | None]()
        if start in self._attributes:
            _, tag, changes = self._attributes[start]
        for name, value in changes.items():
            written = _with_attribute(written, name, value)
        written = re.sub(rf"^<{re.escape(element.tag)}", f"<{tag}", written)
        children = self._inserted.get(start, (element, []))[1]
        if element.end == element.stop:
            if not children:
                return [(element.start, element.stop, written)]
            opened = re.sub(r"\s*/>$", ">", written)
            inner = "".join(f"\n{self._inner(element)}{c}" for c in children)
            text = f"{opened}{inner}\n{self._indent(element.start)}</{tag}>"
            return [(element.start, element.stop, text)]
        pieces = [(element.start, element.stop, written)]
        closing = self._raw.index(b">", element.end) + 1
        if tag != element.tag:
            pieces.append((element.end, closing, f"</{tag}>"))
        if children:
            pieces.append(self._before_end(element, children))
        return pieces

    def _before_end(
        self, element: Element, children: list[str]
    ) -> tuple[int, int, str]:
        line = self._raw.rfind(b"\n", 0, element.end) + 1
        inner = self._inner(element)
        if not self._raw[line : element.end].strip():
            return line, line, "".join(f"{inner}{child}\n" for child in children)
        lines = "".join(f"\n{inner}{child}" for child in children)
        text = f"{lines}\n{self._indent(element.start)}"
        return element.end, element.end, text

    def _inner(self, element: Element) -> str:
        if element.children:
            first = element.children[0].start
            line = self._raw.rfind(b"\n", 0, first) + 1
            if line > element.start and not self._raw[line:first].strip():
                return self._raw[line:first].decode()
        return self._indent(element.start) + "  "

    def _indent(self, start: int) -> str:
        line = self._raw.rfind(b"\n", 0, start) + 1
        before = self._raw[line:start].decode()
        return before[: len(before) - len(before.lstrip())]


def _end_of_tag(raw: bytes, start: int) -> int:
    quote = 0
    for place in range(start, len(raw)):
        letter = raw[place]
        if quote:
            quote = 0 if letter == quote else quote
        elif letter in b"\"'":
            quote = letter
        elif letter == ord(">"):
            return place + 1
    return len(raw)


def _with_attribute(tag: str, name: str, value: str | None) -> str:
    pattern = re.compile(rf"(\s{re.escape(name)}\s*=\s*)(\"[^\"]*\"|'[^']*')")
    found = pattern.search(tag)
    if found:
        if value is None:
            return tag[: found.start()] + tag[found.end() :]
        quote = found[2][0]
        new = f"{found[1]}{quote}{value}{quote}"
        return tag[: found.start()] + new + tag[found.end() :]
    if value is None:
        return tag
    close = re.search(r"\s*/?>$", tag)
    at = close.start() if close else len(tag)
    return f'{tag[:at]} {name}="{value}"{tag[at:]}'
