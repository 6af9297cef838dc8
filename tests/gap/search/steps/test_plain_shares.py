"""What single effects explain by themselves, where a search could name none."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hidden_arms import TWO_LINKS, record

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.search.find_gap import additions
from rlco.gap.search.steps import plain_shares as module
from rlco.gap.search.steps.closing import residual
from rlco.gap.search.steps.plain_shares import plain_shares
from rlco.gap.search.steps.start import start
from rlco.gap.search.verdict import conclude

pytestmark = pytest.mark.slow


def _ripple(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Push by what is left out."""
    data.qfrc_applied[0] = 0.5 * np.sin(14.0 * data.qpos[0])


def _weak(model: mujoco.MjModel) -> None:
    model.actuator_gainprm[1, 0] *= 0.6
    model.actuator_biasprm[1, 1] *= 0.6


@pytest.mark.thorough
def test_what_explains_half_of_an_unexplained_gap_is_the_first_of_the_closest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = ArmRollouts(
        mujoco.MjSpec.from_string(TWO_LINKS), record(_weak, _ripple), np.full(2, 4e-4)
    )
    # Without the steps that would set the joint free, see test_free_joint.py.
    *_, state = additions(start(problem))
    verdict = conclude(residual(plain_shares(state)))
    assert verdict.verdict == "unexplained"
    first, share = verdict.closest[0]
    assert (first.name, first.target) == ("actuator_gain", "elbow")
    assert share > 0.9
    # What the tolerance of all parameters together hides is ranked by itself.
    shares = [share for _, share in verdict.closest]
    assert shares == sorted(shares, reverse=True)
    # What the search had chosen is fitted wherever a screening ranks it.
    assert ("actuator_gain", "elbow") in [
        (e.name, e.target) for e in state.best.effects
    ]
    monkeypatch.setattr(module, "TRIED", 0)
    first, share = conclude(residual(plain_shares(state))).closest[0]
    assert (first.name, first.target) == ("actuator_gain", "elbow")
    assert share > 0.9
