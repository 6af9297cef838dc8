"""Where the disagreement is: numbers by hand, and effects found in their regimes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from small_problems import NOISE, Arm, arm_problem, ball_problem

from rlco.gap.compare.problem import Hypothesis
from rlco.gap.diagnose.where import EVERYWHERE, Cell, where
from rlco.gap.logs.log import Array, Log, Recording
from rlco.physics.effects import AppliedEffect


class Made(Arm):
    """An arm whose simulation is off by given numbers, (T, joints)."""

    def __init__(self, off: Array, units: tuple[str, str] = ("rad", "rad")) -> None:
        # Speed 1 rad/s for the first half, then 0.2 rad/s, one way.
        time = np.arange(len(off)) / 50
        place = np.where(time < time[-1] / 2, time, 0.8 * time[-1] / 2 + 0.2 * time)
        position = np.stack([place, place], axis=1)
        recording = Recording("made", time, position, command=position)
        super().__init__(Log((recording,), ("a", "b"), ("a", "b")))
        self.off = off
        self.noise = np.array([0.1, 0.2])
        self.layout = type(self.layout)(
            self.layout.recording,
            self.layout.time,
            self.layout.channel,
            ("a", "b"),
            units,
        )

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        log = self.log.recordings[0]
        assert log.position is not None
        simulated = log.position - self.off
        return {"time": log.time, "measured": log.position, "simulated": simulated}


def cell(cells: tuple[Cell, ...], target: str, regime: str) -> Cell:
    (found,) = [c for c in cells if (c.target, c.regime) == (target, regime)]
    return found


def test_numbers_worked_out_by_hand() -> None:
    off = np.zeros((200, 2))
    off[:100, 0], off[100:, 0], off[:, 1] = 0.5, 0.1, 0.2
    found = where(Made(off))
    # a: squares 0.25 and 0.01 over noise 0.01; 100 * 0.24 + 100 * 0 = 24 in all.
    # b: all of it is noise.
    np.testing.assert_allclose(found.rms, [np.sqrt(0.13), 0.2])
    np.testing.assert_allclose(found.share, [1.0, 0.0])
    fast = cell(found.cells, "a", "fast")
    everywhere = cell(found.cells, "a", EVERYWHERE)
    assert everywhere.share == pytest.approx(1.0)
    assert everywhere.information == pytest.approx(1.0)  # log2(1 / 0.5)
    assert fast.time == pytest.approx(0.25, abs=0.01)
    assert fast.share == pytest.approx(1.0, abs=0.05)
    assert fast.information == pytest.approx(2.0, abs=0.2)
    assert fast.size == pytest.approx(5.0, abs=0.1)
    assert found.informative[0] == fast
    assert all(c.target == "a" for c in found.informative)


def test_motions_share_out_the_error() -> None:
    found = where(arm_problem(AppliedEffect("viscous_damping", "elbow", {"d": 0.6})))
    motions = ("hold", "reversal", "slow", "fast")
    parts = [c.share for c in found.cells if c.regime in motions]
    assert sum(parts) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    ("name", "joint", "value", "regime"),
    [
        ("viscous_damping", "shoulder", 0.6, "fast"),
        ("armature", "elbow", 0.1, "accelerating"),
        ("armature", "shoulder", 0.1, "accelerating"),
        ("coulomb_friction", "elbow", 0.6, EVERYWHERE),
    ],
)
def test_a_hidden_effect_shows_in_its_joint_and_regime(
    name: str, joint: str, value: float, regime: str
) -> None:
    found = where(arm_problem(AppliedEffect(name, joint, {"value": value})))
    first = found.informative[0]
    assert (first.target, first.regime) == (joint, regime)
    assert found.share[found.channels.index(joint)] > 0.9


def test_a_bounce_shows_after_contact_and_free_flight_is_clean() -> None:
    found = where(ball_problem())
    parts = dict.fromkeys(("free", "contact", "after contact"), 0.0)
    for c in found.cells:
        if c.regime in parts:
            parts[c.regime] += c.share
    assert parts["free"] < 0.001
    assert found.before_contact == pytest.approx((parts["free"], 0.28), abs=0.01)
    assert parts["contact"] + parts["after contact"] == pytest.approx(1.0, abs=0.01)
    assert cell(found.cells, "z", "free").size == pytest.approx(1.0, abs=0.25)
    informative = {c.regime for c in found.informative}
    assert "free" not in informative
    assert found.informative[0].regime == "after contact"


def test_without_a_gap_nothing_is_told_and_after_mending_neither() -> None:
    assert where(arm_problem()).informative == ()
    hidden = AppliedEffect("armature", "elbow", {"armature": 0.1})
    problem = arm_problem(hidden)
    before, after = where(problem), where(problem, Hypothesis((hidden,)))
    assert before.informative
    assert after.informative == ()
    np.testing.assert_allclose(after.rms, NOISE, rtol=0.1)


def test_radians_and_metres_count_in_their_noise() -> None:
    off = np.full((200, 2), 0.3)
    # Same unit: 0.09 - 0.01 against 0.09 - 0.04, in ratio 8 to 5.
    np.testing.assert_allclose(where(Made(off)).share, [8 / 13, 5 / 13])
    # Else in units of their noise: 9 - 1 against 2.25 - 1, in ratio 8 to 1.25.
    share = where(Made(off, ("rad", "m"))).share
    np.testing.assert_allclose(share, [8 / 9.25, 1.25 / 9.25])


def test_what_diverged_is_counted_and_left_out() -> None:
    off = np.full((200, 2), 0.3)
    off[150:] = np.inf
    found = where(Made(off))
    assert found.diverged == pytest.approx(0.25)
    np.testing.assert_allclose(found.rms, 0.3)
    assert np.isnan(found.heat.rms[:, -1]).all()


def test_the_heat_map_holds_all_of_the_error() -> None:
    problem = arm_problem(AppliedEffect("armature", "elbow", {"a": 0.1}))
    found = where(problem, recordings=[0, 2])
    squares = problem.residuals([Hypothesis()], [0, 2])[0] ** 2
    np.testing.assert_allclose((found.rms**2).mean(), squares.mean())
    # 8 s of 50 Hz in each of two recordings, five rows in nearly every stretch.
    assert found.heat.edges[-1] == pytest.approx(2 * 7.98)
    assert found.heat.starts.tolist() == pytest.approx([0.0, 7.98])
    assert (found.heat.rms**2).mean() == pytest.approx(squares.mean(), rel=0.02)


def test_the_heat_map_shows_when() -> None:
    off = np.zeros((200, 2))
    off[120:160, 1] = 0.7  # of 3.98 s, from 2.4 s until 3.18 s
    heat = where(Made(off)).heat
    bright = heat.edges[:-1][heat.rms[1] > 0.69]
    assert bright.min() == pytest.approx(2.4, abs=0.03)
    assert bright.max() == pytest.approx(3.18, abs=0.03)
    assert np.nanmax(heat.rms[0]) == 0.0


def test_each_recording_may_be_simulated_with_its_own_hypothesis() -> None:
    friction = AppliedEffect("coulomb_friction", "elbow", {"frictionloss": 0.6})
    problem = arm_problem(friction, recordings=2)
    nominal, corrected = Hypothesis(), Hypothesis((friction,))
    each = where(problem, [nominal, corrected])
    squares = [
        where(problem, hypothesis, recordings=[index]).rms ** 2
        for index, hypothesis in enumerate((nominal, corrected))
    ]
    np.testing.assert_allclose(each.rms, np.sqrt(np.mean(squares, axis=0)))
    second = where(problem, [nominal, corrected], recordings=[1])
    np.testing.assert_allclose(second.rms**2, squares[1])
