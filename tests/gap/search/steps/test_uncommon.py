"""Torques over position are named where the common effects leave something."""

from __future__ import annotations

import re
from collections.abc import Mapping

import mujoco
import numpy as np
import pytest
from hidden_arms import TURNTABLES, Act, Hide, record

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.verdict import Value, Verdict
from rlco.gap.search.find_gap import additions, find_gap
from rlco.gap.search.steps.start import start
from rlco.gap.search.steps.uncommon import uncommon

# What else a search could name is not the matter here.
COMMON = {"coulomb_friction", "viscous_damping", "joint_stiffness", "torque_bias"}
HALF = 0.5  # amplitude [N m]
TRUE_COUNT, PHASE = 37.3, 0.4


def _problem(hide: Hide | None, act: Act | None) -> ArmRollouts:
    log = record(hide, act, xml=TURNTABLES)
    return ArmRollouts(mujoco.MjSpec.from_string(TURNTABLES), log, np.full(2, 4e-4))


def _others(problem: ArmRollouts) -> set[str]:
    return {one.name for one in problem.candidates()} - COMMON


def _rubs(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[0] += 0.4


def _cogs(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    data.qfrc_applied[0] = HALF * np.sin(TRUE_COUNT * data.qpos[0] + PHASE)


def _hardens(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    data.qfrc_applied[0] = -6.0 * (data.qpos[0] - 0.2) ** 3


def _named(verdict: Verdict) -> Mapping[tuple[str, str | None], Mapping[str, Value]]:
    return {(one.name, one.target): one.parameters for one in verdict.effects}


def _holds(value: Value, true: float) -> bool:
    return value.low < true < value.high


@pytest.mark.thorough
def test_cogging_beside_friction_is_named_with_the_number_of_its_waves() -> None:
    problem = _problem(_rubs, _cogs)
    found = find_gap(problem, exclude=_others(problem))
    named = _named(found)
    assert set(named) == {("coulomb_friction", "shoulder"), ("cogging", "shoulder")}
    wave = named["cogging", "shoulder"]
    assert _holds(wave["amplitude"], HALF)
    assert _holds(wave["count"], TRUE_COUNT)
    assert wave["count"].high - wave["count"].low < 0.1
    assert found.gap.after_heldout < 1.1 * found.gap.noise_floor
    assert found.free_form is None


@pytest.mark.slow
def test_a_hardening_spring_is_named_instead_of_a_linear_one() -> None:
    problem = _problem(None, _hardens)
    found = find_gap(problem, exclude=_others(problem))
    (((name, target), values),) = _named(found).items()
    assert (name, target) == ("hardening_spring", "shoulder")
    assert _holds(values["hardening"], 6.0)
    assert _holds(values["rest"], 0.2)


@pytest.mark.slow
def test_what_the_common_effects_explain_is_held_against_nothing() -> None:
    problem = _problem(_rubs, None)
    state = start(problem, exclude=_others(problem))
    *_, state = additions(state)
    assert list(uncommon(state, additions)) == []


@pytest.mark.thorough
def test_a_knock_is_no_uncommon_effect() -> None:
    def knocks(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_applied[0] = 2.0 * (1.0 < data.time < 1.5)

    problem = _problem(None, knocks)
    found = find_gap(problem, exclude=_others(problem))
    assert not {name for name, _ in _named(found)} & {"cogging", "hardening_spring"}


def test_an_effect_that_is_left_out_is_not_tried() -> None:
    problem = _problem(None, _cogs)
    every = {one.name for one in problem.candidates()}
    uncommon_too = {"cogging", "hardening_spring"}
    state = start(problem, exclude=every | uncommon_too)
    assert list(uncommon(state, additions)) == []


@pytest.mark.slow
def test_friction_by_direction_is_said_where_it_is_named_as_two_torques() -> None:
    def pushes(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_applied[0] = 0.15

    problem = _problem(_rubs, pushes)  # 0.4 N m: 0.25 forwards, 0.55 backwards
    found = find_gap(problem, exclude=_others(problem))
    assert {name for name, _ in _named(found)} == {"coulomb_friction", "torque_bias"}
    (remark,) = found.remarks
    sizes = re.search(r"at shoulder .* (\S+) forwards and (\S+) backwards", remark)
    assert sizes is not None
    forward, backward = map(float, sizes.groups())
    assert (forward, backward) == pytest.approx((0.25, 0.55), abs=0.02)
