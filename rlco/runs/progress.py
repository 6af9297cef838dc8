"""How far a run is, for people who wait: a bar, or a line now and then."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from tqdm import tqdm

log = logging.getLogger("rlco.run")

#: Between lines where there is no terminal for a bar [s].
QUIET = 15.0
# What a row of metrics.csv shows beside the bar.
_REPORTED = ("success", "loss", "imitation_error")


class Progress:
    """A bar on a terminal, lines elsewhere.

    Attributes:
        name: What is under way.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._bar: tqdm[Any] | None = None
        self._latest: dict[str, float] = {}

    def show(self, row: Mapping[str, float]) -> None:
        """Show the successes and losses of a row from now on."""
        self._latest |= {n: v for n, v in row.items() if n.startswith(_REPORTED)}
        if self._bar is not None:
            self._bar.set_postfix_str(self._text, refresh=False)

    def count(
        self, first: int, total: int, progress: Callable[[int], str] | None = None
    ) -> Iterator[int]:
        """Count from ``first`` to ``total``, see `rlco.run.Run.iterations`."""
        said = time.perf_counter()
        with tqdm(
            desc=self.name,
            total=total,
            initial=first - 1,
            disable=None,
            unit="it" if progress is None else "row",
        ) as self._bar:
            for iteration in range(first, total + 1):
                yield iteration
                self._bar.update()
                late = time.perf_counter() - said > QUIET
                if self._bar.disable and (late or iteration == total):
                    said = time.perf_counter()
                    done = f"{iteration} of {total}"
                    if progress is not None:
                        done = progress(iteration)
                    text = ", ".join(filter(None, (done, self._text)))
                    log.info("%s: %s", self.name, text)

    @property
    def _text(self) -> str:
        """The latest successes and losses."""
        return ", ".join(f"{name} {value:.3g}" for name, value in self._latest.items())
