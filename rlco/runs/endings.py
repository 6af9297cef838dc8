"""How a run ends that does not finish: by a signal, a full disk, or a full memory.

Nothing that was saved is lost in any of them.
"""

from __future__ import annotations

import errno
import signal
import threading
from types import FrameType

from rlco.errors import RlcoError
from rlco.files import shown
from rlco.files.reading import reason

#: What the system says where a disk is full, read-only, failing or not one's own.
STORAGE = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.EROFS,
    errno.EACCES,
    errno.EPERM,
    errno.EIO,
)


#: What the system says of a path that it cannot follow: too long, or links in a circle.
NO_PATH = (errno.ENAMETOOLONG, errno.ELOOP)


class Stopped(KeyboardInterrupt):
    """A signal that asks the process to end; it ends as by Ctrl-C.

    Attributes:
        number: The signal's.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


def stop_on_signals() -> None:
    """Let SIGTERM and SIGHUP end a run as Ctrl-C does, so that it can say so.

    One that is ignored, as under ``nohup``, stays so.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _stop)


def _stop(number: int, _frame: FrameType | None) -> None:
    raise Stopped(number)


def ending(error: Exception) -> tuple[str, int] | None:
    """Return what a run that ends by an exception says, and its exit status.

    Wrong input is status 2; a full or read-only disk and a full memory are 1. Every
    other exception is a defect: None, and it keeps its traceback.

    Example:
        >>> ending(MemoryError("9 TiB"))[1], ending(KeyError("x"))
        (1, None)
    """
    if isinstance(error, RlcoError):
        return str(error), 2
    if isinstance(error, OSError) and error.errno in NO_PATH:
        return path_problem(error), 2
    if isinstance(error, OSError) and error.errno in STORAGE:
        return storage_problem(error), 1
    if is_out_of_memory(error):
        return memory_problem(error), 1
    return None


def path_problem(error: OSError) -> str:
    """Return one sentence about a path that the system cannot follow.

    Example:
        >>> path_problem(OSError(36, "File name too long", "a" * 300))[:28]
        "path 'aaaaaaaaaaaaaaaaaaaaaa"
    """
    return (
        f"path {shown(str(error.filename))} is none that the system can follow "
        f"({error.strerror}); give a shorter one, or mend its links."
    )


def storage_problem(error: OSError) -> str:
    """Return one sentence about a file that cannot be written or read.

    Example:
        >>> storage_problem(OSError(28, "No space left on device", "out/log.txt"))
        "'out/log.txt' cannot be written or read (No space left on device); make room \
or give another place, nothing that was saved is lost."
    """
    name = "a file" if error.filename is None else shown(str(error.filename))
    return (
        f"{name} cannot be written or read ({error.strerror}); make room or give "
        "another place, nothing that was saved is lost."
    )


def is_out_of_memory(error: BaseException) -> bool:
    """Return whether an exception says that there is no memory left, of any device.

    Example:
        >>> is_out_of_memory(MemoryError()), is_out_of_memory(RuntimeError("no"))
        (True, False)
    """
    if isinstance(error, MemoryError):
        return True
    # torch's: a class of its own for GPUs, which is not imported for this; on the CPU
    # a message alone.
    named = {kind.__name__ for kind in type(error).__mro__}
    return "OutOfMemoryError" in named or (
        isinstance(error, RuntimeError) and "can't allocate memory" in str(error)
    )


def memory_problem(error: BaseException) -> str:
    """Return one sentence about a memory that is full.

    Example:
        >>> memory_problem(MemoryError("Unable to allocate 9 TiB"))
        'there is not enough memory (Unable to allocate 9 TiB); nothing that was saved \
is lost: give a smaller minibatch, batch_size, num_envs or image_size, or end other \
processes.'
    """
    return (
        f"there is not enough memory ({reason(error)}); nothing that was saved is "
        "lost: give a smaller minibatch, batch_size, num_envs or image_size, or end "
        "other processes."
    )
