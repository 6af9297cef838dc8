"""Final measurements of a search: intervals of its parameters, and its residual."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rlco.gap.compare.problem import Candidate, Hypothesis
from rlco.gap.compare.residuals import describe_residual
from rlco.gap.compare.verdict import Gap
from rlco.gap.logs.log import Array
from rlco.gap.search.fit import linearise
from rlco.gap.search.intervals import NORMAL, half_widths
from rlco.gap.search.judge import NAMED, found, is_noise, kind
from rlco.gap.search.setting import Setting
from rlco.gap.search.state import Residual, State
from rlco.gap.search.steps.sensitivity import tolerance_beside

SENSITIVE = 3.0  # squared sensitivity to the tolerance that effects may cause


def intervals(state: State) -> State:
    """Determine the intervals of the named effects' parameters."""
    if kind(state) not in NAMED:
        return replace(state, widths=(), correlation=None)
    setting, effects = state.setting, state.best.effects
    known = [
        parameter
        for effect in effects
        for parameter in setting.library[Candidate(effect.name, effect.target)]
    ]
    # A discontinuous parameter has no gradient: its interval is its resolution.
    widths = np.array([parameter.resolution for parameter in known])
    correlation = np.eye(len(known))
    smooth = widths == 0.0
    if smooth.any():
        state, once = tolerance_beside(state)
        weights = replace(setting.weights, training=once)
        here = linearise(setting.library, effects, setting.whiten)
        free = linearise(
            setting.library, effects, replace(setting, weights=weights).whiten
        )
        rows = setting.blocks[: len(here.residual)]
        widths[smooth], correlation[np.ix_(smooth, smooth)] = half_widths(
            here.jacobian[smooth], here.residual, rows, free.jacobian[smooth]
        )
    if state.sensitivity > SENSITIVE:
        # Differences are no guide there: a limit acts in units of the arm's weight.
        values = np.concatenate([effect.values for effect in effects])
        # Half a factor is half a change; half a limit is half of what moves the arm.
        away = [parameter.neutral if parameter.scales else 0.0 for parameter in known]
        least = NORMAL * np.max(setting.prior, initial=0.0) * np.abs(values - away)
        widths[smooth] = np.maximum(widths, least)[smooth]
    return replace(
        state,
        widths=tuple(float(width) for width in widths),
        correlation=correlation,
    )


def residual(state: State) -> State:
    """Determine the remaining gap with the named effects, and its channel."""
    setting, hypothesis = state.setting, Hypothesis(found(state).effects)
    both = [Hypothesis(), hypothesis] if hypothesis.effects else [hypothesis]
    problem = state.as_it_is or setting.problem
    rows = problem.residuals(both)
    what = Residual(_gap(setting, rows[0], rows[-1]))
    if state.as_it_is is not None or not is_noise(state):
        target, note = describe_residual(problem, hypothesis, rows[-1])
        what = replace(what, target=target, note=note)
    return replace(state, residual=what)


def _gap(setting: Setting, before: Array, after: Array) -> Gap:
    layout = setting.problem.layout

    def rms(rows: Array, recordings: tuple[int, ...]) -> float:
        part = rows[np.isin(layout.recording, recordings)]
        return float(np.sqrt(np.mean(part**2)))

    floor = setting.problem.noise[layout.channel]
    return Gap(
        layout.units[0] if len(set(layout.units)) == 1 else "mixed",
        rms(before, setting.train),
        rms(before, setting.heldout),
        rms(after, setting.train),
        rms(after, setting.heldout),
        float(np.sqrt(np.mean(floor**2))),
    )
