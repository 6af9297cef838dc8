"""An arm whose servo drives its joint through a gear: as without, commanded alike."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from small_problems import ARM

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Candidate, Hypothesis
from rlco.gap.diagnose.regimes import label_regimes
from rlco.gap.logs.log import Log, Recording
from rlco.physics.effects import AppliedEffect

# The elbow's servo behind a gear that turns it round: as stiff as before.
PLAIN = ARM.replace("-9 9", "-2 2")
GEARED = PLAIN.replace(
    'joint="elbow" kp="40" kv="2" forcerange="-2 2"',
    'joint="elbow" gear="-2" kp="10" kv="0.5" forcerange="-1 1"',
)
AT_COMMANDS = (
    AppliedEffect("joint_offset", "elbow", {"offset": 0.05}),
    AppliedEffect("encoder_scale", "elbow", {"factor": 1.2}),
    AppliedEffect("backlash", "elbow", {"width": 0.1}),
    AppliedEffect("velocity_limit", "elbow", {"limit": 0.2}),
    AppliedEffect("actuator_lag", "elbow", {"time_constant": 0.1}),
)


def geared() -> tuple[ArmRollouts, ArmRollouts]:
    """One motion of the arm without and with the gear, commanded alike."""
    time = np.arange(400) / 50
    goals = 0.6 * np.sin(np.outer(time, [2.0, 2.6]))
    problems = []
    for xml, gear in ((PLAIN, 1.0), (GEARED, -2.0)):
        part = Recording("a", time, goals, command=goals * [1.0, gear])
        spec = mujoco.MjSpec.from_string(xml)
        log = Log((part,), ("shoulder", "elbow"), ("shoulder", "elbow"))
        problems.append(ArmRollouts(spec, log, np.full(2, 4e-4)))
    return problems[0], problems[1]


@pytest.mark.parametrize("effect", AT_COMMANDS, ids=lambda effect: effect.name)
def test_an_effect_on_commands_is_that_of_the_joint_behind_a_gear(
    effect: AppliedEffect,
) -> None:
    plain, other = geared()
    hypotheses = [Hypothesis(), Hypothesis((effect,))]
    without, expected = plain.residuals(hypotheses)
    np.testing.assert_allclose(other.residuals(hypotheses)[1], expected, atol=1e-9)
    assert np.abs(expected - without).max() > 1e-4


def test_an_encoders_error_is_that_of_the_joint_behind_a_gear() -> None:
    left = [
        problem.with_encoder_error("elbow", lambda read: 0.1 * np.cos(read))
        for problem in geared()
    ]
    plain, other = (one.residuals([Hypothesis()]) for one in left)
    np.testing.assert_allclose(other, plain, atol=1e-9)


def test_commands_of_joints_are_where_these_shall_be() -> None:
    plain, other = (problem.traces(Hypothesis(), 0) for problem in geared())
    np.testing.assert_allclose(other["command"], plain["command"], atol=1e-12)
    sizes = [problem.usual_sizes() for problem in geared()]
    limit = Candidate("torque_limit", "elbow")
    # A motor's torque before the gear.
    np.testing.assert_allclose(2.0 * np.array(sizes[1][limit]), sizes[0][limit])
    flags = [label_regimes(problem)[0].flags["saturated"] for problem in geared()]
    np.testing.assert_array_equal(*flags)
    assert 0.01 < flags[0][:, 1].mean() < 0.9
