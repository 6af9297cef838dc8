"""Calibration: what recordings tell is found, and what they do not keeps its prior."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hidden_arms import TURNTABLES, TWO_LINKS, record
from recorded_torques import XML, record_torques, wrong_everywhere

from rlco.gap.calibrate.fit import Calibration, calibrate
from rlco.gap.calibrate.numbers import Number
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.torque.torque_log import TorqueLog


def found(calibration: Calibration, name: str, target: str, parameter: str) -> float:
    """Return the value of a number."""
    for number, amount in zip(calibration.numbers, calibration.amounts, strict=True):
        if (number.name, number.target, number.parameter) == (name, target, parameter):
            return number.value(float(amount))
    raise KeyError(name)


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    log = record_torques(wrong_everywhere)
    return calibrate(TorqueLog(mujoco.MjSpec.from_string(XML), log, window=0.1))


def test_a_model_that_is_wrong_everywhere_agrees_afterwards(
    calibration: Calibration,
) -> None:
    assert calibration.cost_before > 100.0
    assert calibration.cost < 3.0


def test_friction_is_that_which_was_hidden(calibration: Calibration) -> None:
    for joint, hidden in (("shoulder", 0.05), ("elbow", 0.03)):
        friction = found(calibration, "coulomb_friction", joint, "frictionloss")
        assert friction == pytest.approx(hidden, abs=0.012)


def test_what_the_motion_does_not_show_keeps_its_prior() -> None:
    # Turntables: nothing tells how far a link reaches along its axis.
    def spun(model: mujoco.MjModel) -> None:
        model.dof_damping[:] *= 1.3

    log = record(spun, xml=TURNTABLES, episodes=2)
    torques = tuple(
        replace(one, torque=0.2 * np.asarray(one.velocity), command=None)
        for one in log.recordings
    )
    spec = mujoco.MjSpec.from_string(TURNTABLES)
    found = calibrate(TorqueLog(spec, replace(log, recordings=torques)), steps=2)
    deviation = np.sqrt(np.diag(found.covariance))
    for number, amount, left in zip(
        found.numbers, found.amounts, deviation, strict=True
    ):
        if number.parameter == "z":
            assert abs(amount) < 0.01
            assert left == pytest.approx(1.0, abs=0.01)


def damped(model: mujoco.MjModel) -> None:
    model.dof_damping[:] += 0.6


def lag_of_shoulder(calibration: Calibration) -> float:
    """Return damping over stiffness: 0.2 + 2 N m s and 40 N m in the turntables."""
    own = 0.2 + found(calibration, "viscous_damping", "shoulder", "damping")
    damping = own + 2.0 * found(calibration, "servo_damping", "shoulder", "factor")
    return damping / (40.0 * found(calibration, "actuator_gain", "shoulder", "factor"))


def test_of_rollouts_only_link_numbers_that_matter_are_fitted() -> None:
    log = record(damped, xml=TURNTABLES, episodes=3)
    spec = mujoco.MjSpec.from_string(TURNTABLES)
    fitted = calibrate(ArmRollouts(spec, log, np.full(2, 4e-4), threads=1))
    # Six numbers a joint; each link about a vertical axis has one inertia.
    assert fitted.basis.shape[1] <= 2 * 6 + 2 * 3
    # A softer servo with less damping lags alike.
    assert lag_of_shoulder(fitted) == pytest.approx(2.8 / 40.0, rel=0.01)


def test_a_second_that_is_far_off_does_not_decide() -> None:
    log = record(damped, xml=TURNTABLES, episodes=3)
    position = np.array(log.recordings[0].position)
    position[50:100, 0] += 0.3  # held by somebody
    knocked = replace(log.recordings[0], position=position)
    log = replace(log, recordings=(knocked, *log.recordings[1:]))
    spec = mujoco.MjSpec.from_string(TURNTABLES)
    fitted = calibrate(ArmRollouts(spec, log, np.full(2, 4e-4), threads=1))
    assert lag_of_shoulder(fitted) == pytest.approx(2.8 / 40.0, rel=0.02)


def test_what_a_servo_damps_is_told_from_the_joint_by_its_limit() -> None:
    limited = TURNTABLES.replace('kp="40"', 'kp="40" forcerange="-1 1"')

    def less(model: mujoco.MjModel) -> None:
        model.actuator_biasprm[0, 2] *= 0.75

    log = record(less, xml=limited, episodes=3)
    spec = mujoco.MjSpec.from_string(limited)
    fitted = calibrate(ArmRollouts(spec, log, np.full(2, 4e-4), threads=1))
    assert fitted.cost < 1.5
    # Its stiffness and its damping are known by their ratio.
    factor = found(fitted, "servo_damping", "shoulder", "factor")
    factor /= found(fitted, "actuator_gain", "shoulder", "factor")
    assert factor == pytest.approx(0.75, rel=0.02)
    # A quarter of the servo's would be 0.5.
    assert abs(found(fitted, "viscous_damping", "shoulder", "damping")) < 0.02


def test_an_arm_at_its_limits_is_fitted_along_short_rollouts_first() -> None:
    limited = TWO_LINKS.replace(
        'kp="40" kv="2"', 'kp="400" kv="20" forcerange="-1.2 1.2"'
    )

    def wrong(model: mujoco.MjModel) -> None:
        model.actuator_gainprm[0, 0] *= 1.2
        model.actuator_biasprm[0, 1:3] *= 1.2, 0.75
        model.body_mass[1:] *= 1.15, 0.9
        model.body_inertia[1] *= 1.2

    log = record(wrong, xml=limited, episodes=3)
    spec = mujoco.MjSpec.from_string(limited)
    fitted = calibrate(ArmRollouts(spec, log, np.full(2, 4e-4), threads=1))
    assert fitted.cost_before > 1000.0
    # 2.6; along whole recordings alone, steps end at 44.
    assert fitted.cost < 5.0


def test_combinations_that_were_not_fitted_keep_their_prior() -> None:
    """Of three numbers only the mean of the first two shows: of variance 1 / 100."""
    basis = np.array([[1.0], [1.0], [0.0]]) / np.sqrt(2.0)
    numbers = tuple(Number("link_parameters", "link", name, 0.1) for name in "xyz")
    fitted = Calibration(
        numbers, np.zeros(3), basis, np.array([[198.0]]), 2.0, 1000, 9.0, 1.0
    )
    # By hand: the inverse of 99 m m' + 1, with m along the mean.
    by_hand = np.linalg.inv(99.0 * basis @ basis.T + np.eye(3))
    np.testing.assert_allclose(fitted.covariance, by_hand, atol=1e-12)
    np.testing.assert_allclose(fitted.deviation, [0.505**0.5, 0.505**0.5, 1.0])
