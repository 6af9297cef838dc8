"""Small effects in a model that is right but for them, and in one that is not."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from hidden_arms import FPS, TURNTABLES, TWO_LINKS, Hide, record
from numpy.typing import NDArray

from rlco.gap.arm_rollouts import ArmRollouts
from rlco.gap.search import search_effects
from rlco.gap.search_exact import with_exact_model
from rlco.gap.search_start import start_search
from rlco.gap.search_state import Search
from rlco.gap.verdict import conclude

_DAMPING = 1.045  # times its own: by more than the spread's three per cent, not much


def _searched(hide: Hide, xml: str = TWO_LINKS, **options: Any) -> Search:
    spec, log = mujoco.MjSpec.from_string(xml), record(hide, xml=xml, **options)
    search = start_search(ArmRollouts(spec, log, np.full(2, 4e-4)))
    search_effects(search)
    return search


def _slow(seed: int) -> NDArray[np.float64]:
    """To and fro in four seconds, from rest."""
    wave = 1.0 - np.cos(2 * np.pi * np.arange(6 * FPS) / (4 * FPS))
    return wave[:, None] * np.random.default_rng(seed).uniform(0.2, 0.5, 2)


def _damped(model: mujoco.MjModel) -> None:
    model.dof_damping[0] *= _DAMPING


def _damped_and_off(model: mujoco.MjModel) -> None:
    _damped(model)
    random = np.random.default_rng(3)
    for numbers in (model.body_mass, model.body_inertia, model.dof_armature):
        numbers *= 1.0 + random.normal(0.0, 0.03, numbers.shape)


def test_one_number_that_is_off_by_more_than_the_spread_is_named() -> None:
    search = _searched(_damped)
    assert search.best is not None
    assert not search.best.effects  # a spread of all numbers would do
    found = with_exact_model(search).best
    assert found is not None
    (effect,) = found.effects
    assert (effect.name, effect.target) == ("viscous_damping", "shoulder")
    own = mujoco.MjModel.from_xml_string(TWO_LINKS).dof_damping[0]
    assert effect.values[0] == pytest.approx(own * (_DAMPING - 1.0), rel=0.05)


def test_it_is_not_where_other_numbers_are_off_too() -> None:
    search = _searched(_damped_and_off)
    assert with_exact_model(search) is search


def test_friction_is_known_no_better_than_the_stiffness_that_it_is_told_by() -> None:
    """Quasi-statically a servo shows their ratio, and nothing where nothing rubs."""

    def rubs(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[1] = 0.3
        model.actuator_gainprm[1, 0] *= 1.02
        model.actuator_biasprm[1, 1] *= 1.02
        model.dof_damping[:] *= 0.97

    search = _searched(rubs, TURNTABLES, motion=_slow)
    verdict = conclude(with_exact_model(search), 0.0, complete=True)
    (finding,) = verdict.effects
    assert finding.name == "coulomb_friction"
    value = finding.parameters["frictionloss"]
    assert value.low < 0.3 < value.high
    assert value.high - value.value > 0.02 * value.value
