"""What the whole search says of small arms with and without something hidden."""

from __future__ import annotations

from functools import cache
from typing import Any

import mujoco
import numpy as np
import pytest
from hidden_arms import TWO_LINKS, Act, Hide, record
from small_problems import ball_problem

from rlco.errors import DataError, UnknownNameError
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.verdict import Verdict
from rlco.gap.search import find_gap as find_gap_module
from rlco.gap.search.find_gap import find_gap
from rlco.physics.effects import EFFECTS

pytestmark = pytest.mark.slow

_NOISE = np.full(2, 4e-4)


def _verdict(
    hide: Hide | None = None, act: Act | None = None, **options: Any
) -> Verdict:
    log = record(hide, act)
    return find_gap(
        ArmRollouts(mujoco.MjSpec.from_string(TWO_LINKS), log, _NOISE), **options
    )


def _names(verdict: Verdict) -> set[tuple[str, str | None]]:
    return {(finding.name, finding.target) for finding in verdict.effects}


def _all_but(*considered: str) -> tuple[str, ...]:
    """Return what to exclude so that a search considers a few effects."""
    return tuple(set(EFFECTS) - set(considered))


def _two(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[1] = 0.08
    model.actuator_gainprm[0, 0] *= 0.7
    model.actuator_biasprm[0, 1] *= 0.7


def _spread(model: mujoco.MjModel) -> None:
    random = np.random.default_rng(5)
    for numbers in (model.body_mass, model.dof_damping, model.dof_armature):
        numbers *= 1 + random.normal(0, 0.02, numbers.shape)


def _ripple(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    data.qfrc_applied[0] = 0.5 * np.sin(14.0 * data.qpos[0])


@cache
def _found_two() -> Verdict:
    return _verdict(_two)


def test_two_effects_at_once_are_named_with_their_joints_and_sizes() -> None:
    verdict = _found_two()
    assert verdict.verdict == "named"
    assert _names(verdict) == {
        ("coulomb_friction", "elbow"),
        ("actuator_gain", "shoulder"),
    }
    for finding in verdict.effects:
        (value,) = finding.parameters.values()
        truth = {"coulomb_friction": 0.08, "actuator_gain": 0.7}[finding.name]
        assert value.value == pytest.approx(truth, rel=0.03)
        # Nine intervals of ten hold the truth, one of twice the width nearly always.
        assert abs(value.value - truth) < value.high - value.low
        assert not finding.rivals


def test_the_gap_shrinks_to_the_noise_on_recordings_that_were_not_fitted() -> None:
    gap = _found_two().gap
    assert gap.before_heldout > 5 * gap.noise_floor
    assert gap.after_heldout == pytest.approx(gap.noise_floor, rel=0.1)


@pytest.mark.thorough
@pytest.mark.parametrize("hide", [None, _two])
def test_a_slow_controller_is_found_alone_and_beside_others(hide: Hide | None) -> None:
    """Only the right period fits: one step of 4 ms away is worse than none."""
    held = np.zeros(2)

    def slow(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        if round(data.time / model.opt.timestep) % 19 == 0:
            held[:] = data.ctrl
        data.ctrl[:] = held

    verdict = _verdict(hide, slow)
    beside = {("coulomb_friction", "elbow"), ("actuator_gain", "shoulder")}
    assert _names(verdict) == {("control_rate", None)} | (beside if hide else set())
    (rate,) = (one for one in verdict.effects if one.name == "control_rate")
    assert rate.parameters["period"].value == pytest.approx(19 * 0.004)


def test_a_model_that_is_a_little_off_everywhere_has_no_gap() -> None:
    verdict = _verdict(_spread)
    assert verdict.verdict == "no_gap"
    assert not verdict.effects


@pytest.mark.thorough
def test_an_effect_outside_the_library_is_left_unexplained_and_located() -> None:
    near = ("coulomb_friction", "viscous_damping", "actuator_gain", "torque_bias")
    verdict = _verdict(None, _ripple, exclude=_all_but(*near))
    assert verdict.verdict == "unexplained"
    assert not verdict.effects
    assert verdict.unexplained["target"] == "shoulder"
    assert "position" in str(verdict.unexplained["note"])


@pytest.mark.thorough
def test_what_is_excluded_is_not_named() -> None:
    def hide(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[1] = 0.15

    near = ("viscous_damping", "armature", "actuator_lag", "actuator_gain")
    verdict = _verdict(hide, exclude=_all_but(*near))
    assert "coulomb_friction" not in {name for name, _ in _names(verdict)}
    assert verdict.verdict != "named"


def test_an_interruption_keeps_the_best_so_far() -> None:
    def interrupt(said: str, part: float) -> None:
        if part > 0:
            raise KeyboardInterrupt

    verdict = _verdict(_two, on_step=interrupt)
    assert not verdict.complete
    assert ("actuator_gain", "shoulder") in _names(verdict)


@pytest.mark.thorough
def test_an_interruption_of_its_end_loses_nothing_of_a_search(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real, calls = find_gap_module.conclude, []

    def interrupted(*given: Any, **options: Any) -> Verdict:
        calls.append(given)
        if len(calls) == 1:
            raise KeyboardInterrupt
        return real(*given, **options)

    monkeypatch.setattr(find_gap_module, "conclude", interrupted)
    verdict = _verdict(_spread)
    assert verdict.complete
    assert len(calls) == 2


@pytest.mark.thorough
def test_a_motor_that_can_hardly_hold_its_arm_is_named_alone() -> None:
    def hide(model: mujoco.MjModel) -> None:
        _spread(model)  # which a falling arm shows ten times as much as a held one
        model.actuator_forcelimited[0] = True
        model.actuator_forcerange[0] = -1.5, 1.5

    near = ("torque_limit", "actuator_gain", "coulomb_friction", "payload", "armature")
    verdict = _verdict(hide, exclude=_all_but(*near))
    assert _names(verdict) == {("torque_limit", "shoulder")}
    (limit,) = verdict.effects[0].parameters.values()
    assert limit.value == pytest.approx(1.5, rel=0.05)
    # What the arm weighs is known to three per cent, and so is what holds it.
    assert limit.low < 1.5 < limit.high
    assert limit.high - limit.value > 0.04 * limit.value


def test_a_single_toss_is_refused() -> None:
    problem = ball_problem()
    with pytest.raises(DataError, match="one recording, 'toss', of which nothing can"):
        find_gap(problem)


def test_an_effect_to_leave_out_is_one_of_the_library() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'backlash'"):
        find_gap(ball_problem(), exclude=["backlsh"])
