"""How a run ends that does not finish: stopped by a signal, or nothing can be written.

Nothing that was saved is lost in either.
"""

from __future__ import annotations

import errno
import signal
import threading
from types import FrameType

from rlco.files import shown

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
