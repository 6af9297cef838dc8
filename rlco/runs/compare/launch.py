"""Become a command: `python launch.py PARENT NICE COMMAND ...`, run by its path.

A child set up between fork and exec (Popen's `preexec_fn`) needs a real fork, which a
machine that promises no more memory than it has refuses to a process as large as torch.
"""

import ctypes
import os
import signal
import sys

_DIES_WITH_PARENT = 1  # PR_SET_PDEATHSIG of Linux's prctl


def become_job(parent: int, nice: int) -> None:
    """Make this process a job of its parent: it hears it, and ends when it does."""
    os.nice(nice)
    # Whoever interrupts it must be heard, also where its parent does not hear: workers
    # of Ray block signals, commands in the background of a script ignore them.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_DIES_WITH_PARENT, signal.SIGTERM)
        if os.getppid() != parent:  # it ended before it was bound to
            sys.exit(1)


if __name__ == "__main__":
    parent, nice, *command = sys.argv[1:]
    become_job(int(parent), int(nice))
    os.execv(command[0], command)
