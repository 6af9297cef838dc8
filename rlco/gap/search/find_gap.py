"""The search from its first state to its verdict, as a sequence of steps."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Generator, Iterator

import numpy as np

from rlco.gap.compare.problem import Hypothesis, Problem
from rlco.gap.compare.servo.bench import ServoBench
from rlco.gap.compare.stability.instability import UnstableModelError, unstable_verdict
from rlco.gap.compare.verdict import Gap, Verdict
from rlco.gap.search.judge import LARGEST
from rlco.gap.search.outside.free_form import free_form
from rlco.gap.search.outside.free_joint import free_joint
from rlco.gap.search.servo.find_servo_gap import find_servo_gap
from rlco.gap.search.state import State
from rlco.gap.search.steps.carried import carried
from rlco.gap.search.steps.closing import intervals, residual
from rlco.gap.search.steps.drop import drop, drop_unobservable
from rlco.gap.search.steps.elsewhere import elsewhere
from rlco.gap.search.steps.exact_model import exact_model
from rlco.gap.search.steps.forward import forward, screen, shortlist, swap, take
from rlco.gap.search.steps.late_commands import late_commands
from rlco.gap.search.steps.plain_shares import plain_shares
from rlco.gap.search.steps.random_delay import random_delay
from rlco.gap.search.steps.rivals import rivals
from rlco.gap.search.steps.sensitivity import rewhiten
from rlco.gap.search.steps.start import split, start
from rlco.gap.search.steps.uncommon import uncommon
from rlco.gap.search.verdict import NOTHING_SEARCHED, conclude
from rlco.physics.effects.apply import library_effect

Progress = Callable[[str, float], None]


def find_gap(
    problem: Problem,
    *,
    spread: float = 0.03,
    exclude: Collection[str] = (),
    on_step: Progress | None = None,
) -> Verdict:
    """Find the physical effects that a simulated robot lacks.

    Two thirds of the recordings are fitted; every third is held out for validation. On
    a servo's bench each gain of the firmware is held out in turn, see
    `find_servo_gap`.

    Args:
        problem: A robot and its log.
        spread: Model tolerance: relative uncertainty of every model parameter. Not used
            on a servo's bench, where these parameters are fitted.
        exclude: Names of effects that are not considered.
        on_step: Called with a sentence and the fraction completed.

    Returns:
        The verdict; with ``complete=False`` and the best result so far after Ctrl-C.
        ``unstable_model`` where the model's simulation diverges: nothing is searched.

    Raises:
        UnknownNameError: `exclude` names no effect of the library.
    """
    check_names(exclude)
    began = time.perf_counter()
    try:
        if isinstance(problem, ServoBench):
            return find_servo_gap(problem, exclude=exclude, on_step=on_step)
        state = start(problem, spread=spread, exclude=exclude)
    except KeyboardInterrupt:
        return nothing_searched(problem, time.perf_counter() - began)
    except UnstableModelError as error:
        seconds = time.perf_counter() - began
        return unstable_verdict(problem, error.instability, *split(problem), seconds)
    state, complete = search(state, on_step)
    try:
        return conclude(state, complete=complete, seconds=time.perf_counter() - began)
    except KeyboardInterrupt:  # it was to end the search, and that has ended
        return conclude(state, complete=complete, seconds=time.perf_counter() - began)


def check_names(exclude: Collection[str]) -> None:
    """Check that effects to leave out are some of the library.

    Raises:
        UnknownNameError: One is none.
    """
    for name in exclude:
        library_effect(name)


def search(first: State, on_step: Progress | None = None) -> tuple[State, bool]:
    """Return the last state of a search, closed, and whether it was completed.

    After a KeyboardInterrupt, that is the last state returned by a step. Steps do not
    modify states, so no state is ever half finished.

    Args:
        first: The first state.
        on_step: Called after each step with a sentence and the fraction completed.
    """
    state = first
    try:
        for state in states(first):
            if on_step is not None:
                on_step(*progress(state))
    except KeyboardInterrupt:
        return closed(state), False
    return state, True


def states(state: State) -> Iterator[State]:
    """Yield the state after each step of a search, until it ends."""
    state = yield from additions(state)
    state = yield from late_commands(state, additions)
    state = carried(state)
    yield state
    state = yield from uncommon(state, additions)
    state = yield from elsewhere(state, additions)
    state = yield from free_joint(state, additions)
    closing = (intervals, plain_shares, residual, free_form, random_delay)
    for step in (exact_model, rivals, *closing):
        state = step(state)
        yield state


def additions(state: State) -> Generator[State, None, State]:
    """Yield the state after each step that adds effects; return the last.

    Each round adds one effect, swaps others and drops those not needed, until nothing
    clearly helps.
    """
    while not state.ended and len(state.best.effects) < LARGEST:
        before = state.best
        for step in (shortlist, screen, forward, swap, take):
            state = step(state)
            yield state
        if state.best is before:
            continue  # the search ended, or screens other recordings next
        for step in (drop, rewhiten):
            state = step(state)
            yield state
    state = drop_unobservable(state)
    yield state
    return state


def closed(state: State) -> State:
    """Return a state with everything that a verdict needs, as after the last steps."""
    return random_delay(residual(intervals(state)))


def progress(state: State) -> tuple[str, float]:
    """Return what a search is doing, and the fraction completed."""
    done = len(state.best.effects) / LARGEST
    if state.round is not None:
        return f"screening {len(state.round.candidates)} effects", done
    names = [f"{e.name} {e.target or ''}".strip() for e in state.best.effects]
    return ", ".join(names) or "nothing", done


def nothing_searched(problem: Problem, seconds: float) -> Verdict:
    """Return a verdict that names nothing, with the initial disagreement."""
    rows = problem.residuals([Hypothesis()])[0]
    noise = np.asarray(problem.noise)[problem.layout.channel]
    units = set(problem.layout.units)
    unit = units.pop() if len(units) == 1 else "mixed"
    size = float(np.sqrt(np.mean(rows**2)))
    floor = float(np.sqrt(np.mean(noise**2)))
    return Verdict(
        complete=False,
        verdict="unexplained",
        effects=(),
        gap=Gap(unit, size, size, size, size, floor),
        unexplained={"share": 1.0, "target": None, "note": NOTHING_SEARCHED},
        closest=(),
        seconds=seconds,
        hypothesis=Hypothesis(),
        train=tuple(range(len(problem.log.recordings))),
        heldout=(),
    )
