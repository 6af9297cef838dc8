"""The tags of a model's text, as MuJoCo's reader of XML sees them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html import unescape
from typing import NamedTuple

#: What a text consists of beside words, whatever begins first: what looks like a
#: comment within an attribute or within CDATA is none, and the other way round.
_TOKEN = re.compile(
    r"<!--.*?(?:-->|\Z)|<!\[CDATA\[.*?(?:\]\]>|\Z)|<\?.*?(?:\?>|\Z)"
    r"|<(?P<closes>/?)(?P<name>[^\s/>!?<]+)"
    r"(?P<rest>(?:[^>\"']|\"[^\"]*\"|'[^']*')*+)>",
    re.DOTALL,
)
_ATTRIBUTE = re.compile(r"([^\s=/\"']+)\s*=\s*(\"[^\"]*\"|'[^']*')")


class Tag(NamedTuple):
    """One tag.

    Attributes:
        closes: Whether it ends an element.
        name: Of the element.
        given: Its attributes.
        empty: Whether nothing is in the element.
    """

    closes: bool
    name: str
    given: dict[str, str]
    empty: bool


def tags(source: str) -> Iterator[Tag]:
    """Yield each tag of a text.

    Example:
        >>> [tag.name for tag in tags("<a b='<!--'/><c/><!-- <d/> -->")]
        ['a', 'c']
    """
    for token in _TOKEN.finditer(source):
        if token["name"] is None:
            continue
        given = {
            key: unescape(value[1:-1]).replace("\\", "/")
            for key, value in _ATTRIBUTE.findall(token["rest"])
        }
        empty = token["rest"].rstrip().endswith("/")
        yield Tag(bool(token["closes"]), token["name"], given, empty)


def is_understood(source: str) -> bool:
    """Return whether every ``<`` of a text belongs to what was recognised.

    Example:
        >>> is_understood("<a><b/></a>"), is_understood("<a b='/>")
        (True, False)
    """
    return "<" not in _TOKEN.sub("", source)
