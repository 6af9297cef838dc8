"""Commands of missing rows: sent by a robot that was logged badly, or not sent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hidden_arms import TWO_LINKS, commands, record
from numpy.typing import NDArray

from rlco.gap.calibrate.changed import Changed
from rlco.gap.compare.arm.commands.missing import filled_in, with_missing_commands
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.segments import held_commands
from rlco.gap.logs.log import Log, Recording
from rlco.gap.logs.times.timing import correct_timing
from rlco.gap.search.find_gap import find_gap
from rlco.gap.search.steps.sensitivity import rewhiten
from rlco.gap.search.steps.start import start
from rlco.gap.search.whitening import Whitening
from rlco.physics.effects.effect import AppliedEffect

NOISE = np.full(2, 4e-4)


def kept(episode: int, rows: int) -> NDArray[np.bool_]:
    """Which rows of an episode are logged: all but one in twenty."""
    random = np.random.default_rng(50 + episode)
    return np.r_[True, random.random(rows - 1) >= 0.05]


def skipping(episode: int) -> NDArray[np.float64]:
    """Commands of a loop that sends none where it logs none."""
    sent = commands(episode)
    rows = kept(episode, len(sent))
    return sent[np.maximum.accumulate(np.where(rows, np.arange(len(sent)), 0))]


def weak(model: mujoco.MjModel) -> None:
    """Something else that is wrong, and leaves fifty times the noise."""
    model.actuator_gainprm[0, 0] *= 0.8
    model.actuator_biasprm[0, 1] *= 0.8


def lossy(log: Log) -> Log:
    """The log without some rows."""
    recordings = [r.take(kept(i, r.rows)) for i, r in enumerate(log.recordings)]
    return replace(log, recordings=tuple(recordings))


def decided(log: Log) -> Log:
    spec = mujoco.MjSpec.from_string(TWO_LINKS)
    return with_missing_commands(spec, log, NOISE, 0.4, 1)


def arm(log: Log) -> ArmRollouts:
    return ArmRollouts(mujoco.MjSpec.from_string(TWO_LINKS), log, NOISE, threads=1)


LATE = 2  # rows


def later(sent: NDArray[np.float64]) -> NDArray[np.float64]:
    """Commands as a robot gets them that is late by some rows."""
    return np.concatenate([np.repeat(sent[:1], LATE, axis=0), sent[:-LATE]])


def late(episode: int) -> NDArray[np.float64]:
    """Commands as they arrive."""
    return later(commands(episode))


DELAY = AppliedEffect("command_delay", None, {"delay": LATE / 50})


def with_commands(log: Log, motion: Callable[[int], NDArray[np.float64]]) -> Log:
    """The log with the commands as they were sent."""
    pairs = enumerate(log.recordings)
    recordings = [replace(one, command=motion(index)) for index, one in pairs]
    return replace(log, recordings=tuple(recordings))


def test_commands_that_were_sent_are_interpolated() -> None:
    found = decided(lossy(record(weak)))
    assert "the motion fits them better" in found.notes[-1]
    lost = sum(len(r.unread[0]) for r in found.recordings if r.unread is not None)
    assert f"of {lost} missing rows are interpolated" in found.notes[-1]


def test_a_loop_that_skips_holds_its_command() -> None:
    found = decided(lossy(record(weak, motion=skipping)))
    assert all(recording.unread is None for recording in found.recordings)
    assert "the command before holds in" in found.notes[-1]


def test_late_commands_that_were_sent_are_interpolated() -> None:
    log = with_commands(record(weak, motion=late), commands)
    assert "the motion fits them better" in decided(lossy(log)).notes[-1]


def test_a_loop_that_skips_and_is_late_holds_its_command() -> None:
    log = with_commands(
        record(weak, motion=lambda episode: later(skipping(episode))), commands
    )
    assert "the command before holds in" in decided(lossy(log)).notes[-1]


def test_guesses_are_free_where_commands_step_and_nowhere_else() -> None:
    time = np.arange(60.0)
    steps = np.where(time < 30, 0.0, 1.0)
    recording = Recording("log", time, command=np.stack([steps, time], axis=1))
    lost = np.isin(time, [10, 30])
    guessed = filled_in(recording.take(~lost)).guessed
    # Half of the step is missed; a line is known everywhere.
    assert guessed[1, 0] == pytest.approx(0.5, abs=0.1)
    np.testing.assert_allclose([guessed[0, 0], *guessed[:, 1]], 0.0, atol=1e-9)


def test_responses_to_guesses_are_those_of_rollouts_with_other_commands() -> None:
    problem = arm(decided(lossy(record())))
    found = problem.by_guesses(Hypothesis())
    off = [one.guessed for one in problem.log.recordings]
    every = problem.with_other_guesses(off).residuals([Hypothesis()])[0]
    change = every - problem.residuals([Hypothesis()])[0]
    # One by one, and where what is next does not yet act, which forgets little.
    apart = np.linalg.norm(found.sum(axis=0) - change) / np.linalg.norm(change)
    assert apart < 0.1
    assert np.linalg.norm(change / 4e-4) > 30.0


def test_with_free_guesses_lost_commands_leave_nothing_but_noise() -> None:
    problem = arm(decided(lossy(record())))
    residual = problem.residuals([Hypothesis()])[0]
    guesses = problem.by_guesses(Hypothesis())
    whitening = Whitening.of(
        np.full(len(residual), 4e-4), guesses, np.ones(len(guesses)), -1
    )
    assert np.sqrt(np.mean((residual / 4e-4) ** 2)) > 1.2
    left = np.sqrt(np.mean(whitening.whiten(residual) ** 2))
    assert left == pytest.approx(1.0, abs=0.05)
    assert start(problem).none.error == pytest.approx(1.0, abs=0.07)


def test_guesses_that_are_sure_cost_no_rollout_and_free_nothing() -> None:
    log = decided(lossy(record()))
    sure = [replace(one, guessed=0.0 * one.guessed) for one in log.recordings]
    problem = arm(replace(log, recordings=tuple(sure)))
    assert problem.by_guesses(Hypothesis()).shape == (0, len(problem.layout.time))


def test_guesses_are_free_in_recordings_of_what_changed_too() -> None:
    problem = arm(decided(lossy(record())))
    guesses = problem.by_guesses(Hypothesis())
    count = guesses.shape[1]
    weight = np.where(np.arange(count) % 2, 1.0, 0.25)
    later = Changed(problem, np.zeros(count), NOISE, weight)
    np.testing.assert_allclose(later.by_guesses(Hypothesis()), guesses * weight)
    assert len(start(later).setting.guessed) == len(guesses) > 0


def test_under_a_delay_guesses_are_freed_anew() -> None:
    log = decided(lossy(with_commands(record(motion=late), commands)))
    first = start(arm(log))
    state, (found,) = first.fit([(DELAY,)])
    state = rewhiten(replace(state, best=found))
    # Responses that come before the lost commands act explain little of their errors.
    assert found.error > 1.1
    assert state.best.error == pytest.approx(1.0, abs=0.07)
    again = rewhiten(state)
    assert again.setting.guessed is state.setting.guessed


@pytest.mark.thorough
def test_a_delay_is_named_though_commands_are_lost() -> None:
    verdict = find_gap(
        arm(decided(lossy(with_commands(record(motion=late), commands))))
    )
    (effect,) = verdict.effects
    assert effect.name == "command_delay"
    assert effect.parameters["delay"].value == pytest.approx(LATE / 50, abs=1e-3)
    assert verdict.verdict == "named"


def test_a_log_without_missing_rows_stays_as_it_is() -> None:
    log = record()
    assert decided(log) is log


def waves(episode: int) -> NDArray[np.float64]:
    """Smooth commands."""
    time = np.arange(200)[:, None] / 50.0
    return 0.3 * np.sin(time * [2.0 + episode, 5.0]) * np.minimum(time, 1.0)


def test_lost_rows_of_smooth_commands_leave_nothing_but_noise() -> None:
    log = lossy(record(motion=waves))
    spec = mujoco.MjSpec.from_string(TWO_LINKS)

    def size(log: Log) -> float:
        rows = ArmRollouts(spec, log, NOISE).residuals([Hypothesis()])[0]
        return float(np.sqrt(np.mean(rows**2))) / 4e-4

    assert size(log) > 2.0
    assert size(decided(log)) == pytest.approx(1.0, abs=0.05)


def test_what_a_repeated_row_was_sent_is_kept() -> None:
    time = np.arange(200) * 0.02
    position = np.stack([np.sin(2 * time), 0.3 * np.cos(time)], axis=1)
    position[100] = position[99]
    sent = np.arange(200.0)[:, None]
    (part,), _ = correct_timing(Recording("log", time, position, command=sent))
    assert part.rows == 199
    found = held_commands(filled_in(part), 0.02, 1, [0])
    np.testing.assert_array_equal(found, sent)


def test_a_command_within_a_step_acts_for_the_rest_of_it() -> None:
    time = np.array([0.0, 0.025, 0.04, 0.07])
    recording = Recording("log", time, command=np.array([[0.0], [1.0], [3.0], [0.0]]))
    found = held_commands(recording, 0.01, 1, [0])[:, 0]
    # In the third step, from 0.02 s, it is 0 for a half and 1 for the other.
    assert found.tolist() == pytest.approx([0, 0, 0.5, 1, 3, 3, 3, 0])
