"""A word where a simulator does not answer: a hang is silent by itself."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

log = logging.getLogger("rlco.collectors")

#: How long one decision may take before it is said that none has ended [s].
PATIENCE = 120.0


@contextmanager
def impatient(count: Callable[[], int], what: str) -> Iterator[None]:
    """Say so, once, where a count does not rise for `PATIENCE` seconds.

    A slow environment and one that hangs look alike, so nothing is ended: whoever
    watches decides. Ctrl-C, or ``kill -9`` where a library does not let go, ends the
    run, and what was saved is gone on from.

    Args:
        count: What rises as long as all is well; called in a thread.
        what: What is counted, and where.
    """
    over = threading.Event()

    def watch() -> None:
        before = count()
        while not over.wait(PATIENCE):
            if (now := count()) == before:
                log.warning(
                    "%s: no decision has ended for %g s since decision %d; the "
                    "environment hangs or is very slow. Ctrl-C ends the run, or kill "
                    "-9 if that does not, and nothing that was saved is lost.",
                    what,
                    PATIENCE,
                    now,
                )
                return
            before = now

    watcher = threading.Thread(target=watch, name="patience", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        over.set()
        watcher.join()
