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
Ctrl-C ends the search and writes the best so far. Until all of it is written, `out` is
called `out`.unfinished.
"""

from __future__ import annotations

import logging
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Literal

from rlco.errors import ConfigError
from rlco.run import run_recipe
from rlco.runs.config import REQUIRED, option
from rlco.runs.endings import Stopped
from rlco.runs.options import rename_map, scale_map
from rlco.runs.run_folder import command_line
from rlco.runs.whole_files import check_new_folder, whole_folder, write_json

log = logging.getLogger("rlco.find_gap")

_SILENT = 30.0  # [s] at most without a word where no bar is shown
_WRITING = 60.0  # [s] after a Ctrl-C in which the next ones are not heeded
#: Signals that ask for an end: Ctrl-C, a cluster's, a closed terminal's.
ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


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
    threads: int = option(2, "simulations at a time", minimum=1, maximum=1024)
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
    check_new_folder(Path(config.out))
    with one_interrupt() as ends, whole_folder(config.out) as part:
        with progress_bar() as show:

            def progress(said: str, part: float) -> None:
                ends.held = part >= 1.0  # what was found is lost no more
                show(said, part)

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
        finding.write_files(part, command=command_line())
    log.info("report: %s", Path(config.out) / "report.html")
    if ends.asked:
        raise Stopped(ends.asked[0])


def check(config: Config, effects: str) -> None:
    """Compare the recordings with the model, without and with effects of a file."""
    from rlco.gap import check_effects

    if config.compare == "both":
        raise ConfigError(["check= compares one quantity; give positions or torques"])
    if config.reference is not None or config.calibrate == "usual":
        raise ConfigError(["check= fits nothing; leave reference= and calibrate= out"])
    check_new_folder(Path(config.out))
    with whole_folder(config.out) as part:
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
        write_json(part / "check.json", found.as_json())


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


@dataclass
class Ends:
    """What signals that ask for an end do.

    Attributes:
        asked: Those that came.
        held: Whether they wait for what is being done.
    """

    asked: list[int] = field(default_factory=list)
    held: bool = False


@contextmanager
def one_interrupt() -> Iterator[Ends]:
    """Let a Ctrl-C, or a signal that asks the same, end the search; the next nothing.

    Once ``held`` is set, the first one waits, too.
    """
    ends, last = Ends(), -_WRITING

    def handle(number: int, _frame: FrameType | None) -> None:
        nonlocal last
        now = time.monotonic()
        ends.asked.append(number)
        if ends.held or now - last < _WRITING:
            log.info("writing the best so far, it takes some seconds")
            return
        last = now
        raise Stopped(number)

    before = {number: signal.getsignal(number) for number in ENDS}
    for number, known in before.items():
        if number == signal.SIGINT or known is not signal.SIG_IGN:  # as under nohup
            signal.signal(number, handle)
    try:
        yield ends
    finally:
        for number, known in before.items():
            signal.signal(number, known)


if __name__ == "__main__":
    run_recipe(main, Config, loads="mujoco")
