"""Courses of a torque from outside: slow, but for knocks, or an encoder that errs."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hidden_arms import TURNTABLES, TWO_LINKS, Act, Hide, record
from small_problems import last_state

from rlco.gap.compare.arm.encoder_error import at_times, encoder_error
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.segments import command_steps
from rlco.gap.logs.log import Array
from rlco.gap.report.verdict_text import outside_line
from rlco.gap.search.find_gap import additions
from rlco.gap.search.outside.course import USUAL, Begun, Course, begun
from rlco.gap.search.outside.free_joint import free_joint
from rlco.gap.search.state import State
from rlco.gap.search.steps.start import start
from rlco.physics.effects import AppliedEffect

# Of 0.3 s, at these times of every recording [s]; half a sine [N m].
KNOCKS, LONG, STRONG = (0.8, 2.6), 0.3, 3.0


def _knock(time: Array) -> Array:
    since = np.asarray(time)[..., None] - np.array(KNOCKS)
    within = (since >= 0.0) & (since < LONG)
    return STRONG * np.sum(within * np.sin(np.pi * since / LONG), axis=-1)


@pytest.fixture(scope="module")
def quiet() -> ArmRollouts:
    log = record(xml=TURNTABLES, episodes=2)
    return ArmRollouts(mujoco.MjSpec.from_string(TURNTABLES), log, np.full(2, 4e-4))


def _clocks(problem: ArmRollouts) -> list[Array]:
    step = float(problem.model.opt.timestep)
    return [command_steps(one, step) for one in problem.log.recordings]


def _drift(time: Array) -> Array:
    return np.asarray(0.4 + 0.2 * time)


def test_a_drift_needs_few_numbers_and_a_knock_many_but_not_for_long(
    quiet: ArmRollouts,
) -> None:
    clocks = _clocks(quiet)
    torque = {i: _drift(t) + _knock(t) for i, t in enumerate(clocks)}
    found = begun(quiet, "shoulder", torque, USUAL)
    assert found.free.all()
    for times, own in zip(found.knots, found.torques, strict=True):
        within = _knock(times) > 0.0
        assert np.diff(times[within]).min() < 0.05
        away = np.abs(times[:, None] - np.add(KNOCKS, LONG / 2)).min(axis=1)
        assert (away > 0.5).sum() <= 4  # a knot in 2.5 s, and those at the ends
        expected = _drift(times) + _knock(times)
        np.testing.assert_allclose(own, expected, atol=0.05 * STRONG)


def test_the_part_that_knocks_is_nothing_before_and_after_them(
    quiet: ArmRollouts,
) -> None:
    torque = {i: _drift(t) + _knock(t) for i, t in enumerate(_clocks(quiet))}
    found = begun(quiet, "shoulder", torque, Course(knocks=True))
    times, own = np.concatenate(found.knots), np.concatenate(found.torques)
    np.testing.assert_allclose(own, _knock(times), atol=0.05 * STRONG)
    assert not own[~found.free].any()
    assert 0.0 < found.free.mean() < 1.0
    # A hat that may change reaches no further than into what is next to an event.
    for clock, free in zip(found.knots, _split(found), strict=True):
        inner = np.flatnonzero(free)
        assert (clock[inner + 1] - clock[inner - 1]).max() < 0.1


def _split(found: Begun) -> list[Array]:
    """Return by recording which hats may change."""
    ends = np.cumsum([len(one) for one in found.knots])[:-1]
    return np.split(found.free, ends)


def test_a_knock_is_what_is_sudden_beside_the_motion(quiet: ArmRollouts) -> None:
    def damping(index: int, time: Array) -> Array:
        recording = np.full(len(time), index)
        _, velocity = at_times(quiet, "shoulder", recording, time)
        return np.asarray(-0.6 * velocity)

    torque = {i: damping(i, t) + _knock(t) for i, t in enumerate(_clocks(quiet))}
    assert max(np.abs(damping(i, t)).max() for i, t in enumerate(_clocks(quiet))) > 1.5
    found = begun(quiet, "shoulder", torque, Course(knocks=True))
    times, own = np.concatenate(found.knots), np.concatenate(found.torques)
    np.testing.assert_allclose(own, _knock(times), atol=0.05 * STRONG)
    assert _knock(times)[found.free].mean() > 0.2 * STRONG


def test_a_knock_is_found_in_noise(quiet: ArmRollouts) -> None:
    """A torque that measured positions need is rough from step to step; knocks last."""
    random = np.random.default_rng(0)
    torque = {
        i: _knock(t) + random.normal(0.0, STRONG / 4, len(t))
        for i, t in enumerate(_clocks(quiet))
    }
    found = begun(quiet, "shoulder", torque, Course(knocks=True))
    for clock, free in zip(found.knots, _split(found), strict=True):
        away = np.abs(clock[:, None] - np.add(KNOCKS, LONG / 2))
        assert (away < LONG / 6).any(axis=0).all()
        assert free[(away < LONG / 6).any(axis=1)].all()
        assert not free[(away > LONG).all(axis=1)].any()


def test_a_torque_that_swings_has_no_knocks(quiet: ArmRollouts) -> None:
    torque = {i: np.sin(6.0 * t) for i, t in enumerate(_clocks(quiet))}
    found = begun(quiet, "shoulder", torque, USUAL)
    assert max(map(len, found.knots)) <= 3


def test_a_torque_that_drifts_alone_takes_no_knocks(quiet: ArmRollouts) -> None:
    torque = {i: _drift(t) + _knock(t) for i, t in enumerate(_clocks(quiet))}
    found = begun(quiet, "shoulder", torque, Course(drifts=True))
    for times, own in zip(found.knots, found.torques, strict=True):
        assert len(times) <= 3
        np.testing.assert_allclose(own, _drift(times), atol=0.1)


AMPLITUDE, PHASE = 0.06, 0.5  # of a disc that is not centred [rad]


def _eccentric(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    data.ctrl[0] -= AMPLITUDE * np.sin(data.qpos[0] + PHASE)


def _error(read: Array) -> Array:
    """Return how much too much is read where something is read."""
    true = read
    for _ in range(20):
        true = read - AMPLITUDE * np.sin(true + PHASE)
    return np.asarray(AMPLITUDE * np.sin(true + PHASE))


def _with_eccentric(hide: Hide | None, act: Act) -> ArmRollouts:
    log = record(hide, act, xml=TWO_LINKS, episodes=6)
    for one in log.recordings:
        position = one.position[:, 0]
        position += AMPLITUDE * np.sin(position + PHASE)
    return ArmRollouts(mujoco.MjSpec.from_string(TWO_LINKS), log, np.full(2, 4e-4))


@pytest.fixture(scope="module")
def eccentric() -> ArmRollouts:
    def damped(model: mujoco.MjModel) -> None:
        model.dof_damping[0] += 0.3

    return _with_eccentric(damped, _eccentric)


DAMPED = Hypothesis((AppliedEffect("viscous_damping", "shoulder", {"damping": 0.3}),))


def _size(problem: ArmRollouts, rows: Array) -> float:
    """Return the root mean square of residuals over the noise."""
    return float(np.sqrt(np.mean(rows**2)) / problem.noise[0])


def test_with_its_error_put_right_only_noise_is_left(eccentric: ArmRollouts) -> None:
    (before,) = eccentric.residuals([DAMPED])
    assert _size(eccentric, before) > 3.0
    (after,) = eccentric.with_encoder_error("shoulder", _error).residuals([DAMPED])
    assert _size(eccentric, after) == pytest.approx(1.0, abs=0.06)


def test_the_changes_by_an_encoders_error_leave_as_little(
    eccentric: ArmRollouts,
) -> None:
    found = encoder_error(eccentric, DAMPED, "shoulder", range(6))
    assert found is not None
    (before,) = eccentric.residuals([DAMPED])
    after = before + _error(found.position) @ found.moved
    assert _size(eccentric, after) < 1.3


def test_errors_that_are_put_right_one_after_the_other_add_up(
    eccentric: ArmRollouts,
) -> None:
    def half(read: Array) -> Array:
        return 0.5 * _error(read)

    once = eccentric.with_encoder_error("shoulder", _error)
    twice = eccentric.with_encoder_error("shoulder", half)
    twice = twice.with_encoder_error("shoulder", half)
    np.testing.assert_allclose(
        *(one.residuals([DAMPED]) for one in (once, twice)), atol=1e-9
    )


def test_an_error_that_grows_with_the_angle_makes_no_residual_smaller(
    quiet: ArmRollouts,
) -> None:
    # A linear servo follows a scaled encoder as it follows a right one.
    slow = AppliedEffect("actuator_lag", "shoulder", {"time_constant": 0.05})
    scaled = quiet.with_encoder_error("shoulder", lambda read: 0.5 * read)
    sizes = [
        _size(quiet, one.residuals([Hypothesis((slow,))])[0]) for one in (quiet, scaled)
    ]
    assert sizes[0] > 10.0
    assert sizes[1] == pytest.approx(sizes[0], rel=0.2)


def _searched(problem: ArmRollouts, *names: str) -> State:
    every = [*problem.candidates(), *problem.candidates(uncommon=True)]
    exclude = {one.name for one in every} - set(names)
    state = last_state(additions(start(problem, exclude=exclude)))
    return last_state(free_joint(state, additions))


@pytest.mark.slow
@pytest.mark.thorough
def test_an_effect_is_named_at_the_joint_whose_encoder_errs(
    eccentric: ArmRollouts,
) -> None:
    found = _searched(eccentric, "viscous_damping", "coulomb_friction", "encoder_scale")
    (effect,) = found.best.effects
    assert (effect.name, effect.target) == ("viscous_damping", "shoulder")
    # Its encoder errs freely, so the library's error of it is no effect besides.
    scales = {c.target for c in found.setting.library if c.name == "encoder_scale"}
    assert scales == {"elbow"}
    assert effect.parameters["damping"] == pytest.approx(0.3, rel=0.05)
    assert found.free_form is not None
    assert found.free_form.of_encoder
    assert "predicts none" in outside_line(found.free_form)
    position, drawn = found.free_form.over_position
    np.testing.assert_allclose(drawn, _error(position), atol=0.1 * AMPLITUDE)


@pytest.mark.thorough
def test_a_constant_torque_is_named_at_the_joint_whose_encoder_errs() -> None:
    def act(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        _eccentric(model, data)
        data.qfrc_applied[0] = 0.5

    problem = _with_eccentric(None, act)
    found = _searched(problem, "torque_bias", "coulomb_friction")
    (effect,) = found.best.effects
    assert (effect.name, effect.target) == ("torque_bias", "shoulder")
    assert effect.parameters["torque"] == pytest.approx(0.5, rel=0.1)
    assert found.free_form is not None
    assert found.free_form.of_encoder


@pytest.mark.thorough
@pytest.mark.parametrize("hidden", ["viscous_damping", "torque_bias"])
def test_an_effect_is_named_at_the_joint_that_is_knocked(hidden: str) -> None:
    def hide(model: mujoco.MjModel) -> None:
        model.dof_damping[0] += 0.3 * (hidden == "viscous_damping")

    def act(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        bias = 0.15 * (hidden == "torque_bias")
        data.qfrc_applied[0] = bias + float(_knock(np.asarray(data.time)))

    log = record(hide, act, xml=TURNTABLES, episodes=6)
    spec = mujoco.MjSpec.from_string(TURNTABLES)
    problem = ArmRollouts(spec, log, np.full(2, 4e-4))
    found = _searched(problem, "viscous_damping", "torque_bias")
    (effect,) = found.best.effects
    assert (effect.name, effect.target) == (hidden, "shoulder")
    (value,) = effect.values
    assert value == pytest.approx(0.15 if hidden == "torque_bias" else 0.3, rel=0.05)
    assert found.free_form is not None
    assert found.free_form.target == "shoulder"
    assert not found.free_form.of_encoder
