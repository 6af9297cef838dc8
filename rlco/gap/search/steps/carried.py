"""Hold a payload at a jaw against the same payload at the link that carries the jaw.

A payload is searched at the last link of each chain. Where that is a gripper's jaw,
what hangs at the gripper is found at the jaw, with other effects that make up for the
difference: the jaw turns, and the gripper does not.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco

from rlco.gap.compare.problem import Candidate
from rlco.gap.search.fit import candidates_of
from rlco.gap.search.judge import at_bounds
from rlco.gap.search.state import State
from rlco.gap.search.steps.drop import drop
from rlco.physics.effects import AppliedEffect
from rlco.physics.effects.inertia import PAYLOAD

LIGHT = 0.5  # ratio of a jaw's mass to that of the link that carries it, at most


def carried(state: State) -> State:
    """Return the state with a payload where it explains more, or as much with less.

    Args:
        state: Of a search that has added and dropped its effects.
    """
    for held in candidates_of(state.best.effects):
        link = carrier(state.setting.problem.model, held)
        # A move fits the other effects anew, and may drop some.
        if link is not None and held in state.best.names:
            state = _moved(state, held, link)
    return state


def carrier(model: mujoco.MjModel, held: Candidate) -> str | None:
    """Return the link that carries the jaw at which a payload is; None: no jaw is."""
    if held.name != PAYLOAD.name:
        return None
    jaw = int(model.body_weldid[model.body(str(held.target)).id])
    link = int(model.body_weldid[model.body_parentid[jaw]])
    if link == 0:
        return None
    masses = [float(model.body_mass[model.body_weldid == x].sum()) for x in (jaw, link)]
    return model.body(link).name if masses[0] <= LIGHT * masses[1] else None


def _moved(state: State, held: Candidate, link: str) -> State:
    setting, best = state.setting, state.best
    model, there = setting.problem.model, Candidate(PAYLOAD.name, link)
    if there in best.names:
        return state
    library = {**setting.library, there: PAYLOAD.parameters(model, link)}
    wider = replace(state, setting=replace(setting, library=library))
    named = candidates_of(best.effects)
    effect = best.effects[named.index(held)]
    others = tuple(one for one in best.effects if one is not effect)
    # From the link's own frame, as a search begins: where a place does not matter, the
    # jaw's may be anywhere.
    mass, *place = effect.parameters
    start = {mass: float(effect.values[0]), **dict.fromkeys(place, 0.0)}
    moved = AppliedEffect(effect.name, link, start)
    wider, fits = wider.fit([(moved, *others)], steps=12)
    if not fits:
        return state
    found = drop(replace(wider, best=fits[0]))
    one = found.best
    if at_bounds(library, one.effects) or there not in one.names:
        return state
    fewer = len(one.effects) < len(best.effects)
    as_good = one.fit.cost < best.fit.cost or not setting.better(best, one)
    clearly = one.fit.cost < best.fit.cost and setting.better(one, best)
    if not (clearly or (fewer and as_good)):
        return state
    return found.noted(effects=one.effects, error=one.error, taken=True)
