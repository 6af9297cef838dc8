"""Whether one policy is better than another, from two evaluations of the same starts.

    uv run recipes/compare_results.py a=outputs/evaluate/ONE b=outputs/evaluate/OTHER
    uv run recipes/compare_results.py a=RUN b=RUN method_a=rl_co method_b=sft
    uv run recipes/compare_results.py a=outputs/eval/one b=outputs/eval/other

Reads results.json of rlco and eval_info.json of lerobot-eval. Nothing is simulated.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

from rlco.errors import printable
from rlco.run import run_recipe
from rlco.runs.config import REQUIRED, option
from rlco.runs.whole_files import check_new_folder, whole_folder, write_json, write_text

log = logging.getLogger("rlco.compare_results")


@dataclass
class Config:
    """Options of compare_results.py."""

    a: str = option(REQUIRED, "folder of an evaluation, or its file")
    b: str = option(REQUIRED, "the other")
    method_a: str | None = option(
        None, "which method of a, where it has several; null: its only one"
    )
    method_b: str | None = option(None, "the same of b")
    out: str | None = option(None, "new folder for table and numbers; null: none")


def main(config: Config) -> None:
    """Print the comparison."""
    from rlco.reporting.paired_results import compare, notes, read_evaluation, table

    if config.out is not None:
        check_new_folder(Path(config.out))
    files = [read_evaluation(Path(given)) for given in (config.a, config.b)]
    first = files[0].of(config.method_a, "method_a")
    second = files[1].of(config.method_b, "method_b")
    names = [first[0]["method"], second[0]["method"]]
    if names[0] == names[1]:
        names = [f"{names[0]} (a)", f"{names[1]} (b)"]
    found = compare(first, second)
    said = notes(found, *files)
    text = table(found, *names)
    print(printable(text))
    for note in said:
        log.info("%s", note)
    if config.out is not None:
        rows = [one._asdict() for one in found]
        numbers = {"a": names[0], "b": names[1], "notes": said, "rows": rows}
        with whole_folder(config.out) as part:
            write_text(part / "table.md", text + "\n")
            write_json(part / "comparison.json", numbers)


if __name__ == "__main__":
    run_recipe(main, Config, loads="rlco.run")
