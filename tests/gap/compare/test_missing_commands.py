"""Commands of missing rows: sent by a robot that was logged badly, or not sent."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hidden_arms import TWO_LINKS, commands, record
from numpy.typing import NDArray

from rlco.gap.compare.arm.missing_commands import filled_in, with_missing_commands
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.segments import held_commands
from rlco.gap.logs.log import Log, Recording
from rlco.gap.logs.times.timing import correct_timing

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


def test_commands_that_were_sent_are_interpolated() -> None:
    found = decided(lossy(record(weak)))
    assert "the motion fits them better" in found.notes[-1]
    lost = sum(len(r.unread[0]) for r in found.recordings if r.unread is not None)
    assert f"of {lost} missing rows are interpolated" in found.notes[-1]


def test_a_loop_that_skips_holds_its_command() -> None:
    found = decided(lossy(record(weak, motion=skipping)))
    assert all(recording.unread is None for recording in found.recordings)
    assert "the command before holds in" in found.notes[-1]


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
