"""The workflow's middle: a robot and its log in, a verdict out."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection

from rlco.gap.problem import Problem, Verdict
from rlco.gap.search import search_effects
from rlco.gap.search_exact import with_exact_model
from rlco.gap.search_start import start_search
from rlco.gap.verdict import conclude


def find_gap(
    problem: Problem,
    *,
    spread: float = 0.03,
    exclude: Collection[str] = (),
    on_step: Callable[[str, float], None] | None = None,
) -> Verdict:
    """Find out which physical effects a simulated robot lacks.

    Two thirds of the recordings are fitted, every third is held out and judges.

    Args:
        problem: A robot and its log.
        spread: By how much every number of the model may be off, as a part of it.
        exclude: Names of effects that are not considered.
        on_step: Called with a sentence and the part that is done.

    Returns:
        The verdict; with ``complete=False`` and the best so far after Ctrl-C.
    """
    began = time.perf_counter()
    search = start_search(problem, spread=spread, exclude=exclude, on_step=on_step)
    complete = True
    try:
        search_effects(search)
        search = with_exact_model(search)
        verdict = conclude(search, 0.0, complete=True)
    except KeyboardInterrupt:
        complete = False
        verdict = conclude(search, 0.0, complete=False)
    seconds = time.perf_counter() - began
    return Verdict(**{**vars(verdict), "seconds": seconds, "complete": complete})
