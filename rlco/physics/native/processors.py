"""How many processors there are for this process, which decides how many threads."""

from __future__ import annotations

import os


def available_processors() -> int:
    """Return the number of processors that this process may run on.

    A job of a cluster, a container or ``taskset`` may leave a few of many: as many
    threads as the machine has would wait for each other at every step.

    Example:
        >>> 1 <= available_processors() <= os.cpu_count()
        True
    """
    if hasattr(os, "sched_getaffinity"):  # of Linux
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
