"""The rows of a results.json: counts of successes, each field checked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rlco.files import Fields, read_json


def read_results(path: Path, *, of_recipe: bool = False) -> list[dict[str, Any]]:
    """Return the rows of a results.json.

    Args:
        path: The file.
        of_recipe: Whether a row must say all that rlco's recipes write.

    Raises:
        DataError: It is missing or damaged, or a row is no count of successes.
    """
    fields = read_json(path, advice="let the recipe write it again")
    return result_rows(fields, of_recipe=of_recipe)


def result_rows(fields: Fields, *, of_recipe: bool = False) -> list[dict[str, Any]]:
    """Return the rows of what holds results among other things, under ``rows``.

    Args:
        fields: What holds them.
        of_recipe: As in `read_results`.

    Raises:
        RlcoError: Of the fields' class, if a row is no count of successes.
    """
    rows = fields.groups("rows")
    for row in rows:
        _check(row)
        if of_recipe:
            row.text("policy")
            row.integer("seed")
            for name in ("task", "variation"):
                if name not in row.content:
                    raise row.refuse(name, "a text or null")
    return [dict(row.content) for row in rows]


def _check(row: Fields) -> None:
    for name in ("method", "domain"):
        row.text(name)
    for name in ("task", "policy", "variation"):
        row.text(name, None)
    for name in ("seed", "states_seed"):
        row.integer(name, 0)
    episodes = row.integer("episodes", minimum=1)
    row.integer("successes", minimum=0, maximum=episodes)
    for name in ("ever_successes", "lost"):
        row.integer(name, 0, minimum=0, maximum=episodes)
    for name in ("outcomes", "ever"):
        each = row.sequence(name, [0] * episodes)
        if len(each) != episodes or not all(one in (0, 1) for one in each):
            raise row.refuse(name, f"a list of {episodes} times 0 or 1")
    if "outcomes" in row.content:
        solved = sum(row.sequence("outcomes"))
        row.integer("successes", minimum=solved, maximum=solved)
