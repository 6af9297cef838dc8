"""Effects that leave much are held against a search that began elsewhere."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hidden_arms import TURNTABLES, record

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Candidate
from rlco.gap.search.find_gap import additions
from rlco.gap.search.state import State
from rlco.gap.search.steps.elsewhere import elsewhere, leaves_much
from rlco.gap.search.steps.start import start
from rlco.physics.effects import AppliedEffect

pytestmark = pytest.mark.slow

FRICTION = AppliedEffect("coulomb_friction", "shoulder", {"frictionloss": 0.4})
DAMPING = AppliedEffect("viscous_damping", "elbow", {"damping": 0.6})
NAMES = {Candidate(e.name, e.target) for e in (FRICTION, DAMPING)}
WRONG = (
    AppliedEffect("actuator_gain", "shoulder", {"factor": 0.9}),
    AppliedEffect("armature", "elbow", {"armature": 0.01}),
)


def _hide(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[0] += 0.4
    model.dof_damping[1] += 0.6


@pytest.fixture(scope="module")
def astray() -> State:
    """A search that ended with two wrong effects, and fitted single ones before."""
    spec = mujoco.MjSpec.from_string(TURNTABLES)
    log = record(_hide, xml=TURNTABLES, episodes=3)
    state = start(ArmRollouts(spec, log, np.full(2, 4e-4)))
    state, _ = state.fit([[effect] for effect in (FRICTION, DAMPING, *WRONG)])
    state, (wrong, *_) = state.fit([WRONG])
    return replace(state, best=wrong, ended=True)


def test_wrong_effects_that_leave_much_give_way(astray: State) -> None:
    assert leaves_much(astray)
    states = list(elsewhere(astray, additions))
    assert states[-1].best.names == NAMES
    assert not leaves_much(states[-1])


def test_until_a_search_elsewhere_is_whole_the_best_stay(astray: State) -> None:
    first = next(elsewhere(astray, additions))
    assert first.best is astray.best
    # Pairs of the single effects are fitted by then.
    assert frozenset(NAMES) in first.scores


def test_effects_that_leave_only_noise_are_held_against_nothing(astray: State) -> None:
    state, (right, *_) = astray.fit([(FRICTION, DAMPING)])
    state = replace(state, best=right)
    assert list(elsewhere(state, additions)) == []
