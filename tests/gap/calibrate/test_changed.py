"""A later recording against a calibrated model: what counts, and what is known."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from rlco.gap.calibrate.changed import STANDING, Changed, weights_of
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.logs.log import Log, Recording

ARM = """
<mujoco><worldbody><body name="arm"><joint name="j" axis="0 1 0"/>
<inertial mass="2" pos="0.5 0 0" diaginertia="1 1 1"/></body></worldbody>
<actuator><motor joint="j"/></actuator></mujoco>
"""


@pytest.fixture
def later() -> TorqueLog:
    """An arm that rests for 2 s, then turns at 1 rad/s for 2 s."""
    time = 0.02 * np.arange(200)
    position = np.maximum(time - 2.0, 0.0)[:, None]
    turned = Recording("turned", time, position, torque=np.ones_like(position))
    return TorqueLog(
        mujoco.MjSpec.from_string(ARM), Log((turned,), joints=("j",)), noise=np.ones(1)
    )


def test_a_joint_at_rest_counts_less_than_one_in_motion(later: TorqueLog) -> None:
    weight, time = weights_of(later), later.layout.time
    assert (weight[time < 1.7] == STANDING).all()
    assert (weight[time > 2.3] == 1.0).all()
    assert STANDING < 0.5


def test_residuals_are_weighted_and_traces_are_not(later: TorqueLog) -> None:
    weight = np.where(later.standing(), 0.5, 2.0)
    lacking = np.sin(later.layout.time)
    problem = Changed(later, weight * lacking, np.ones(1), weight)
    plain = later.residuals([Hypothesis()])[0]
    np.testing.assert_allclose(
        problem.residuals([Hypothesis()], [0])[0], weight * (plain - lacking)
    )
    shown = problem.traces(Hypothesis(), 0)["simulated"][:, 0]
    known = later.traces(Hypothesis(), 0)["simulated"][:, 0]
    np.testing.assert_allclose(shown - known, lacking)
