"""Files of a run directory: made atomically, locked, and what they say of origin."""

from __future__ import annotations

import errno
import fcntl
import functools
import os
import platform
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from rlco.errors import OutputExistsError, RlcoError
from rlco.files import Fields, read_json, shown
from rlco.files.places import check_links
from rlco.runs.options import started_by_rlco
from rlco.runs.whole_files import sync_folder, write_text

#: The libraries whose versions decide what a run computes.
LIBRARIES = (
    "rlco",
    "torch",
    "torchrl",
    "tensordict",
    "lerobot",
    "robosuite",
    "mujoco",
    "numpy",
)


def create(
    out: str | None,
    name: str,
    seed: int,
    recipe: str,
    root: Path,
    files: Mapping[str, str],
) -> Path:
    """Make a new run directory: ``out``, or ``root/recipe/<date_time>_<name>_s<seed>``.

    It is there with its first files or not at all, also where the process is killed.

    Args:
        out: The directory, or None.
        name: Of the run.
        seed: Of the run.
        recipe: Of the run.
        root: Where directories with a date are made.
        files: Texts of its first files, by name.

    Raises:
        OutputExistsError: ``out`` exists.
        RlcoError: The directory cannot be made.
    """
    while True:
        stamp = time.strftime("%Y-%m-%d_%H-%M-%S")
        path = Path(out) if out else root / recipe / f"{stamp}_{name}_s{seed}"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if not os.path.lexists(path) and _put_whole(path, files):
                sync_folder(path.parent)
                return path
        except OSError as error:
            raise RlcoError(
                f"run directory {shown(str(path))} cannot be made "
                f"({error.strerror}); give another out=DIR."
            ) from error
        if out:
            raise OutputExistsError(out, resumable=True)
        time.sleep(0.1)  # another run began within this second


def _put_whole(path: Path, files: Mapping[str, str]) -> bool:
    """Make a folder with files in it; return False where another one was first."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir()
    try:
        for name, text in files.items():
            write_text(part / name, text)
        # One call decides whether it was there: two runs cannot both get it.
        part.rename(path)
    except OSError as error:
        shutil.rmtree(part, ignore_errors=True)
        if error.errno in (errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR):
            return False
        raise
    return True


def lock(path: Path) -> int:
    """Claim a run directory for this process; closing the number gives it up.

    Raises:
        RlcoError: Another process writes to it.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise RlcoError(
            f"run directory {str(path)!r} is in use by another process; wait for it "
            "to end before you resume it."
        ) from error
    return descriptor


def read_info(path: Path, recipe: str) -> Fields:
    """Read the run.json of a run that is to be resumed.

    Raises:
        RlcoError: It is missing, damaged, or of another recipe; or a link leads out of
            the folder.
    """
    check_links(path)
    info = read_json(
        path / "run.json",
        advice="give the folder of an earlier run as resume=DIR",
        error=RlcoError,
    )
    made_by = info.text("recipe")
    info.sequence("resumed")
    info.integer("checkpoint", None, minimum=0)
    info.number("seconds")
    if made_by != recipe:
        raise RlcoError(
            f"run directory {str(path)!r} is of recipe {made_by!r}, not {recipe!r}; "
            f"resume it with recipes/{made_by}.py."
        )
    return info


def origin(recipe: str) -> dict[str, Any]:
    """Describe where a new run's numbers come from."""
    return {
        "recipe": recipe,
        "command": command_line(),
        "resumed": [],
        "commit": commit(Path(__file__).parent),
        "versions": versions(),
        "machine": machine(),
        "started": time.strftime("%Y-%m-%d %H:%M:%S"),
        "seconds": 0.0,
    }


def command_line() -> str:
    """Return the command that started this process, ready to paste."""
    if started_by_rlco():
        return shlex.join(["rlco", *sys.argv[1:]])
    script = os.path.relpath(sys.argv[0]) if sys.argv[0] else "-"
    return shlex.join(["uv", "run", script, *sys.argv[1:]])


def commit(folder: Path) -> str | None:
    """Return the git commit of ``folder``, "-dirty" appended where files differ."""
    git = ("git", "-C", str(folder))
    try:
        head, changes = (
            subprocess.run(
                [*git, *words], capture_output=True, text=True, check=True
            ).stdout.strip()
            for words in (
                ("rev-parse", "HEAD"),
                ("status", "--porcelain", "--untracked-files=no"),
            )
        )
    except (OSError, subprocess.CalledProcessError):
        return None  # no git, no repository, or no commit yet
    return f"{head}-dirty" if changes else head


@functools.cache  # reading every library's metadata takes 30 ms, for each cell and run
def versions() -> dict[str, str]:
    """Return the versions of Python and of the libraries that decide a result."""
    found = {"python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def machine() -> dict[str, Any]:
    """Describe the computer: system, processor, cores that may be used, GPUs."""
    import torch

    return {
        "system": f"{platform.system()} {platform.machine()}",
        "processor": processor(),
        "cores": len(os.sched_getaffinity(0)),
        "gpus": [
            torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())
        ],
    }


def processor() -> str:
    """Return the name of the processor's model."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2] for line in lines if line.startswith("model name")]
    return names[0].strip() if names else platform.processor()
