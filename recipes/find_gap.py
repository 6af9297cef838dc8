"""Find where a simulated robot and its recordings disagree, name it, and mend it.

    uv run recipes/find_gap.py model=arm.xml data=logs out=gap_report
    uv run recipes/find_gap.py model=arm.xml data=run.csv angles=degrees out=report
    uv run recipes/find_gap.py model=arm.xml data=logs rename=j1:joint1,j2:joint2 out=r

Into `out` it writes report.html for people, report.json for programs, model.xml and
model.diff with what was found in the model, and effects.yaml for `make_env(effects=)`.
Ctrl-C ends the search and writes the best so far.
"""

from __future__ import annotations

import logging
import runpy
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Literal

from rlco.config import REQUIRED, option
from rlco.errors import RlcoError
from rlco.options import rename_map
from rlco.run import run_recipe

if TYPE_CHECKING:
    from rlco.gap.model import LoadedModel
    from rlco.gap.problem import Problem, Verdict
    from rlco.gap.where import Where

log = logging.getLogger("rlco.find_gap")

_WRITING = 60.0  # [s] after a Ctrl-C in which the next ones are not heeded


@dataclass
class Config:
    """Options of find_gap.py."""

    model: str = option(REQUIRED, "MJCF file, or robosuite:TASK")
    data: str = option(REQUIRED, "recordings: LeRobot folder, CSV, NPZ, rosbag2, JSON")
    out: str = option(REQUIRED, "new folder for the report")
    rename: str = option("", "names in the data: THEIRS:OURS,THEIRS:OURS")
    angles: Literal["degrees", "radians"] | None = option(
        None, "unit of angles in the data; null: told from their size"
    )
    effects: str | None = option(None, "Python file that registers effects of your own")
    spread: float = option(
        0.03, "how far off any number of the model may be", minimum=0, maximum=0.5
    )
    threads: int = option(2, "simulations at a time", minimum=1)


def main(config: Config) -> None:
    """Read, compare, search, write."""
    from rlco.gap.logs import read_log
    from rlco.gap.make_problem import make_problem
    from rlco.gap.model import load_model

    refuse_existing(config.out)
    if config.effects:
        register_effects(config.effects)
    loaded = load_model(config.model)
    recordings = read_log(
        config.data, loaded, rename=rename_map(config.rename), angles=config.angles
    )
    for note in recordings.notes:
        log.info("note: %s", note)
    problem = make_problem(loaded, recordings, threads=config.threads)
    out = new_folder(config.out)
    try:
        with one_interrupt():
            complete = find_and_write(config, loaded, problem, out)
    finally:
        if not any(out.iterdir()):
            out.rmdir()  # nothing was found yet, so the same command may run again
    if not complete:
        raise KeyboardInterrupt


def find_and_write(
    config: Config, loaded: LoadedModel, problem: Problem, out: Path
) -> bool:
    """Search, write everything into `out`; return whether the search was complete."""
    from rlco.gap.mend import write_mend
    from rlco.gap.record_next import recommend
    from rlco.gap.regimes import label_regimes
    from rlco.gap.report_html import Page, page
    from rlco.gap.report_json import report
    from rlco.gap.where import where
    from rlco.run_folder import command_line, write_json, write_text

    labels = label_regimes(problem)
    before = where(problem, labels=labels)
    say_where(before)
    verdict = search(problem, config)
    # First what programs read: nothing that goes wrong later can take it away.
    write_json(out / "report.json", report(verdict, before, problem.model))
    say_verdict(verdict, before)
    write_mend(loaded, verdict, out)
    motions = recommend(problem, verdict) if verdict.complete else []
    following = [motion.save(out) for motion in motions]
    write_json(out / "report.json", report(verdict, before, problem.model, following))
    source = Page(problem, verdict, before, labels, following, command_line(), FILES)
    write_text(out / "report.html", page(source))
    log.info("report: %s", out / "report.html")
    return verdict.complete


FILES = {
    "report.json": "the verdict for programs",
    "model.xml": "the model with the effects in it that MJCF can hold",
    "model.diff": "what changed in it",
    "effects.yaml": "all effects, for make_env(effects=) and its training",
}


def search(problem: Problem, config: Config) -> Verdict:
    """Search with a progress bar."""
    from tqdm import tqdm

    from rlco.gap.find_gap import find_gap
    from rlco.gap.nothing_yet import nothing_yet

    bar_format = "{desc} {percentage:3.0f}% |{bar}| {elapsed} {postfix}"
    with tqdm(total=100, desc="search", bar_format=bar_format, disable=None) as bar:

        def on_step(said: str, part: float) -> None:
            bar.n = min(100, round(100 * part))
            bar.set_postfix_str(said)

        try:
            return find_gap(problem, spread=config.spread, on_step=on_step)
        except KeyboardInterrupt:  # so early that it had nothing to give back
            return nothing_yet(problem)


def say_where(before: Where) -> None:
    """Print where the model as it is disagrees most."""
    from rlco.gap.words import amount, place

    units = dict(zip(before.channels, before.units, strict=True))
    cells = before.telling[:4]
    log.info("before any fit, the disagreement is" if cells else "no disagreement")
    for cell in cells:
        size = amount(cell.rms, units[cell.target])
        log.info("  %3.0f %% in %s (%s)", 100 * cell.share, place(cell), size)


def say_verdict(verdict: Verdict, before: Where) -> None:
    """Print the verdict in a few lines."""
    from rlco.gap.words import certainty, headline, numbers_of, title

    log.info("%s: %s", verdict.verdict, headline(verdict, before))
    for finding in verdict.effects:
        for name, value, ends in numbers_of(finding):
            log.info("  %s: %s %s (%s)", title(finding), name, value, ends)
    for line in certainty(verdict):
        log.info("  %s", line)


def register_effects(path: str) -> None:
    """Run a Python file that registers effects."""
    from rlco.physics.effects import EFFECTS

    if not Path(path).is_file():
        raise RlcoError(f"effects={path!r} is no file; give a Python file.")
    known = len(EFFECTS)
    runpy.run_path(path)
    if len(EFFECTS) == known:
        raise RlcoError(f"effects={path!r} registers no effect; call register(Effect).")


def refuse_existing(out: str) -> None:
    """Refuse to overwrite."""
    if Path(out).exists():
        raise RlcoError(
            f"output folder {out!r} exists and is not overwritten; give another "
            "out=DIR."
        )


def new_folder(out: str) -> Path:
    """Make the output folder."""
    refuse_existing(out)
    try:
        Path(out).mkdir(parents=True)
    except OSError as error:
        raise RlcoError(
            f"output folder {out!r} cannot be made ({error.strerror}); give another "
            "out=DIR."
        ) from error
    return Path(out)


@contextmanager
def one_interrupt() -> Iterator[None]:
    """Let a Ctrl-C end the search, and the next ones not the writing."""
    last = [-_WRITING]

    def handle(_number: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        if now - last[0] < _WRITING:
            log.info("writing the best so far, it takes some seconds")
            return
        last[0] = now
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


if __name__ == "__main__":
    run_recipe(main, Config)
