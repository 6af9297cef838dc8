"""Starts that are found by trying sizes, where the nearest fit is not the best."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hidden_arms import TURNTABLES, record

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.search.discontinuous import better_start
from rlco.gap.search.steps.start import start
from rlco.physics.effects import AppliedEffect

_HIDDEN = 0.03  # N m


def _rubs(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[1] = _HIDDEN


def _friction(value: float) -> tuple[AppliedEffect, ...]:
    return (AppliedEffect("coulomb_friction", "elbow", {"frictionloss": value}),)


def test_a_size_that_is_far_off_gives_way_to_one_that_is_near() -> None:
    spec, log = mujoco.MjSpec.from_string(TURNTABLES), record(_rubs, xml=TURNTABLES)
    subset = start(ArmRollouts(spec, log, np.full(2, 4e-4))).screening_setting()
    ((effect,),) = better_start(subset, _friction(0.005))
    assert effect.values[0] == pytest.approx(_HIDDEN, rel=0.2)
    assert not better_start(subset, _friction(_HIDDEN))


def _soft(model: mujoco.MjModel) -> None:
    model.actuator_gainprm[1, 0] *= 0.6
    model.actuator_biasprm[1, 1] *= 0.6


@pytest.mark.slow
def test_of_a_factor_below_one_other_factors_below_one_are_tried() -> None:
    spec, log = mujoco.MjSpec.from_string(TURNTABLES), record(_soft, xml=TURNTABLES)
    subset = start(ArmRollouts(spec, log, np.full(2, 4e-4))).screening_setting()
    near_one = (AppliedEffect("actuator_gain", "elbow", {"factor": 0.97}),)
    ((effect,),) = better_start(subset, near_one)
    assert effect.values[0] == pytest.approx(0.6, abs=0.1)
