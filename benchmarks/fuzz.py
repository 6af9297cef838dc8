"""Damage files of every kind that rlco reads, and count what its readers make of them.

    OMP_NUM_THREADS=1 uv run benchmarks/fuzz.py minutes=15
    OMP_NUM_THREADS=1 uv run benchmarks/fuzz.py seconds=60 reader=NPZ seed=7

Every input is a whole small file, or folder, with one to three faults: bits flipped,
cut, repeated, zeroed, a value of JSON, YAML or XML put in another's place, a number
made extreme, a file emptied or taken away. Allowed are success and one sentence of
rlco's own. All else is printed with its number: reader and seed make it again.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import random
import re
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

HANG = 10.0  # of the processor, and sixfold of a machine that is busy [s]
MEMORY = 1_000_000  # beyond the file's own size [kB]
_EXTREME = (
    *("0", "-1", "1e400", "-1e308", "nan", "null", "true", '""', "[]", "{}", "x"),
    *("999999999999", "1" + "0" * 5000, '"' + "a" * 5000 + '"', "[" * 3000, "${a:b}"),
    *('"../../x"', "{x.__class__}", "&a [*a]", "\x1b[2J", "\x00", "-0.0", "0.5"),
)
_VALUE = re.compile(rb'"[^"\n]{0,80}"|[-+]?\d[\d.eE+-]*|true|false|null|\w+')


def damaged(content: bytes, draw: random.Random) -> bytes:
    """Return a file's content with one fault."""
    if not content:
        return draw.randbytes(draw.choice((1, 8, 100)))
    place = draw.randrange(len(content))
    kind = draw.choice(
        ("flip", "flip", "cut", "twice", "zero", "value", "value", "swap")
    )
    if kind == "cut":
        return content[:place]
    length = min(draw.choice((1, 4, 16, 200)), len(content) - place)
    before, after = content[:place], content[place + length :]
    if kind == "flip":
        changed = bytearray(content)
        for _ in range(draw.choice((1, 1, 3, 12))):
            changed[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
        return bytes(changed)
    if kind == "twice":
        return content[: place + length] + content[place:]
    if kind == "zero":
        return before + bytes(length) + after
    values = list(_VALUE.finditer(content[:200_000]))
    if not values:
        return before + draw.randbytes(length) + after
    one = draw.choice(values)
    others = [found[0] for found in values]
    extreme = [text.encode() for text in _EXTREME]
    new = draw.choice(others if kind == "swap" else extreme)
    return content[: one.start()] + new + content[one.end() :]


def damage(folder: Path, draw: random.Random) -> None:
    """Put one to three faults into a folder's files."""
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    for _ in range(draw.choice((1, 1, 2, 3))):
        file = draw.choice(files)
        if not file.is_file():
            continue
        if draw.random() < 0.03:
            file.unlink()
        elif draw.random() < 0.03:
            file.write_bytes(b"")
        else:
            file.write_bytes(damaged(file.read_bytes(), draw))


def attempt(name: str, whole: Path, seed: int) -> tuple[str, str]:
    """Read a damaged copy of whole files.

    Returns:
        ``read``, ``refused``, ``traceback`` or ``warning``, and what was said.
    """
    from fuzz_files import READERS

    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "files"
        shutil.copytree(whole, folder)
        damage(folder, random.Random(f"{name} {seed}"))
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a user would see it beside the sentence
            return _read(READERS[name].read, folder)


def _read(read: Callable[[Path], object], folder: Path) -> tuple[str, str]:
    from rlco.errors import RlcoError

    try:
        read(folder)
    except RlcoError as error:
        said = str(error)
        long = len(said) > 1500 or "\n" in said
        return ("long sentence" if long else "refused"), said
    except Warning:
        return "warning", traceback.format_exc()
    except Exception:  # noqa: BLE001 - any but ours is a finding, counted as one
        return "traceback", traceback.format_exc()
    return "read", ""


def whole_files(name: str, place: Path) -> Path:
    """Write whole files of a reader, and check that it reads them."""
    from fuzz_files import READERS

    folder = place / re.sub(r"\W", "_", name)
    folder.mkdir()
    READERS[name].write(folder)
    copy = place / "copy"
    shutil.copytree(folder, copy)
    READERS[name].read(copy)
    shutil.rmtree(copy)
    return folder


def _peak() -> tuple[int, int]:
    """Return how much memory this process uses, and used at most [kB]."""
    text = Path("/proc/self/status").read_text("utf-8")
    found = dict(re.findall(r"(VmRSS|VmHWM):\s+(\d+) kB", text))
    return int(found["VmRSS"]), int(found["VmHWM"])


def _work(tasks: Connection) -> None:
    """Answer attempts in a process of its own, with the memory that each took."""
    importlib.import_module("fuzz_files")  # what it takes is no attempt's

    tasks.send("ready")
    while (task := tasks.recv()) is not None:
        Path("/proc/self/clear_refs").write_text("5")  # sets the most used to the used
        before, _ = _peak()
        outcome, said = attempt(*task)
        grown = _peak()[1] - before
        tasks.send(("memory", f"{grown} kB") if grown > MEMORY else (outcome, said))


class Worker:
    """A process that attempts, replaced where it hangs or dies."""

    def __init__(self) -> None:
        self._start()

    def _start(self) -> None:
        self._ours, theirs = multiprocessing.Pipe()
        context = multiprocessing.get_context("spawn")
        self._process = context.Process(target=_work, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()
        self._ours.recv()  # ready

    def _busy(self) -> float:
        """Return how long a processor has worked for the process [s]."""
        text = Path(f"/proc/{self._process.pid}/stat").read_text("utf-8")
        # After its name: user and system time, its own and of children that ended.
        ticks = text.rpartition(")")[2].split()[11:15]
        return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")

    def attempt(self, name: str, whole: Path, seed: int) -> tuple[str, str]:
        """Return the outcome of an attempt, and what was said."""
        self._ours.send((name, whole, seed))
        try:
            began, busy = time.monotonic(), self._busy()
            while not self._ours.poll(0.5):
                waited = time.monotonic() - began
                if self._busy() - busy > HANG or waited > 6 * HANG:
                    outcome = "hang"
                    break
            else:
                answer: tuple[str, str] = self._ours.recv()
                return answer
        except EOFError:
            outcome = "crash"
        self._process.kill()
        self._process.join()
        self._start()
        return outcome, ""

    def close(self) -> None:
        """End the process."""
        self._ours.send(None)
        self._process.join()


def main() -> None:
    given = dict(argument.split("=", 1) for argument in sys.argv[1:])
    seconds = float(given.get("seconds", 60 * float(given.get("minutes", 1))))
    first = int(given.get("seed", 0))
    from fuzz_files import READERS

    names = [name for name in READERS if given.get("reader", name) == name]
    counts: dict[str, Counter[str]] = {name: Counter() for name in names}
    worker, end, seed = Worker(), time.monotonic() + seconds, first
    with tempfile.TemporaryDirectory() as place:
        whole = {name: whole_files(name, Path(place)) for name in names}
        while time.monotonic() < end:
            for name in names:
                outcome, said = worker.attempt(name, whole[name], seed)
                counts[name][outcome] += 1
                if outcome not in ("read", "refused"):
                    last = said.strip().splitlines()[-1:] or [""]
                    where = re.findall(r'File "[^"]*/(rlco/[^"]+)", line (\d+)', said)
                    print(
                        f"{name} seed={seed}: {outcome} {last[0][:200]} {where[-1:]}",
                        flush=True,
                    )
            seed += 1
    worker.close()
    kinds = ["refused", "read"]
    kinds += sorted({kind for c in counts.values() for kind in c} - set(kinds))
    print(f"\n| reader | inputs | {' | '.join(kinds)} |")
    print("|---" * (len(kinds) + 2) + "|")
    for name, count in [*counts.items(), ("all", sum(counts.values(), Counter()))]:
        cells = [str(count[kind]) for kind in kinds]
        print(f"| {name} | {count.total()} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
