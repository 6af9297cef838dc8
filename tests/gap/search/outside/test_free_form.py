"""Doubt by a torque of any shape: what the library lacks, where, and how it looks."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hidden_arms import TURNTABLES, Act, Hide, record

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.verdict import FreeForm, Verdict
from rlco.gap.logs.log import Array
from rlco.gap.report.free_form import free_form_figure
from rlco.gap.report.verdict_text import outside_line
from rlco.gap.search.find_gap import find_gap

pytestmark = pytest.mark.slow
# Damping alone: what else a search could name is not the matter here.
OTHERS = ("viscous_damping", "actuator_gain")


def _damped(model: mujoco.MjModel) -> None:
    model.dof_damping[1] += 0.6


def _hardening(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """A spring that grows with the cube of the angle, which is left out."""
    data.qfrc_applied[0] = -(data.qpos[0] ** 3)


def _eccentric(position: Array) -> Array:
    """How far an encoder reads wrong whose disc is not centred [rad]."""
    return 0.005 * np.sin(3.0 * position)


def _driven_to_what_is_read(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    data.ctrl[0] -= _eccentric(data.qpos[:1])[0]


def _found(hide: Hide | None, act: Act | None, *, misread: bool = False) -> Verdict:
    log = record(hide, act, xml=TURNTABLES, episodes=6)
    for one in log.recordings:
        one.position[:, 0] += misread * _eccentric(one.position[:, 0])
    problem = ArmRollouts(mujoco.MjSpec.from_string(TURNTABLES), log, np.full(2, 4e-4))
    every = {one.name for one in problem.candidates()}
    uncommon = {one.name for one in problem.candidates(uncommon=True)}
    return find_gap(problem, exclude=(every | uncommon) - set(OTHERS))


@pytest.fixture(scope="module")
def doubted() -> FreeForm:
    found = _found(_damped, _hardening)
    assert ("viscous_damping", "elbow") in {(e.name, e.target) for e in found.effects}
    assert found.free_form is not None
    return found.free_form


@pytest.mark.thorough
def test_what_is_outside_is_told_at_its_joint(doubted: FreeForm) -> None:
    assert doubted.target == "shoulder"
    assert doubted.gain > 0.25


def test_its_shape_is_what_was_hidden(doubted: FreeForm) -> None:
    angle, torque = doubted.over_position
    hidden = -(angle**3)
    np.testing.assert_allclose(torque, hidden, atol=0.3 * np.abs(hidden).max())
    assert np.corrcoef(torque, hidden)[0, 1] > 0.95


def test_over_time_it_comes_and_goes_with_the_motion(doubted: FreeForm) -> None:
    time, torque = doubted.over_time
    # Six recordings of four seconds, one after the other.
    assert 20.0 < time[-1] - time[0] <= 24.0
    assert torque.min() < -0.02 < 0.02 < torque.max()


@pytest.mark.thorough
def test_an_encoder_that_reads_wrong_is_told_at_its_joint_and_drawn() -> None:
    found = _found(_damped, _driven_to_what_is_read, misread=True)
    assert ("viscous_damping", "elbow") in {(e.name, e.target) for e in found.effects}
    free = found.free_form
    assert free is not None
    assert free.of_encoder
    assert free.target == "shoulder"
    angle, error = free.over_position
    # The servo follows a constant error and one that grows with the angle.
    told, hidden = (
        one - np.polyval(np.polyfit(angle, one, 1), angle)
        for one in (error, _eccentric(angle))
    )
    np.testing.assert_allclose(told, hidden, atol=0.4 * np.abs(hidden).max())
    assert np.corrcoef(told, hidden)[0, 1] > 0.95
    assert "error of the encoder at shoulder" in outside_line(free)
    (panel,) = free_form_figure(free, "rad").axes
    assert panel.get_ylabel() == "error of the encoder [rad]"


@pytest.mark.thorough
def test_right_names_raise_no_doubt() -> None:
    found = _found(_damped, None)
    assert [(e.name, e.target) for e in found.effects] == [("viscous_damping", "elbow")]
    assert found.free_form is None
