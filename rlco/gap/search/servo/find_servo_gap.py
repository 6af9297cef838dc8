"""The search on a servo's bench: effects one by one, judged where not fitted.

An effect is added where held-out recordings are better with it beyond doubt, and by
three per cent. Another is as good in its place where they are not worse with it beyond
doubt. Doubt is the block test's of `comparison`; the other test there takes the
residual for noise, which it is not while a servo is off by fifty times its encoder's
steps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace

from rlco.gap.compare.servo.bench import ServoBench
from rlco.gap.compare.verdict import Verdict
from rlco.gap.compare.wording import amount, title
from rlco.gap.search.judge import BETTER, NEAR_FLOOR, at_bounds
from rlco.gap.search.servo.ladder import (
    LIKELY,
    Judged,
    alone,
    ladder_of,
    likely,
    without_own_numbers,
)
from rlco.gap.search.servo.state import ServoState, better
from rlco.gap.search.servo.verdict import conclude

LARGEST = 3  # effects at once

Progress = Callable[[str, float], None]


def find_servo_gap(
    problem: ServoBench,
    *,
    exclude: Collection[str] = (),
    on_step: Progress | None = None,
) -> Verdict:
    """Find out which physical effects a servo's model lacks, its own numbers fitted.

    Args:
        problem: The servo and its recordings.
        exclude: Names of effects that are not considered.
        on_step: Called with a sentence and the part that is done.

    Returns:
        The verdict; with ``complete=False`` and the best so far after Ctrl-C.

    Raises:
        DataError: There is but one recording.
        KeyboardInterrupt: Before the servo's own numbers were fitted.
    """
    began = time.perf_counter()
    say = on_step or (lambda sentence, part: None)
    ladder = ladder_of(problem, exclude)
    none = alone(ladder)
    first = state = ServoState(ladder, none, none, {(): none})
    complete = True
    try:
        for state, part in states(first):
            names = [title(one) for one in state.best.effects]
            found = ", ".join(names) or "the servo's own numbers"
            say(f"{found}: {amount(state.best.error, 'rad')} held out", part)
    except KeyboardInterrupt:
        complete = False
    return conclude(state, complete=complete, seconds=time.perf_counter() - began)


def states(state: ServoState) -> Iterator[tuple[ServoState, float]]:
    """Yield the state after each explanation, and about which part is done."""
    floor = NEAR_FLOOR * float(state.ladder.problem.noise[0])
    for count in range(LARGEST):
        before = state.best
        options: list[Judged] = []
        if before.rms < floor:
            break
        for added in likely(state.ladder, before):
            yield state, (count + len(options) / LIKELY) / (LARGEST + 2)
            state, one = state.judged(before, added)
            options.append(one)
        state = _taken(state, options)
        yield state, (count + 1) / (LARGEST + 2)
        if state.best is before:
            break
    effects = state.best.effects
    for place, effect in enumerate(effects):
        base = state.none
        found: list[Judged] = []
        for other in effects:
            if other != effect:
                state, base = state.judged(base, other)
        for added in likely(state.ladder, base):
            done = (place + len(found) / LIKELY) / len(effects)
            yield state, (LARGEST + 2.0 * done) / (LARGEST + 2)
            state, one = state.judged(base, added)
            found.append(one)
        others = (one for one in found if frozenset(one.effects) != frozenset(effects))
        state = replace(state, others={**state.others, effect: tuple(others)})
    yield state, 1.0


def _taken(state: ServoState, options: list[Judged]) -> ServoState:
    """Return a state with the best of some explanations, if one is better."""
    fine = [
        one
        for one in options
        if one.error < (1.0 - BETTER) * state.best.error
        and better(state.ladder, one, state.best)
        and not _at_bounds(state, one)
    ]
    if not fine:
        return state
    best = min(fine, key=lambda one: one.error)
    return replace(state, best=best, path=(*state.path, best.effects))


def _at_bounds(state: ServoState, one: Judged) -> bool:
    library = state.ladder.library
    return any(at_bounds(library, without_own_numbers(fit)) for fit in one.fits)
