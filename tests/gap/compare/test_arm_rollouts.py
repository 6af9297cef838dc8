"""Rollouts of a commanded arm against plain MuJoCo loops."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hidden_arms import TWO_LINKS, Act, Hide, record

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Candidate, Hypothesis
from rlco.gap.logs.log import Log
from rlco.physics.effects import AppliedEffect

_NOISE = np.full(2, 4e-4)


def _problem(log: Log, **options: Any) -> ArmRollouts:
    return ArmRollouts(mujoco.MjSpec.from_string(TWO_LINKS), log, _NOISE, **options)


def _rms(problem: ArmRollouts, *effects: AppliedEffect) -> np.ndarray:
    rows = problem.residuals([Hypothesis(effects)])[0].reshape(-1, 2)
    return np.sqrt(np.mean(rows**2, axis=0))


def test_the_true_model_leaves_the_noise() -> None:
    np.testing.assert_allclose(_rms(_problem(record())), _NOISE, rtol=0.1)


def _hide_friction(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[1] = 0.05


def _stribeck(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    model.dof_frictionloss[1] = 0.3 * np.exp(-((data.qvel[1] / 0.2) ** 2))


def _drive_loss(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    torque = 40 * (data.ctrl[0] - data.qpos[0]) - 2 * data.qvel[0]
    data.qfrc_applied[0] = torque / (1 + 0.5 * abs(torque)) - torque


@pytest.mark.parametrize(
    ("hide", "act", "effect"),
    [
        (_hide_friction, None, ("coulomb_friction", "elbow", {"frictionloss": 0.05})),
        (
            None,
            _stribeck,
            ("stribeck_friction", "elbow", {"static": 0.3, "speed": 0.2}),
        ),
        (None, _drive_loss, ("drive_loss", "shoulder", {"loss": 0.5})),
    ],
)
def test_a_hidden_effect_of_the_true_size_leaves_the_noise(
    hide: Hide | None, act: Act | None, effect: tuple[str, str, dict[str, float]]
) -> None:
    problem = _problem(record(hide, act))
    assert _rms(problem).max() > 3 * _NOISE[0]
    np.testing.assert_allclose(_rms(problem, AppliedEffect(*effect)), _NOISE, rtol=0.1)


def test_neither_threads_nor_batches_change_a_number() -> None:
    log = record(episodes=3)
    effect = AppliedEffect("stribeck_friction", "elbow", {"static": 0.2, "speed": 0.1})
    hypotheses = [Hypothesis(), Hypothesis((effect,)), Hypothesis((), (0.01,) * 10)]
    one = _problem(log, threads=1)
    hypotheses[2] = Hypothesis((), (0.01,) * len(one.tolerance_names))
    together = _problem(log, threads=2).residuals(hypotheses * 3)
    alone = [one.residuals([hypothesis])[0] for hypothesis in hypotheses * 3]
    np.testing.assert_array_equal(together, alone)


def test_rows_between_two_physics_steps_are_interpolated() -> None:
    log = record(episodes=1, noise=0.0)
    assert np.abs(_problem(log).residuals([Hypothesis()])).max() < 1e-6
    (recording,) = log.recordings
    # The same motion, told to have been measured a quarter of a physics step later.
    # What was sent was sent in time.
    time = recording.time + 0.001 * (recording.time > 0)
    assert recording.command is not None
    sent = (recording.time[1:], recording.command[1:])
    moved = replace(recording, time=time, unread=sent)
    late = replace(log, recordings=(moved,))
    left = _problem(late).residuals([Hypothesis()])[0].reshape(-1, 2)
    # So it lags by its speed times a millisecond.
    speed = np.asarray(recording.velocity)[1:]
    apart = np.abs(left + 0.001 * speed)
    assert np.quantile(apart, 0.8) < 0.1 * np.quantile(np.abs(left), 0.8)


def test_a_simulation_that_diverges_is_infinite_and_says_nothing(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    wild = AppliedEffect("armature", "elbow", {"armature": -0.02})
    rows = _problem(record(episodes=1)).residuals([Hypothesis((wild,)), Hypothesis()])
    assert np.isinf(rows[0]).all()
    assert np.isfinite(rows[1]).all()
    assert not list(tmp_path.iterdir())
    assert "WARNING" not in "".join(capfd.readouterr())


def test_limits_of_torque_are_looked_for_where_the_motion_would_feel_them() -> None:
    torques: list[np.ndarray] = []

    def watch(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        torques.append(np.abs(data.actuator_force))

    sizes = _problem(record(act=watch)).usual_sizes()
    for column, joint in enumerate(("shoulder", "elbow")):
        needed = np.array(torques)[:, column]
        starts = sizes[Candidate("torque_limit", joint)]
        assert np.quantile(needed, 0.9) < max(starts) < needed.max()
        assert min(starts) < max(np.median(needed), 0.1 * needed.max())
        ratios = np.array(starts[:-1]) / starts[1:]
        assert (ratios < 2.0).all()
