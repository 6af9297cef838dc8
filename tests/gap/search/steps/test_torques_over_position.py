"""In logs of torques: uncommon effects are named, and a free form raises doubt."""

from __future__ import annotations

from collections.abc import Callable, Collection

import mujoco
import numpy as np
import pytest
from recorded_torques import XML, Hide, record_torques

from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.compare.verdict import Verdict
from rlco.gap.search.find_gap import find_gap

Act = Callable[[mujoco.MjModel, mujoco.MjData], None]
# What else a search could name is not the matter here.
COMMON = {"coulomb_friction", "viscous_damping", "joint_stiffness", "torque_bias"}
UNCOMMON = {"cogging", "hardening_spring"}
AMPLITUDE, COUNT = 0.06, 9.3  # [N m], [1/turn]
HARDENING = 0.1  # [N m/rad^3]


def _rubs(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[0] += 0.05


def _cogs(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    data.qfrc_applied[1] = AMPLITUDE * np.sin(COUNT * data.qpos[1] + 0.4)


def _hardens(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    data.qfrc_applied[1] = -HARDENING * (data.qpos[1] - 0.2) ** 3


def _found(
    act: Act | None, *hide: Hide, without: Collection[str] = (), episodes: int = 3
) -> Verdict:
    log = record_torques(*hide, seed=5, act=act, episodes=episodes)
    problem = TorqueLog(mujoco.MjSpec.from_string(XML), log)
    others = {one.name for one in problem.candidates()} - COMMON
    return find_gap(problem, exclude=others | {*without})


def _named(verdict: Verdict) -> set[tuple[str, str | None]]:
    return {(one.name, one.target) for one in verdict.effects}


@pytest.mark.thorough
def test_cogging_beside_friction_is_named() -> None:
    found = _found(_cogs, _rubs)
    assert _named(found) == {("cogging", "elbow"), ("coulomb_friction", "shoulder")}
    (wave,) = (one.parameters for one in found.effects if one.name == "cogging")
    assert wave["amplitude"].value == pytest.approx(AMPLITUDE, rel=0.1)
    assert wave["count"].value == pytest.approx(COUNT, abs=0.1)
    assert found.free_form is None


@pytest.mark.thorough
def test_a_hardening_spring_is_named() -> None:
    found = _found(_hardens)
    assert _named(found) == {("hardening_spring", "elbow")}
    values = found.effects[0].parameters
    assert values["hardening"].value == pytest.approx(HARDENING, rel=0.1)
    assert values["rest"].value == pytest.approx(0.2, abs=0.05)


def test_what_is_outside_is_told_at_its_joint_and_drawn() -> None:
    found = _found(_hardens, _rubs, without=UNCOMMON, episodes=6)
    assert found.verdict == "unexplained"
    form = found.free_form
    assert form is not None
    assert form.target == "elbow"
    assert form.gain > 0.15
    angle, torque = form.over_position
    hidden = -HARDENING * (angle - 0.2) ** 3
    # Six knots do not bend as it does.
    np.testing.assert_allclose(torque, hidden, atol=0.2 * np.abs(hidden).max())


@pytest.mark.thorough
def test_right_names_raise_no_doubt() -> None:
    def damped(model: mujoco.MjModel) -> None:
        model.dof_damping[1] += 0.08

    found = _found(None, _rubs, damped, episodes=6)
    assert _named(found) == {
        ("coulomb_friction", "shoulder"),
        ("viscous_damping", "elbow"),
    }
    assert found.free_form is None
