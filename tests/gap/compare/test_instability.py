"""Models whose simulation diverges: a verdict of its own, and advice that helps."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
from hidden_arms import TWO_LINKS, record
from html_page import Read
from small_problems import Arm, arm_problem
from test_free_body import box, tosses

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.free_body import FreeBody
from rlco.gap.compare.problem import Divergence, Hypothesis, Instability
from rlco.gap.compare.verdict import Verdict
from rlco.gap.diagnose.regimes import label_regimes
from rlco.gap.diagnose.traces import figure_data
from rlco.gap.diagnose.where import where
from rlco.gap.logs.log import Array, Log
from rlco.gap.report.report_html import Page, page
from rlco.gap.report.report_json import report
from rlco.gap.search.find_gap import find_gap
from rlco.gap.search.steps.start import start
from rlco.physics.mj.libmujoco import silenced_warnings

NOISE = np.full(2, 4e-4)
EXPLICIT = 'timestep="0.004" integrator="Euler"'
IMPLICIT = 'timestep="0.004" integrator="implicitfast"'


def changed(*pairs: tuple[str, str]) -> str:
    """Return the two links with words of their XML put in place of others."""
    xml = TWO_LINKS
    for old, new in pairs:
        assert old in xml
        xml = xml.replace(old, new)
    return xml


WILD = {
    # The servo of the elbow swings at 365 rad/s, which 20 ms steps cannot follow.
    "timestep": changed(
        (IMPLICIT, 'timestep="0.02"'), ('kp="20" kv="1"', 'kp="2000" kv="1"')
    ),
    "kv": changed((IMPLICIT, EXPLICIT), ('kp="20" kv="1"', 'kp="20" kv="60"')),
    "inertia": changed(
        (IMPLICIT, EXPLICIT),
        ('damping="0.1"\narmature="0.01"', 'damping="0.1"'),
        (
            'mass="0.3" diaginertia="0.001 0.001 0.001"',
            'mass="1e-5" diaginertia="1e-9 1e-9 1e-9"',
        ),
    ),
    "feedback": changed(
        (
            '<position name="elbow" joint="elbow" kp="20" kv="1"/>',
            '<general name="elbow" joint="elbow" gainprm="20" biastype="affine" '
            'biasprm="0 20 0"/>',
        )
    ),
    "damping": changed(('damping="0.1"', 'damping="-3"')),
}


def problem(xml: str, log: Log | None = None) -> ArmRollouts:
    return ArmRollouts(mujoco.MjSpec.from_string(xml), log or record(), NOISE)


@cache
def verdict(name: str) -> Verdict:
    return find_gap(problem(WILD[name]))


def instability(found: Verdict) -> Instability:
    assert found.verdict == "unstable_model"
    assert found.instability is not None
    return found.instability


def divergences(name: str) -> tuple[Divergence, ...]:
    return instability(verdict(name)).divergences


def advice(found: Verdict) -> str:
    return " ".join(instability(found).advice)


def diverges(xml: str) -> bool:
    return not np.isfinite(problem(xml).residuals([Hypothesis()])).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", WILD)
def test_a_model_that_diverges_is_said_to_and_where_and_when(name: str) -> None:
    found = verdict(name)
    assert found.complete
    assert not found.effects
    assert [one.recording for one in divergences(name)] == [0, 1, 2, 3, 4, 5]
    for one in divergences(name):
        assert (one.joint, one.body) == ("elbow", "lower")
        assert 0.0 < one.time < 4.0
    assert found.unexplained["target"] == "elbow"


def test_when_it_diverges_is_when_mujoco_says_so() -> None:
    model = mujoco.MjModel.from_xml_string(WILD["timestep"])
    (recording,) = record(episodes=1).recordings
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = recording.position[0], recording.velocity[0]
    with silenced_warnings():
        while not data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
            when = data.time
            data.ctrl[:] = recording.command[round(when * 50)]
            mujoco.mj_step(model, data)
    (one, *_) = divergences("timestep")
    assert one.time == pytest.approx(when)


def test_the_time_step_that_is_advised_does_not_diverge() -> None:
    step = instability(verdict("timestep")).timestep
    assert step is not None
    smaller = f'timestep="{step}"'
    assert not diverges(WILD["timestep"].replace('timestep="0.02"', smaller))
    assert f"time step of {1e3 * step:.3g} ms" in advice(verdict("timestep"))


def test_an_explicit_feedback_is_advised_an_implicit_integrator() -> None:
    found = verdict("kv")
    assert instability(found).implicit
    assert 'integrator="implicitfast"' in advice(found)
    assert not diverges(WILD["kv"].replace("Euler", "implicitfast"))


def test_the_armature_that_is_advised_is_enough() -> None:
    found = verdict("inertia")
    words = advice(found)
    assert "'lower' weighs 1e-05 kg" in words
    lacking = float(words.split("armature of ")[1].split(" ")[0])
    for part, wild in ((1.05, False), (0.9, True)):
        more = f'damping="0.1" armature="{part * lacking}"/>'
        assert diverges(WILD["inertia"].replace('damping="0.1"/>', more)) == wild


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("feedback", "'elbow' is pushed away from its command"),
        ("damping", "'elbow' is accelerated along its motion"),
    ],
)
def test_what_pushes_is_named_and_no_time_step_is_advised(
    name: str, words: str
) -> None:
    found = verdict(name)
    assert instability(found).timestep is None
    assert not instability(found).implicit
    assert words in advice(found)


def test_only_the_recordings_that_diverge_are_named() -> None:
    def motion(seed: int) -> Array:
        time = np.arange(200) / 50
        return np.outer(np.sin(3.0 * time), [0.3, 0.9 if seed in (1, 4) else 0.4])

    # A limit that throws back whoever reaches it.
    stop = 'axis="0 1 0" damping="0.1" limited="true" range="-0.7 0.7" '
    stop += 'solreflimit="-1e9 0"'
    xml = changed(('axis="0 1 0" damping="0.1"', stop))
    found = find_gap(problem(xml, record(motion=motion)))
    assert [one.recording for one in instability(found).divergences] == [1, 4]
    text = page(_page(problem(xml, record(motion=motion)), found))
    assert "in 2 of 6 recordings" in Read(text).text


def test_a_model_on_the_brink_is_unstable_by_what_brings_it_down() -> None:
    low, high = 20.0, 2000.0
    step = (IMPLICIT, 'timestep="0.02" integrator="RK4"')
    for _ in range(16):
        middle = 0.5 * (low + high)
        xml = changed(step, ('kp="20" kv="1"', f'kp="{middle}" kv="1"'))
        low, high = (low, middle) if diverges(xml) else (middle, high)
    xml = changed(step, ('kp="20" kv="1"', f'kp="{low}" kv="1"'))
    one = problem(xml)
    found = find_gap(one)
    part = [0.01 * (n == instability(found).changed) for n in one.tolerance_names]
    both = one.residuals([Hypothesis(), Hypothesis((), tuple(part))])
    assert [bool(np.isfinite(rows).all()) for rows in both] == [True, False]
    assert np.isfinite(found.gap.before_heldout)
    assert "is one per cent larger" in Read(page(_page(one, found))).text


LIMITED = changed(
    (IMPLICIT, 'timestep="0.02"'),
    ('kp="20" kv="1"', 'kp="2000" kv="1" forcerange="-5 5"'),
)


def test_a_servo_that_only_its_limit_holds_is_no_less_unstable() -> None:
    assert not diverges(LIMITED)
    found = find_gap(problem(LIMITED))
    assert instability(found).bounded
    assert {one.joint for one in instability(found).divergences} == {"elbow"}
    assert "swings to and fro" in Read(page(_page(problem(LIMITED), found))).text
    # No integrator of MuJoCo takes a servo's stiffness from the step it makes.
    assert not instability(found).implicit
    step = instability(found).timestep
    assert step is not None
    smaller = LIMITED.replace('timestep="0.02"', f'timestep="{step}"')
    check_is_searched(smaller)


def test_a_braking_that_only_its_limit_holds_is_advised_an_implicit_integrator() -> (
    None
):
    xml = WILD["kv"].replace('kv="60"', 'kv="60" forcerange="-5 5"')
    assert instability(find_gap(problem(xml))).implicit
    check_is_searched(xml.replace("Euler", "implicitfast"))


def test_a_servo_that_its_time_step_can_just_follow_is_searched() -> None:
    check_is_searched(LIMITED.replace('kp="2000" kv="1"', 'kp="40" kv="0.5"'))


def check_is_searched(xml: str) -> None:
    start(problem(xml))  # raises where the model is unstable


def _page(one: ArmRollouts | FreeBody | Arm, verdict: Verdict) -> Page:
    labels = label_regimes(one)
    before = where(one, labels=labels)
    figures = figure_data(one, verdict, before, labels)
    return Page(verdict, figures, one.log, command="find it")


@pytest.mark.parametrize("name", WILD)
def test_both_reports_are_written_of_a_model_that_diverges(name: str) -> None:
    one, found = problem(WILD[name]), verdict(name)
    source = _page(one, found)
    content = report(found, source.figures.before, one.model)
    content = json.loads(json.dumps(content, allow_nan=False))
    assert content["gap"]["before"] == {"train_rms": None, "heldout_rms": None}
    first = instability(found).divergences[0]
    assert content["unstable"]["recordings"][0] == {
        "name": "episode 0",
        "time": first.time,
        "joint": "elbow",
        "body": "lower",
    }
    assert content["unstable"]["advice"] == list(instability(found).advice)
    read = Read(page(source))
    assert read.open == []
    assert f"{first.time:.3f} s" in read.text
    assert "elbow" in " ".join(read.first)
    for sentence in instability(found).advice:
        assert " ".join(sentence.split()) in read.text


def test_a_healthy_model_has_no_instability_in_its_report() -> None:
    one = arm_problem()
    found = find_gap(one)
    assert found.verdict == "no_gap"
    assert report(found, where(one), one.model)["unstable"] is None


# A floor that throws back whatever touches it, harder each time.
TRAMPOLINE = 'solref="-1e9 0"'
ROWS_A_TOSS = 59


def test_a_toss_that_diverges_is_infinite_from_then_on() -> None:
    one = FreeBody(box(contact=TRAMPOLINE), tosses(box()))
    rows = one.residuals([Hypothesis()])[0].reshape(-1, ROWS_A_TOSS, 3)
    finite = np.isfinite(rows).all(axis=2)
    assert not finite.all(axis=1).any()
    # The flight before the touch is sound, what follows is not.
    for toss in finite:
        assert toss[0]
        assert (np.diff(toss.astype(int)) <= 0).all()


def test_a_free_body_that_diverges_is_named_with_what_it_touched() -> None:
    one = FreeBody(box(contact=TRAMPOLINE), tosses(box()))
    found = find_gap(one)
    first = instability(found).divergences[0]
    assert first.body == "box"
    assert ("world", "box") in first.touching
    assert "solref" in advice(found)
    assert Read(page(_page(one, found))).open == []


class Broken(Arm):
    """A comparison without plain rollouts, of which a recording is no number."""

    def residuals(self, hypotheses, recordings=None):
        rows = super().residuals(hypotheses, recordings)
        some = recordings or range(len(self.log.recordings))
        of = self.layout.recording[np.isin(self.layout.recording, list(some))]
        rows[:, of == 1] = np.nan
        return rows


def test_a_comparison_without_rollouts_names_the_recording() -> None:
    found = find_gap(Broken(arm_problem().log))
    (one,) = instability(found).divergences
    assert (one.recording, one.joint) == (1, None)
    assert replace(one, time=0.0) == replace(one, time=0.0, touching=())
