"""The commands that the documentation shows."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

from pages import DOCS

ROOT = DOCS.parent
_VARIABLES = r"(?:[A-Z_]+=\S+ )*"
_COMMAND = re.compile(
    rf"{_VARIABLES}(?:uv|rlco|pip|git|unzip|bash|lerobot-[a-z-]+) [^=]"
)


@dataclass(frozen=True)
class Command:
    """One command of a page.

    Attributes:
        page: The page's path from the project's root.
        text: The command in one line, without a trailing comment.
    """

    page: str
    text: str

    @property
    def words(self) -> list[str]:
        """What is run, without variables such as ``PYTHONPATH=.``, and its options."""
        words = shlex.split(self.text)
        while "=" in words[0]:
            words = words[1:]
        return words

    @property
    def recipe(self) -> str | None:
        """The name of the recipe that is run, if one is."""
        words = self.words
        if words[:2] == ["uv", "run"] and len(words) > 2:
            path = Path(words[2])
            shown = path.parts[0] == "recipes" and path.stem != "NAME"
            return path.stem if shown else None
        if words[0] == "rlco" and words[1] not in ("list", "copy", "info", "NAME"):
            return words[1]
        return None

    @property
    def options(self) -> list[str]:
        """The options that the recipe is given; dots stand for some of them."""
        after = self.words[3:] if self.words[0] == "uv" else self.words[2:]
        return [word for word in after if word != "..."]


def blocks(page: Path) -> list[list[Command]]:
    """Return a page's blocks of commands in their order; one in running text is one."""
    found = []
    pattern = re.compile(
        r"^```\w*\n(?P<block>.*?)^```|`(?P<span>[^`]+)`", re.DOTALL | re.MULTILINE
    )
    for match in pattern.finditer(page.read_text("utf-8")):
        block, span = match["block"], match["span"]
        if block is None:
            lines = [" ".join(span.split())]
        else:
            lines = re.sub(r"\\\n\s*", " ", block).splitlines()
        texts = [
            re.split(r"\s+# ", line.removeprefix("$ "))[0].strip() for line in lines
        ]
        name = str(page.relative_to(ROOT))
        shown = [Command(name, text) for text in texts if _COMMAND.match(text)]
        if shown:
            found.append(shown)
    return found


def all_blocks() -> list[list[Command]]:
    """Return the blocks of the README, the documentation and the guide for work."""
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.glob("*.md"))]
    return [block for page in pages for block in blocks(page)]
