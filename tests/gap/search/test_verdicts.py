"""The verdicts that are no names: what data cannot tell apart, show or confirm."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hidden_arms import FPS, TURNTABLES, TWO_LINKS, Hide, record
from numpy.typing import NDArray

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Candidate
from rlco.gap.compare.verdict import Verdict
from rlco.gap.logs.log import Log, Recording
from rlco.gap.search.find_gap import additions, closed, find_gap
from rlco.gap.search.fit import Library
from rlco.gap.search.intervals import NORMAL
from rlco.gap.search.state import State
from rlco.gap.search.steps.rivals import rivals
from rlco.gap.search.steps.start import start
from rlco.gap.search.verdict import conclude
from rlco.physics.effects import AppliedEffect

pytestmark = pytest.mark.slow

_NOISE = np.full(2, 4e-4)
_WEIGHTLESS = TWO_LINKS.replace("<option ", '<option gravity="0 0 0" ')


def _verdict(log: Log, xml: str = TWO_LINKS) -> Verdict:
    return find_gap(ArmRollouts(mujoco.MjSpec.from_string(xml), log, _NOISE))


def _start(log: Log, xml: str = TURNTABLES) -> State:
    return start(ArmRollouts(mujoco.MjSpec.from_string(xml), log, _NOISE))


def _searched(state: State) -> State:
    *_, state = additions(state)
    return state


def _knowing(state: State, library: Library) -> State:
    return replace(state, setting=replace(state.setting, library=library))


def _slow(seed: int) -> NDArray[np.float64]:
    """One slow wave of each joint, as of somebody who shows a task."""
    time = np.arange(4 * FPS) / FPS
    random = np.random.default_rng(seed)
    turns = random.uniform(0.1, 0.15, 2) * time[:, None]
    return 0.2 * (1.0 - np.cos(2 * np.pi * turns))  # begins at rest where the arm is


def _at_rest(seed: int) -> NDArray[np.float64]:
    return np.zeros((4 * FPS, 2))


def _viscous(model: mujoco.MjModel) -> None:
    model.dof_damping[1] += 0.3


def _dry(model: mujoco.MjModel) -> None:
    model.dof_frictionloss[1] = 0.1


def _only_in(training: Hide) -> Log:
    """Something hidden in the recordings that are fitted, nothing in the others."""
    hidden, plain = record(training), record()
    rows = [
        (plain if index % 3 == 2 else hidden).recordings[index]
        for index in range(len(plain.recordings))
    ]
    return Log(tuple(rows), plain.joints, plain.actuators)


def _told_earlier(recording: Recording, frames: int) -> Recording:
    """A recording whose commands were sent so many frames before they had effect."""
    kept = slice(None, recording.rows - frames)
    assert recording.position is not None
    assert recording.velocity is not None
    assert recording.command is not None
    return replace(
        recording,
        time=recording.time[kept],
        position=recording.position[kept],
        velocity=recording.velocity[kept],
        command=recording.command[frames:],
    )


@pytest.mark.thorough
def test_a_slow_motion_leaves_a_class_that_holds_what_was_hidden() -> None:
    log = record(_viscous, motion=_slow, xml=TURNTABLES)
    verdict = _verdict(log, TURNTABLES)
    assert verdict.verdict == "ambiguous"
    (finding,) = verdict.effects
    members = {(finding.name, finding.target)}
    members |= {(rival.name, rival.target) for rival in finding.rivals}
    assert ("viscous_damping", "elbow") in members
    assert len(members) > 1


@pytest.mark.thorough
def test_rivals_are_looked_for_where_all_first_looks_were_forgotten() -> None:
    """As after the last effect, where the spread had to be looked at again."""
    log = record(_viscous, motion=_slow, xml=TURNTABLES)
    state = _searched(_start(log))
    kept = {n: state.scores[n] for n in (frozenset(), state.best.names)}
    state = rivals(replace(state, scores=kept, screenings=()))
    (finding,) = conclude(closed(state)).effects
    assert finding.rivals


@pytest.mark.thorough
def test_what_did_as_well_at_an_earlier_step_is_tried_as_a_rival(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also where a screening, beside the later effects, ranks it low."""

    def hide(model: mujoco.MjModel) -> None:
        _viscous(model)
        model.dof_frictionloss[0] = 0.02

    monkeypatch.setattr("rlco.gap.search.steps.rivals.RIVALS", 0)  # no screening at all
    verdict = _verdict(record(hide, motion=_slow, xml=TURNTABLES), TURNTABLES)
    assert len(verdict.effects) == 2
    assert next(one for one in verdict.effects if one.target == "elbow").rivals


def test_a_rival_that_stays_within_its_bounds_is_named_instead() -> None:
    log = record(_viscous, motion=_slow, xml=TURNTABLES)
    state = _searched(_start(log))
    (effect,), (known,) = state.best.effects, state.best.names
    library = state.setting.library
    tight = replace(library[known][0], high=float(effect.values[0]))
    state = _knowing(state, {**library, known: (tight,)})
    verdict = conclude(closed(rivals(state)))
    assert verdict.verdict == "ambiguous"
    (finding,) = verdict.effects
    assert finding.name != known.name
    assert known in finding.rivals


def test_what_ran_to_its_bounds_leaves_a_clear_gap_unexplained() -> None:
    log = record(_viscous, xml=TURNTABLES)
    state = _start(log)
    known = Candidate("viscous_damping", "elbow")
    library = state.setting.library
    tight = replace(library[known][0], high=0.2)  # 0.3 is hidden
    state = _knowing(state, {**library, known: (tight,)})
    ran = AppliedEffect(known.name, known.target, {"damping": tight.high})
    state, (best,) = state.fit([[ran]])
    verdict = conclude(closed(replace(state, best=best)), complete=False)
    assert verdict.verdict == "unexplained"
    reached = "its damping reached 0.2 N m s/rad, the most that is searched"
    assert f"viscous_damping elbow is not named: {reached}" in str(
        verdict.unexplained["note"]
    )


@pytest.mark.thorough
def test_intervals_are_as_wide_as_the_spread_where_an_arm_hardly_holds() -> None:
    log = record(xml=TURNTABLES)
    late = tuple(_told_earlier(one, frames=2) for one in log.recordings)
    state = _searched(_start(replace(log, recordings=late)))

    def half_width(state: State) -> float:
        (finding,) = conclude(closed(state), complete=False).effects
        value = finding.parameters["delay"]
        return (value.high - value.low) / 2

    assert half_width(state) < 5e-4
    # As of a motor that is too weak for its arm.
    weak = replace(state, sensitivity=4.0)
    assert half_width(weak) == pytest.approx(NORMAL * 0.03 * 2 / FPS, rel=0.05)


@pytest.mark.thorough
def test_the_share_that_stays_is_of_the_held_out_mean_square_above_the_noise() -> None:
    def hide(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[1] = 0.2
        model.dof_damping[:] *= 0.97  # which is no gap by itself, nor named beside one
        model.body_mass[:] *= 1.02

    verdict = _verdict(record(hide))
    assert [finding.name for finding in verdict.effects] == ["coulomb_friction"]
    gap, left = verdict.gap, verdict.unexplained
    above = [x**2 - gap.noise_floor**2 for x in (gap.after_heldout, gap.before_heldout)]
    assert left["share"] == pytest.approx(above[0] / above[1], rel=1e-6)
    assert left["share"] > 0.0
    assert str(left["note"]).endswith(
        "parameters that are about 3% off would leave as much"
    )


@pytest.mark.thorough
def test_names_that_leave_much_more_than_noise_are_doubted() -> None:
    """As where the very effect is none that the search knows."""

    def hide(model: mujoco.MjModel) -> None:
        model.dof_frictionloss[1] = 0.3

    state = _start(record(hide), TWO_LINKS)
    known = ("backlash", "load_friction", "armature")  # no dry friction
    library = state.setting.library
    state = _knowing(state, {c: p for c, p in library.items() if c.name in known})
    verdict = conclude(closed(_searched(state)), complete=False)
    assert verdict.effects
    assert verdict.gap.after_heldout > 3 * verdict.gap.noise_floor
    assert "more is missing than what is named" in str(verdict.unexplained["note"])


def test_a_robot_at_rest_shows_nothing_and_is_said_to_show_nothing() -> None:
    verdict = _verdict(record(_viscous, motion=_at_rest, xml=_WEIGHTLESS), _WEIGHTLESS)
    assert verdict.verdict == "not_identifiable"


@pytest.mark.thorough
def test_what_only_the_fitted_recordings_show_is_no_improvement() -> None:
    verdict = _verdict(_only_in(_dry))
    assert verdict.verdict == "no_improvement"
    assert not verdict.effects
