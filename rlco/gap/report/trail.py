"""What a search tried, step by step, as a table in the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from rlco.errors import counted
from rlco.gap.compare.wording import in_words, plain
from rlco.reporting import html

_MEANING = (
    "Error: the residual in held-out recordings, as a multiple of the noise and of "
    "what the model's tolerance explains; at 1 nothing else is left. Gain: the "
    "fraction by which the error falls against the best attempt until then."
)


def trail_section(trail: Sequence[Mapping[str, object]]) -> str:
    """Return the steps of a search as HTML; empty without any."""
    if not trail:
        return ""
    head = list(dict.fromkeys(key for row in trail for key in row))
    rows = [[escape(plain(row.get(key, ""))) for key in head] for row in trail]
    steps = counted(len(rows), "step")
    meaning = f'<p class="quiet">{escape(_MEANING)}</p>' if "gain" in head else ""
    return (
        "<h2>What was tried</h2>\n<details><summary>"
        f'{steps} of the search</summary>{meaning}<div class="wide">'
        f"{html.table([in_words(key) for key in head], rows)}</div></details>"
    )
