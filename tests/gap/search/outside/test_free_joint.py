"""A joint whose torque is set free: knocks at one, an effect at another."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hidden_arms import TURNTABLES, TWO_LINKS, record
from small_problems import last_state

from rlco.gap.compare.arm.following_torque import following_torque
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.arm.torque_over_time import (
    TorqueOverTime,
    finer_knots,
    torque_over_time,
    with_amounts,
)
from rlco.gap.compare.problem import Candidate, Divergence, Hypothesis, Instability
from rlco.gap.compare.stability.instability import UnstableModelError
from rlco.gap.compare.verdict import Verdict
from rlco.gap.logs.log import Array
from rlco.gap.report.verdict_text import outside_line
from rlco.gap.search.find_gap import additions, find_gap
from rlco.gap.search.outside.free_joint import free_joint, without_small
from rlco.gap.search.state import State
from rlco.gap.search.steps.start import start
from rlco.physics.effects import EFFECTS, AppliedEffect

# Of 0.3 s, at these times of every recording [s]; half a sine [N m].
KNOCKS, LONG, STRONG = (0.8, 2.6), 0.3, 3.0
OTHERS = ("viscous_damping", "coulomb_friction", "actuator_gain", "joint_offset")


def _knock(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    since = data.time - np.array(KNOCKS)
    within = since[(since >= 0.0) & (since < LONG)]
    data.qfrc_applied[0] = STRONG * np.sin(np.pi * within / LONG).sum()


def _damped(model: mujoco.MjModel) -> None:
    model.dof_damping[1] += 0.3


def _problem(xml: str = TWO_LINKS, *, quiet: bool = False) -> ArmRollouts:
    log = record(_damped, None if quiet else _knock, xml=xml, episodes=4)
    return ArmRollouts(mujoco.MjSpec.from_string(xml), log, np.full(2, 4e-4))


def _others(problem: ArmRollouts) -> set[str]:
    every = [*problem.candidates(), *problem.candidates(uncommon=True)]
    return {one.name for one in every} - set(OTHERS)


@pytest.fixture(scope="module")
def knocked() -> Verdict:
    problem = _problem()
    return find_gap(problem, exclude=_others(problem))


@pytest.mark.slow
@pytest.mark.thorough
def test_an_effect_is_named_beside_knocks_at_another_joint(knocked: Verdict) -> None:
    (named,) = knocked.effects
    assert (named.name, named.target) == ("viscous_damping", "elbow")
    damping = named.parameters["damping"]
    assert damping.low < 0.3 < damping.high
    assert damping.value == pytest.approx(0.3, rel=0.05)


@pytest.mark.slow
def test_the_knocks_are_drawn_at_their_joint_and_times(knocked: Verdict) -> None:
    assert knocked.free_form is not None
    assert knocked.free_form.target == "shoulder"
    assert "predicts none" in outside_line(knocked.free_form)
    time, torque = knocked.free_form.over_time
    # Recordings of four seconds less a frame follow one another.
    begins = np.arange(4) * 3.98
    middle = (begins[:, None] + np.array(KNOCKS) + 0.5 * LONG).ravel()
    nearest = np.abs(time[:, None] - middle).min(axis=1)
    assert torque[nearest < 0.06].mean() == pytest.approx(STRONG, rel=0.15)
    assert np.abs(torque[nearest > 0.4]).max() < 0.1 * STRONG


@pytest.mark.slow
def test_what_remains_is_that_of_the_model_without_the_knocks(knocked: Verdict) -> None:
    problem = _problem()
    (rows,) = problem.residuals([knocked.hypothesis])
    held = np.isin(problem.layout.recording, knocked.heldout)
    assert knocked.gap.after_heldout == pytest.approx(
        float(np.sqrt(np.mean(rows[held] ** 2)))
    )
    assert knocked.unexplained["target"] == "shoulder"


def _weak(model: mujoco.MjModel) -> None:
    model.actuator_gainprm[1, 0] *= 0.6
    model.actuator_biasprm[1, 1] *= 0.6


def _ripple(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    data.qfrc_applied[0] = 0.5 * np.sin(14.0 * data.qpos[0])


@pytest.mark.thorough
def test_an_effect_is_named_beside_a_torque_that_the_library_lacks() -> None:
    log = record(_weak, _ripple)
    problem = ArmRollouts(mujoco.MjSpec.from_string(TWO_LINKS), log, np.full(2, 4e-4))
    near = {"actuator_gain", "coulomb_friction", "viscous_damping", "torque_bias"}
    verdict = find_gap(problem, exclude=tuple(set(EFFECTS) - near))
    (named,) = verdict.effects
    assert (named.name, named.target) == ("actuator_gain", "elbow")
    assert named.parameters["factor"].value == pytest.approx(0.6, rel=0.01)
    assert verdict.free_form is not None
    assert verdict.free_form.target == "shoulder"


def test_where_an_effect_explains_all_no_joint_is_set_free() -> None:
    problem = _problem(quiet=True)
    state = last_state(additions(start(problem, exclude=_others(problem))))
    assert last_state(free_joint(state, additions)) is state


def _check_columns(problem: ArmRollouts, free: TorqueOverTime) -> None:
    """Check the columns of hats against a rollout with a little of each."""
    amounts = 0.02 * np.random.default_rng(0).normal(size=len(free.time))
    before, after = (
        one.residuals([Hypothesis()])[0]
        for one in (problem, with_amounts(problem, free, amounts))
    )
    change = amounts @ free.moved
    np.testing.assert_allclose(after - before, change, atol=0.03 * np.abs(change).max())


def test_the_columns_are_what_a_small_torque_over_time_does() -> None:
    problem = _problem(quiet=True)
    free = torque_over_time(problem, Hypothesis(), "shoulder")
    assert free is not None
    _check_columns(problem, free)


def _steps(problem: ArmRollouts) -> list[Array]:
    step = float(problem.model.opt.timestep)
    return [
        step * np.arange(round(o.seconds / step) + 1) for o in problem.log.recordings
    ]


def test_columns_of_hats_that_are_closer_at_the_ends_of_knocks_are_so_too() -> None:
    problem = _problem(quiet=True)
    knocks = {i: ((t > 0.82) & (t < 1.27)) * 1.0 for i, t in enumerate(_steps(problem))}
    knots = finer_knots(problem, knocks)
    for times in knots:
        close = times[1:][np.diff(times) < 0.05]
        assert {0.825, 0.85, 0.875, 0.9} <= set(close.round(6))
        assert {1.225, 1.25, 1.275, 1.3} <= set(close.round(6))
        assert len(close) < 15
    free = torque_over_time(problem, Hypothesis(), "shoulder", knots)
    assert free is not None
    _check_columns(problem, free)


def test_a_torque_that_changes_slowly_needs_no_more_hats() -> None:
    problem = _problem(quiet=True)
    slow = {i: np.sin(time) for i, time in enumerate(_steps(problem))}
    free = torque_over_time(problem, Hypothesis(), "shoulder")
    assert free is not None
    assert sum(map(len, finer_knots(problem, slow))) == len(free.time)


def test_a_knock_that_a_motor_cannot_hold_against_is_found_whole() -> None:
    weak = TURNTABLES.replace('kp="40" kv="2"', 'kp="40" kv="2" forcerange="-1 1"')
    begins, lasts, strong = 1.2, 0.25, 6.0

    def push(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        within = begins <= data.time < begins + lasts
        data.qfrc_applied[0] = strong if within else 0.0

    log = record(None, push, xml=weak, episodes=2)
    problem = ArmRollouts(mujoco.MjSpec.from_string(weak), log, np.full(2, 4e-4))
    (fell,) = problem.residuals([Hypothesis()])
    assert np.abs(fell).max() > 1.0  # [rad]
    found = following_torque(problem, Hypothesis(), "shoulder")
    assert found is not None
    time = float(problem.model.opt.timestep) * np.arange(len(found[0]))
    middle = (time > begins + 0.1) & (time < begins + lasts - 0.05)
    assert found[0][middle].mean() == pytest.approx(strong, rel=0.05)
    quiet = (time < begins - 0.2) | (time > begins + lasts + 0.4)
    assert np.abs(found[0][quiet].mean()) < 0.02 * strong
    (rows,) = problem.with_torques("shoulder", found).residuals([Hypothesis()])
    # The joint follows within the acceleration over the square of the spring's rate.
    assert np.abs(rows).max() < 1.2 * strong / 0.012 / 40.0**2
    assert np.sqrt(np.mean(rows**2)) < 0.1 * np.sqrt(np.mean(fell**2))


def test_a_torque_from_outside_acts_beside_a_motor_at_its_limit() -> None:
    weak = TURNTABLES.replace('kp="40" kv="2"', 'kp="40" kv="2" forcerange="-1 1"')

    def push(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        data.qfrc_applied[0] = 0.7

    log = record(None, push, xml=weak, episodes=2, noise=0.0)
    problem = ArmRollouts(mujoco.MjSpec.from_string(weak), log, np.full(2, 4e-4))
    half = {
        index: np.full(round(one.seconds / 0.004) + 1, 0.35)
        for index, one in enumerate(log.recordings)
    }
    pushed = problem.with_torques("shoulder", half).with_torques("shoulder", half)
    np.testing.assert_allclose(pushed.residuals([Hypothesis()]), 0.0, atol=1e-9)


def test_torques_from_outside_act_at_one_joint() -> None:
    problem = _problem(quiet=True).with_torques("shoulder", {0: np.ones(3)})
    with pytest.raises(ValueError, match="at 'shoulder', so none can at 'elbow'"):
        problem.with_torques("elbow", {0: np.ones(3)})


@pytest.mark.thorough
def test_a_robot_that_runs_away_with_the_torque_alone_is_not_searched(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = _problem()
    state = last_state(additions(start(problem, exclude=_others(problem))))
    unstable = Instability((Divergence(0, "episode 0", 0.1),), advice=("Check it.",))

    def runs_away(*_: object, **__: object) -> State:
        raise UnstableModelError(unstable)

    monkeypatch.setattr("rlco.gap.search.outside.free_joint.start", runs_away)
    assert last_state(free_joint(state, additions)) is state


def test_errors_of_an_encoder_are_hats_of_its_position_alone() -> None:
    problem = _problem(quiet=True)
    free = torque_over_time(problem, Hypothesis(), "elbow")
    assert free is not None
    # Hats add up to one: all of them together are a constant error of 0.1 rad.
    at_elbow = problem.layout.channel == 1
    np.testing.assert_allclose(free.misread.sum(axis=0), np.where(at_elbow, -0.1, 0.0))
    # The first is of the smallest positions, the last of the largest.
    position = np.concatenate([one.position[:, 1] for one in problem.log.recordings])
    lowest = free.misread[0][at_elbow].argmin()
    assert position[lowest] < np.quantile(position, 0.02)


def test_only_what_explains_much_beside_a_free_joint_is_kept() -> None:
    problem = _problem(quiet=True)
    state = start(problem, exclude=_others(problem))
    damping = AppliedEffect("viscous_damping", "elbow", {"damping": 0.3})
    little = AppliedEffect("coulomb_friction", "shoulder", {"frictionloss": 1e-3})
    state, (both,) = state.fit([(damping, little)])
    kept = without_small(replace(state, best=both), 0.1).best
    assert kept.names == {Candidate("viscous_damping", "elbow")}
