"""Starts that are found by trying sizes, where the nearest fit is not the best."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hidden_arms import TURNTABLES, record

from rlco.gap.arm_rollouts import ArmRollouts
from rlco.gap.search import first_look
from rlco.gap.search_jumps import better_start
from rlco.gap.search_start import start_search
from rlco.physics.effects import AppliedEffect

_HIDDEN = 0.03  # N m


def _rubs(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[1] = _HIDDEN


def _friction(value: float) -> tuple[AppliedEffect, ...]:
    return (AppliedEffect("coulomb_friction", "elbow", {"frictionloss": value}),)


def test_a_size_that_is_far_off_gives_way_to_one_that_is_near() -> None:
    spec, log = mujoco.MjSpec.from_string(TURNTABLES), record(_rubs, xml=TURNTABLES)
    look = first_look(start_search(ArmRollouts(spec, log, np.full(2, 4e-4))))
    ((effect,),) = better_start(look, _friction(0.005))
    assert effect.values[0] == pytest.approx(_HIDDEN, rel=0.2)
    assert not better_start(look, _friction(_HIDDEN))


def _soft(model: mujoco.MjModel) -> None:
    model.actuator_gainprm[1, 0] *= 0.6
    model.actuator_biasprm[1, 1] *= 0.6


def test_of_a_factor_below_one_other_factors_below_one_are_tried() -> None:
    spec, log = mujoco.MjSpec.from_string(TURNTABLES), record(_soft, xml=TURNTABLES)
    look = first_look(start_search(ArmRollouts(spec, log, np.full(2, 4e-4))))
    near_one = (AppliedEffect("actuator_gain", "elbow", {"factor": 0.97}),)
    ((effect,),) = better_start(look, near_one)
    assert effect.values[0] == pytest.approx(0.6, abs=0.1)
