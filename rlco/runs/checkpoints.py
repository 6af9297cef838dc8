"""The checkpoints of a run: the newest that is as it was written is gone on from.

There is no pointer to the latest one: a checkpoint gets its name, the highest, when it
and the tables that belong to it are on the disk, and only then do older ones go.
"""

from __future__ import annotations

import errno
import logging
import re
from pathlib import Path
from typing import Any

from rlco.errors import CheckpointError
from rlco.files.checksums import verify
from rlco.runs.whole_files import sync_folder

log = logging.getLogger("rlco.run")

_NAME = re.compile(r"step_(\d{7,})\.safetensors")
#: Before the name of one that is not what was written.
DAMAGED = "damaged_"


def checkpoint_files(folder: Path) -> dict[int, Path]:
    """Return the checkpoints in a folder by their iterations, oldest first.

    One that is not whole has another name.
    """
    named = {int(m[1]): p for p in _listed(folder) if (m := _NAME.fullmatch(p.name))}
    return dict(sorted(named.items()))


def _listed(folder: Path) -> list[Path]:
    return list(folder.iterdir()) if folder.is_dir() else []


def go_on_from(folder: Path, last: int | None) -> int | None:
    """Return the iteration of the newest checkpoint that is as it was written.

    Those after it are damaged: each is told, and put aside under another name, as the
    resumed run writes its iteration again.

    Args:
        folder: Where they are.
        last: The last iteration that is known to have been saved.

    Returns:
        None, where none was ever saved.

    Raises:
        CheckpointError: All of them are damaged or gone, or one may not be read; then
            nothing is put aside.
    """
    damaged: dict[Path, str] = {}
    whole = None
    for step, path in reversed(checkpoint_files(folder).items()):
        problem = _problem(path)
        if problem is None:
            whole = step
            break
        damaged[path] = problem
    if whole is None and (damaged or last is not None):
        first = next(iter(damaged.values()), "there is none left")
        raise CheckpointError(
            f"run {str(folder.parent)!r} cannot go on, as none of its checkpoints is "
            f"as it was written: {first}; put one back from a copy, or start a new run."
        )
    for path, problem in damaged.items():
        path.rename(path.with_name(DAMAGED + path.name))
        log.warning(
            "%s; it was put aside as %s, and the run goes on from iteration %s and "
            "does what came after again.",
            problem,
            DAMAGED + path.name,
            whole,
        )
    if damaged:
        sync_folder(folder)
    elif last is not None and whole is not None and whole < last:
        log.warning(
            "the checkpoint of iteration %d is gone from %s; the run goes on from "
            "iteration %d and does what came after again.",
            last,
            folder,
            whole,
        )
    return whole


def _problem(path: Path) -> str | None:
    """Return what is wrong with a checkpoint; None if it is what was written.

    Raises:
        CheckpointError: It may not be read, which says nothing of what is in it.
    """
    from rlco.runs.state_files import load_state

    try:
        if not verify(path):  # from before there were checksums, or that byte flipped
            load_state(path)
    except CheckpointError as error:
        cause = error.__cause__
        if isinstance(cause, OSError) and cause.errno not in (None, errno.EIO):
            raise
        said = str(error).rstrip(".")
        return said.rpartition(";")[0] or said  # without what to do about it
    return None


def save_checkpoint(folder: Path, step: int, content: Any, *, keep: int) -> Path:
    """Write a checkpoint, whole or not at all, and then remove those beyond `keep`.

    Args:
        folder: Where they are, made where it is missing.
        step: Its iteration, after all that are there.
        content: As :func:`rlco.runs.state_files.save_state` takes it.
        keep: How many stay, the newest.
    """
    from rlco.runs.state_files import save_state

    if not folder.is_dir():
        folder.mkdir()
        sync_folder(folder.parent)
    path = folder / f"step_{step:07d}.safetensors"
    save_state(path, content)
    for old in list(checkpoint_files(folder).values())[:-keep]:
        old.unlink()
    return path
