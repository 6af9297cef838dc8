"""Find where a simulated robot and its recordings disagree, name it, and correct it.

    uv run recipes/find_gap.py model=arm.xml data=logs out=gap_report
    uv run recipes/find_gap.py model=arm.xml data=run.csv angles=degrees out=report
    uv run recipes/find_gap.py model=arm.xml data=logs rename=j1:joint1,j2:joint2 out=r
    uv run recipes/find_gap.py model=arm.xml data=new check=gap/effects.yaml out=check
    uv run recipes/find_gap.py model=bam:xl330 data=bam_logs out=servo_report
    uv run recipes/find_gap.py model=arm.xml reference=before data=after out=changed

Into `out` it writes report.html for people, report.json for programs, model.xml and
model.diff with what was found in the model, and effects.yaml, a domain for
`make_env(domain=)` and the other recipes.
Ctrl-C ends the search and writes the best so far.
"""

from __future__ import annotations

import logging
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Literal

from rlco.errors import ConfigError, RlcoError
from rlco.run import run_recipe
from rlco.runs.config import REQUIRED, option
from rlco.runs.options import rename_map, scale_map
from rlco.runs.run_folder import command_line
from rlco.runs.whole_files import check_new_folder, write_json

log = logging.getLogger("rlco.find_gap")

_SILENT = 30.0  # [s] at most without a word where no bar is shown
_WRITING = 60.0  # [s] after a Ctrl-C in which the next ones are not heeded


@dataclass
class Config:
    """Options of find_gap.py."""

    model: str = option(REQUIRED, "MJCF or URDF file, robosuite:TASK, or bam:SERVO")
    data: str = option(REQUIRED, "recordings: LeRobot, CSV, NPZ, rosbag2, JSON")
    out: str = option(REQUIRED, "new folder for the report")
    rename: str = option("", "names in the data: THEIRS:OURS,THEIRS:OURS")
    scale: str = option(
        "", "factors of columns in the data, of currents say: THEIRS:NUMBER,..."
    )
    angles: Literal["degrees", "radians"] | None = option(
        None, "unit of angles in the data; null: inferred from their size"
    )
    compare: Literal["positions", "torques", "both"] | None = option(
        None,
        "what is compared: positions under commands, torques, or both, each with a "
        "search of its own; null: positions where there are commands, and torques as a "
        "check",
    )
    reference: str | None = option(
        None,
        "recordings of the same robot before something was added, repaired, worn or "
        "moved: names what changed since",
    )
    calibrate: Literal["none", "usual"] | None = option(
        None,
        "usual: fit first what is always a little wrong (friction, damping, inertias, "
        "gains), then name what remains; null: usual with reference=, else none",
    )
    check: str | None = option(
        None,
        "an effects.yaml found earlier: compare these recordings without and with it; "
        "nothing is searched",
    )
    effects_code: str | None = option(
        None, "Python file that registers effects of your own"
    )
    effects: str | None = option(None, "the same, by its former name")
    spread: float = option(
        0.03, "how far off any number of the model may be", minimum=0, maximum=0.5
    )
    model_root: str | None = option(
        None,
        "folder in which all files lie that the model reads, such as meshes; null: its "
        "own, or that of the ROS package around it",
    )
    threads: int = option(2, "simulations at a time", minimum=1)
    film: bool = option(
        True, "whether the report has a film of the robot, measured and simulated"
    )


def main(config: Config) -> None:
    """Read, compare, search, write."""
    from rlco.gap import run_gap

    if config.effects and config.effects_code:
        raise ConfigError(["effects= is effects_code= by its former name; give one"])
    if config.check is not None:
        check(config, config.check)
        return
    with new_folder(config.out) as out, one_interrupt():
        with progress_bar() as progress:
            finding = run_gap(
                config.model,
                config.data,
                rename=rename_map(config.rename),
                scale=scale_map(config.scale),
                angles=config.angles,
                spread=config.spread,
                compare=config.compare,
                reference=config.reference,
                calibrate=config.calibrate,
                effects_code=config.effects_code or config.effects,
                model_root=config.model_root,
                threads=config.threads,
                film=config.film,
                progress=progress,
            )
        for line in finding.summary():
            log.info("%s", line)
        log.info("report: %s", finding.write(out, command=command_line()))
    if not finding.complete:
        raise KeyboardInterrupt


def check(config: Config, effects: str) -> None:
    """Compare the recordings with the model, without and with effects of a file."""
    from rlco.gap import check_effects

    if config.compare == "both":
        raise ConfigError(["check= compares one quantity; give positions or torques"])
    if config.reference is not None or config.calibrate == "usual":
        raise ConfigError(["check= fits nothing; leave reference= and calibrate= out"])
    with new_folder(config.out) as out:
        found = check_effects(
            config.model,
            config.data,
            effects,
            rename=rename_map(config.rename),
            scale=scale_map(config.scale),
            angles=config.angles,
            compare=config.compare,
            effects_code=config.effects_code or config.effects,
            model_root=config.model_root,
            threads=config.threads,
        )
        for line in (*(f"note: {note}" for note in found.notes), *found.lines()):
            log.info("%s", line)
        write_json(out / "check.json", found.as_json())


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float], None]]:
    """Give what shows progress: a bar, or a line now and then without a terminal."""
    from tqdm import tqdm

    bar_format = "{desc} {percentage:3.0f}% |{bar}| {elapsed} {postfix}"
    bars = []
    last = time.monotonic()

    def progress(said: str, part: float) -> None:
        nonlocal last
        if not bars:
            bar = tqdm(total=100, desc="search", bar_format=bar_format, disable=None)
            bars.append(bar)
        bars[0].n = min(100, round(100 * part))
        bars[0].set_postfix_str(said)
        if bars[0].disable and time.monotonic() - last > _SILENT:
            last = time.monotonic()
            log.info("search %d %%: %s", bars[0].n, said)

    try:
        yield progress
    finally:
        for bar in bars:
            bar.close()


@contextmanager
def new_folder(out: str) -> Iterator[Path]:
    """Make the output folder, and take it away again where nothing came into it."""
    path = Path(out)
    check_new_folder(path)
    made = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        path.mkdir(parents=True)
    except OSError as error:
        raise RlcoError(
            f"output folder {out!r} cannot be made ({error.strerror}); give another "
            "out=DIR."
        ) from error
    try:
        yield path
    finally:
        for folder in made:  # so that the same command may run again
            if any(folder.iterdir()):
                break
            folder.rmdir()


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
    run_recipe(main, Config, loads="mujoco")
