"""Commands that arrive late at random, on two joints."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hidden_arms import FPS, TURNTABLES, Act, record
from numpy.typing import NDArray
from small_problems import last_state

from rlco.gap.compare.arm.commands.late import responses
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.search.find_gap import additions, find_gap
from rlco.gap.search.lateness import Lateness
from rlco.gap.search.steps.command_times import TURNS, command_times, in_turns
from rlco.gap.search.steps.late_commands import late_commands
from rlco.gap.search.steps.start import start
from rlco.physics.effects import AppliedEffect

MEAN, SPREAD = 0.02, 0.01  # [s]
KEPT = {"command_delay", "viscous_damping", "coulomb_friction"}
STEP = 0.004  # [s]
# A slow servo, and a quick one that reaches its limit.
LIMITED = TURNTABLES.replace('kp="40" kv="2"', 'kp="10" kv="2"').replace(
    'kp="20" kv="1"', 'kp="20" kv="0.5" forcerange="-0.8 0.8"'
)


def _waves(seed: int) -> NDArray[np.float64]:
    """Return sums of sines, (frames, 2) [rad]."""
    random = np.random.default_rng(seed)
    time = np.arange(6 * FPS) / FPS
    goals = np.zeros((len(time), 2))
    for joint in range(2):
        for frequency in random.uniform(0.1, 0.6, 4):
            goals[:, joint] += 0.15 * np.sin(2.0 * np.pi * frequency * time)
    return goals


def _arrivals(
    episode: int, count: int, mean: float, spread: float
) -> NDArray[np.float64]:
    """Return when the commands of an episode arrive, in order, (count,) [s]."""
    shape, scale = (mean / spread) ** 2, spread**2 / mean
    late = np.random.default_rng(1000 + episode).gamma(shape, scale, count)
    return np.maximum.accumulate(np.arange(count) / FPS + late)


def _late(mean: float, spread: float) -> Act:
    """Return what gives both servos commands that arrive late, in order."""
    episode, arrive = -1, np.zeros(0)
    sent = np.zeros((0, 2))

    def act(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        nonlocal episode, arrive, sent
        if data.time == 0.0:
            episode += 1
            sent = _waves(episode)
            arrive = _arrivals(episode, len(sent), mean, spread)
        row = np.searchsorted(arrive, data.time + 1e-9, side="right") - 1
        data.ctrl[:] = sent[max(row, 0)]

    return act


def _problem(act: Act | None) -> ArmRollouts:
    log = record(None, act, xml=TURNTABLES, motion=_waves)
    return ArmRollouts(mujoco.MjSpec.from_string(TURNTABLES), log, np.full(2, 4e-4))


def _others(problem: ArmRollouts) -> set[str]:
    return {one.name for one in problem.candidates()} - KEPT


def _pushes(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Push each joint once a frame by a random amount while it moves."""
    frame = round(data.time * FPS)
    random = np.random.default_rng(frame + round(1e6 * abs(data.ctrl[0])))
    data.qfrc_applied[:] = random.normal(0.0, 2.0, 2) * np.abs(data.qvel)


def _times(problem: ArmRollouts, late: float) -> list[NDArray[np.float64]]:
    return [np.full(one.rows, late) for one in problem.log.recordings]


def test_responses_of_all_commands_add_up_to_that_of_a_constant_delay() -> None:
    problem = _problem(None)
    found = responses(problem, Hypothesis(), _times(problem, 0.0))
    assert found is not None
    delayed = Hypothesis((AppliedEffect("command_delay", None, {"delay": STEP}),))
    rows = problem.residuals([Hypothesis(), delayed])
    expected = (rows[1] - rows[0]) / STEP
    # What a servo has not forgotten after 0.3 s is left out: some parts in a thousand.
    np.testing.assert_allclose(found.sum(), expected, atol=5e-3 * abs(expected).max())


def test_commands_at_later_times_equal_a_constant_delay() -> None:
    problem = _problem(None)
    late = _times(problem, 3 * STEP)
    delayed = Hypothesis((AppliedEffect("command_delay", None, {"delay": 3 * STEP}),))
    ours = problem.with_late_commands(late).residuals([Hypothesis()])[0]
    np.testing.assert_allclose(ours, problem.residuals([delayed])[0], atol=1e-9)


@pytest.mark.slow
@pytest.mark.thorough
def test_late_commands_are_named_with_the_distribution_of_their_times() -> None:
    problem = _problem(_late(MEAN, SPREAD))
    found = find_gap(problem, exclude=_others(problem))
    (random,) = found.effects
    assert (random.name, random.target) == ("random_delay", None)
    mean, spread = random.parameters["mean"], random.parameters["spread"]
    # A command waits for the next step.
    assert mean.value == pytest.approx(MEAN + 0.5 * STEP, abs=0.003)
    assert spread.value == pytest.approx(SPREAD, rel=0.15)
    assert spread.low < spread.value < spread.high
    assert found.gap.after_heldout < 0.1 * found.gap.before_heldout
    # The gap before is that of the log, whose commands seem to be in time.
    logged = problem.residuals([Hypothesis()])[0]
    held = logged[np.isin(problem.layout.recording, found.heldout)]
    assert found.gap.before_heldout == pytest.approx(float(np.sqrt(np.mean(held**2))))

    assert "late by the mean" in found.remarks[-1]


@pytest.mark.thorough
def test_the_time_of_each_command_is_estimated() -> None:
    problem = _problem(_late(MEAN, SPREAD))
    state = start(problem, exclude=_others(problem))
    for found in additions(state):
        state = found
    lateness = last_state(late_commands(state, additions)).lateness
    assert lateness is not None
    late, true = _found_and_true(lateness, MEAN, SPREAD)
    # 0.47; with the residual of commands in time alone, 0.69.
    assert (late - true).std() < 0.55 * true.std()


@pytest.mark.thorough
@pytest.mark.slow
def test_an_interrupted_search_with_late_commands_keeps_what_it_had() -> None:
    problem = _problem(_late(MEAN, SPREAD))
    state = start(problem, exclude=_others(problem))
    for found in additions(state):
        state = found
    steps = late_commands(state, additions)
    assert next(steps) is state
    assert state.setting.problem is problem


@pytest.mark.slow
def test_a_constant_delay_stays_one() -> None:
    problem = _problem(_late(MEAN + 0.5 * STEP, 1e-4))
    found = find_gap(problem, exclude=_others(problem))
    (constant,) = found.effects
    assert constant.name == "command_delay"


@pytest.mark.thorough
def test_pushes_at_each_joint_are_not_taken_for_late_commands() -> None:
    problem = _problem(_pushes)
    state = start(problem, exclude=_others(problem))
    for found in additions(state):
        state = found
    assert state.best.error > 1.3
    assert last_state(late_commands(state, additions)) is state


@pytest.mark.thorough
def test_a_slow_controller_that_leaves_little_is_not_taken_for_late_commands() -> None:
    log = record(None, _late(MEAN, SPREAD), xml=TURNTABLES, motion=_waves)
    # So much noise that times of their own hardly show any more.
    noise = np.full(2, 1.4e-3)
    problem = ArmRollouts(mujoco.MjSpec.from_string(TURNTABLES), log, noise)
    state = start(problem, exclude=_others(problem) - {"control_rate"})
    delay, slow = (
        replace(state, best=state.fit([(AppliedEffect(name, None, values),)])[1][0])
        for name, values in (
            ("command_delay", {"delay": MEAN}),
            ("control_rate", {"period": 0.06}),
        )
    )
    assert 1.3 < slow.best.error < 2.0
    assert last_state(late_commands(slow, additions)) is slow
    assert last_state(late_commands(delay, additions)).lateness is not None


LIMITED_MEAN, LIMITED_SPREAD = 0.04, 0.03  # [s]


@pytest.fixture(scope="module")
def limited() -> Lateness:
    log = record(None, _late(LIMITED_MEAN, LIMITED_SPREAD), xml=LIMITED, motion=_waves)
    spec = mujoco.MjSpec.from_string(LIMITED)
    problem = ArmRollouts(spec, log, np.full(2, 1e-4))
    setting = start(problem, exclude=_others(problem)).setting
    # Since no command overtakes another, they are late by 0.054 s on average.
    late = AppliedEffect("command_delay", None, {"delay": LIMITED_MEAN})
    # At first, either joint seems to be late by times of its own.
    lateness = command_times(setting, problem, Hypothesis((late,)))
    assert lateness is not None
    return lateness


def _found_and_true(
    lateness: Lateness, mean: float, spread: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how late commands are, where anything shows it, (commands,) [s] each."""
    estimates, truth = [], []
    for episode, late in enumerate(lateness.late):
        true = _arrivals(episode, len(late), mean, spread) - np.arange(len(late)) / FPS
        # While both joints turn slowly nothing shows when a command arrives.
        turned = np.abs(np.diff(_waves(episode), axis=0, prepend=0.0)).max(axis=1)
        estimates.append(late[turned > 0.01])
        truth.append(true[turned > 0.01])
    return np.concatenate(estimates), np.concatenate(truth)


@pytest.mark.thorough
def test_times_are_found_that_move_joints_by_more_than_the_first_order(
    limited: Lateness,
) -> None:
    assert limited.spread == pytest.approx(LIMITED_SPREAD, rel=0.2)
    found, true = _found_and_true(limited, LIMITED_MEAN, LIMITED_SPREAD)
    assert (found - true).std() < 0.5 * true.std()


@pytest.mark.thorough
def test_times_are_kept_as_they_differ_from_their_mean(limited: Lateness) -> None:
    # The search then finds the mean, as a constant delay: it must not count twice.
    assert abs(np.concatenate(limited.late).mean()) < 0.002
    found, true = _found_and_true(limited, LIMITED_MEAN, LIMITED_SPREAD)
    assert abs(found.mean()) < 0.1 * true.mean()


def test_commands_that_take_effect_in_turns_are_a_slow_controllers() -> None:
    problem = _problem(None)
    random = np.random.default_rng(7)
    turns, anyhow = [], []
    for episode, one in enumerate(problem.log.recordings):
        wait = np.ceil(one.time / 0.07) * 0.07 - one.time
        turns.append(wait + random.normal(0.0, 0.01, one.rows))
        anyhow.append(_arrivals(episode, one.rows, MEAN, SPREAD) - one.time)
    assert in_turns(problem, turns) > 2.0 * TURNS
    assert in_turns(problem, anyhow) < 0.5 * TURNS
