"""The regression of what a calibrated model lacks: known where motion is alike."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
from recorded_torques import XML, record_torques

from rlco.gap.calibrate.residual_model import residual_model
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.logs.log import Log


def cogging(log: Log) -> Log:
    """Add a torque of the shoulder that is periodic in its angle, 0.2 N m."""
    recordings = []
    for one in log.recordings:
        assert one.torque is not None
        assert one.position is not None
        torque = one.torque.copy()
        torque[:, 0] += 0.2 * np.sin(6.0 * one.position[:, 0])
        recordings.append(replace(one, torque=torque))
    return replace(log, recordings=tuple(recordings))


def problem(log: Log) -> TorqueLog:
    return TorqueLog(mujoco.MjSpec.from_string(XML), log)


def test_what_depends_on_the_motion_is_known_where_the_motion_is_alike() -> None:
    known, later = (problem(cogging(record_torques(seed=seed))) for seed in (1, 2))
    rows, wanted = (one.residuals([Hypothesis()])[0] for one in (known, later))
    found = residual_model(known, rows, later)
    left = (wanted - found.correction).reshape(-1, 2)
    assert found.explained[0] > 0.8
    assert np.std(left[:, 0]) < 0.4 * np.std(wanted.reshape(-1, 2)[:, 0])
    assert 0.5 < found.deviation[0] / np.std(left[:, 0]) < 2.0


def test_noise_is_predicted_by_nothing() -> None:
    known, later = (problem(record_torques(seed=seed)) for seed in (1, 2))
    noise = 0.05 * np.random.default_rng(0).standard_normal(len(known.layout.channel))
    found = residual_model(known, noise, later)
    assert not found.correction.any()
    assert not found.explained.any()
    assert np.allclose(found.deviation, 0.05, rtol=0.1)


def test_elsewhere_what_is_not_known_grows() -> None:
    known = problem(cogging(record_torques(seed=1)))
    there = record_torques(seed=2)
    moved = tuple(
        replace(one, position=np.asarray(one.position) + 3.0)
        for one in there.recordings
    )
    rows = known.residuals([Hypothesis()])[0]
    near = residual_model(known, rows, problem(there))
    far = residual_model(known, rows, problem(replace(there, recordings=moved)))
    assert far.deviation[0] > 1.25 * near.deviation[0]
