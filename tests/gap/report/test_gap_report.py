"""The reports: every key, the right numbers, one file, and nothing made up."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from html_page import Read
from matplotlib.figure import Figure
from small_problems import Arm, Interruptible, arm_problem
from small_verdicts import DAMPING, FRICTION, named, nothing_named

from rlco.gap.compare.problem import Candidate, Hypothesis
from rlco.gap.compare.verdict import FreeForm, NamedEffect, Value, Verdict
from rlco.gap.diagnose.regimes import label_regimes
from rlco.gap.diagnose.traces import best_stretches, figure_data
from rlco.gap.diagnose.where import where
from rlco.gap.report import report_html
from rlco.gap.report.figures import gap_bars, heat_map, png, trace_figure
from rlco.gap.report.free_form import free_form_figure, free_form_section
from rlco.gap.report.next_steps import next_steps
from rlco.gap.report.report_html import Page, page
from rlco.gap.report.report_json import report
from rlco.gap.report.verdict_text import MEANING, certainty, headline, numbers_of
from rlco.gap.search.find_gap import find_gap
from rlco.gap.search.verdict import DOUBT
from rlco.physics.effects import EFFECTS

MOTION = {"motion": "slow triangle", "seconds": 20.0}


@pytest.fixture(scope="module")
def problem() -> Arm:
    return arm_problem(FRICTION, DAMPING)


def written(problem: Arm, verdict: Verdict) -> dict[str, object]:
    content = report(verdict, where(problem), problem.model, [MOTION])
    # Strict JSON, as any program reads it.
    return dict(json.loads(json.dumps(content, allow_nan=False)))


def test_json_has_the_keys_that_programs_rely_on(problem: Arm) -> None:
    verdict = named(problem, "ambiguous")
    content = written(problem, verdict)
    friction = {"value": 0.6, "low": 0.57, "high": 0.63, "unit": "N m"}
    damping = {"value": 0.6, "low": 0.52, "high": 0.68, "unit": "N m s/rad"}
    assert list(content) == [
        *("complete", "verdict", "effects", "gap", "where", "unexplained"),
        *("closest", "record_next", "seconds", "unstable"),
    ]
    assert content["effects"] == [
        {
            "name": "coulomb_friction",
            "target": "elbow",
            "parameters": {"frictionloss": friction},
            "rivals": [{"name": "load_friction", "target": "elbow"}],
        },
        {
            "name": "viscous_damping",
            "target": "shoulder",
            "parameters": {"damping": damping},
            "rivals": [],
        },
    ]
    gap = verdict.gap
    assert content["gap"] == {
        "unit": "rad",
        "before": {"train_rms": gap.before_train, "heldout_rms": gap.before_heldout},
        "after": {"train_rms": gap.after_train, "heldout_rms": gap.after_heldout},
        "noise_floor": gap.noise_floor,
    }
    assert content["unexplained"] == dict(verdict.unexplained)
    assert content["closest"] == []
    assert content["record_next"] == [MOTION]
    assert content["where"][0].keys() == {"target", "share", "regime"}


def test_json_says_after_is_before_where_nothing_is_named(problem: Arm) -> None:
    content = written(problem, nothing_named(problem))
    gap = content["gap"]
    assert gap["after"] == gap["before"]
    assert content["effects"] == []
    nearest = {"name": "armature", "target": "elbow", "share": 0.2}
    assert content["closest"] == [nearest]


def test_json_ends_an_open_interval_at_the_bounds_of_the_search(problem: Arm) -> None:
    verdict = named(problem)
    open_ended = Value(0.6, -math.inf, math.inf, "N m")
    finding = replace(verdict.effects[0], parameters={"frictionloss": open_ended})
    content = written(problem, replace(verdict, effects=(finding,)))
    (bounds,) = EFFECTS["coulomb_friction"].parameters(problem.model, "elbow")
    number = content["effects"][0]["parameters"]["frictionloss"]
    assert (number["low"], number["high"]) == (bounds.low, bounds.high)


@pytest.fixture(autouse=True)
def figures_undrawn(
    monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    """Make the figures, but not their pixels: three quarters of a page's time.

    Of a page that is whole and of one without any disagreement they are drawn.
    """
    drawn = (
        test_the_page_needs_nothing_but_itself,
        test_a_log_of_the_model_itself_has_a_page,
    )
    if request.function not in drawn:
        monkeypatch.setattr(report_html, "png", lambda figure: b"undrawn")


def html(problem: Arm, verdict: Verdict, **more: object) -> str:
    labels = label_regimes(problem)
    before = where(problem, labels=labels)
    figures = figure_data(problem, verdict, before, labels)
    return page(Page(verdict, figures, problem.log, **more))


def test_the_page_needs_nothing_but_itself(problem: Arm) -> None:
    text = html(problem, named(problem))
    read = Read(text)
    assert read.open == []
    # Before and after, a trace for each effect, and the heat map.
    assert [a[:22] for a in read.addresses] == ["data:image/png;base64,"] * 4
    assert not re.search(r"https?:|<script|@import|url\(", text)


def test_the_page_tells_the_verdict_and_its_numbers(problem: Arm) -> None:
    verdict = named(problem, "ambiguous")
    read = Read(html(problem, verdict, record_next=[MOTION]))
    assert " ".join(read.first) == (
        "Missing from the model: Coulomb friction at elbow (or load friction at elbow) "
        "and viscous damping at shoulder."
    )
    assert "frictionloss 0.600 N m 0.570 to 0.630" in read.text
    assert "load friction at elbow: 1 % worse" in read.text
    assert "backlash at elbow: ruled out, 42 % worse" in read.text
    assert "8 % of the held-out gap stays, most of it at elbow." in read.text
    assert "It grows with speed." in read.text
    assert "slow triangle" in read.text
    after = f"{1e3 * verdict.gap.after_heldout:.3f} mrad"
    assert f"to {after}; the measurement's own noise is 0.400 mrad" in read.text


def test_the_page_names_nothing_where_nothing_was_named(problem: Arm) -> None:
    read = Read(html(problem, nothing_named(problem)))
    assert "Missing from the model" not in read.text
    assert "armature at elbow 20 %" in read.text
    # That is of all recordings, see `closest` in docs/gap.md.
    assert "share of the error it would explain" in read.text
    assert "none of these is the answer" in read.text
    assert len(read.alts) == 3  # one trace: where the disagreement is largest


def test_the_page_escapes_what_came_from_files(problem: Arm) -> None:
    strange = replace(problem.log, notes=("<b>note</b> & more",))
    arm = Arm(strange)
    text = html(arm, named(arm), command="uv run x out='<a>'")
    assert "&lt;b&gt;note&lt;/b&gt; &amp; more" in text
    assert "&lt;a&gt;" in text
    assert Read(text).open == []


@pytest.mark.slow
@pytest.mark.parametrize(("floors", "warns"), [(32.0, True), (1.1, False)])
def test_a_small_share_of_a_large_gap_is_told_where_it_is_no_noise(
    problem: Arm, floors: float, warns: bool
) -> None:
    verdict = named(problem)
    verdict = replace(
        verdict,
        gap=replace(verdict.gap, after_heldout=floors * verdict.gap.noise_floor),
        unexplained={**verdict.unexplained, "share": 0.004},
    )
    text = Read(html(problem, verdict)).text
    assert ("12.8 mrad stay unexplained, more than noise" in text) == warns
    assert ("Less than 1 % of the held-out gap stays" in text) == warns


def test_an_interrupted_search_says_so(problem: Arm) -> None:
    verdict = replace(named(problem), complete=False)
    assert "as far as the search got" in headline(verdict, where(problem))
    assert "The search was stopped early" in " ".join(certainty(verdict))


def test_the_reports_draw_what_was_simulated_before(
    problem: Arm, monkeypatch: pytest.MonkeyPatch
) -> None:
    labels, verdict = label_regimes(problem), named(problem)
    figures = figure_data(problem, verdict, where(problem, labels=labels), labels)
    source = Page(verdict, figures, problem.log)

    def simulated(*_: object) -> None:
        raise AssertionError("a report simulates")

    monkeypatch.setattr(Arm, "traces", simulated)
    monkeypatch.setattr(Arm, "residuals", simulated)
    assert len(Read(page(source)).alts) == 4
    assert report(verdict, figures.before, problem.model)["verdict"] == "named"


def test_a_search_that_never_began_names_nothing(problem: Arm) -> None:
    verdict = find_gap(Interruptible(problem.log, interrupt_at=1))
    size = float(np.sqrt(np.mean(problem.residuals([Hypothesis()]) ** 2)))
    assert verdict.gap.before_heldout == verdict.gap.after_heldout == size
    words = Read(html(problem, verdict)).first
    assert " ".join(words).startswith("The search was stopped before naming anything")


@pytest.mark.parametrize("kind", ["no_gap", "no_improvement", "not_identifiable"])
def test_each_verdict_has_its_own_words(problem: Arm, kind: str) -> None:
    before = where(problem)
    words = headline(nothing_named(problem, kind), before)
    others = [k for k in MEANING if k not in (kind, "named", "ambiguous")]
    assert words not in [headline(nothing_named(problem, k), before) for k in others]
    assert f"{1e3 * nothing_named(problem).gap.before_heldout:.1f} mrad" in words


def test_an_effect_that_nearly_explains_all_is_reported_first(problem: Arm) -> None:
    most = ((Candidate("joint_offset", "elbow"), 0.967),)
    near = replace(nothing_named(problem), closest=most)
    read = Read(html(problem, near))
    assert "Joint offset at elbow alone explains 97 % of it, but numbers" in read.text
    assert "The first may be the answer" in read.text
    assert "nothing in the library" not in read.text
    assert "(spread=0.003): it says how large joint offset at elbow is" in read.text
    assert "a gap that one effect nearly explains" in read.text
    assert "a gap that nothing explains" not in read.text
    # A fifth of it, as here, is no explanation.
    read = Read(html(problem, nothing_named(problem)))
    assert "and nothing here explains it" in read.text
    assert "Tried and rejected" in read.text


def test_what_a_calibration_left_is_not_said_of_the_model_as_it_is(
    problem: Arm,
) -> None:
    plain = nothing_named(problem, "no_gap")
    for verdict, model, when, todo in (
        (plain, "nominal model", "Before any fit", "Nothing: the model"),
        (
            replace(plain, calibrated=True),
            "calibrated model",
            "After the calibration",
            "Use the calibrated model",
        ),
    ):
        labels = label_regimes(problem)
        figures = figure_data(problem, verdict, where(problem, labels=labels), labels)
        read = Read(page(Page(verdict, figures, problem.log)))
        assert f"What to do now {todo}" in read.text
        assert f"{when}, over all recordings" in read.text
        assert headline(verdict).startswith(f"The {model.removeprefix('nominal ')}")
        shown = "the calibrated model" if verdict.calibrated else "the model as it is"
        assert figures.nominal == shown
    named_beside = replace(named(problem), since_reference=True)
    figures = figure_data(problem, named_beside, figures.before, labels)
    assert figures.nominal == "as known before"


def test_a_log_of_the_model_itself_has_a_page(problem: Arm) -> None:
    tracks = [problem.traces(Hypothesis(), i)["simulated"] for i in range(3)]
    logs = zip(problem.log.recordings, tracks, strict=True)
    exact = [replace(one, position=np.array(track)) for one, track in logs]
    arm = Arm(replace(problem.log, recordings=tuple(exact)))
    assert not arm.residuals([Hypothesis()]).any()
    read = Read(html(arm, nothing_named(arm, "no_gap")))
    assert "Nowhere above the noise." in read.text


def test_names_are_no_formulas() -> None:
    names, sizes = ("$j^{$", "$\\frac$"), np.full(2, 1e-3)
    assert png(gap_bars(names, ("rad",) * 2, sizes, 9 * sizes, None))[1:4] == b"PNG"


def test_figures_show_the_numbers(problem: Arm) -> None:
    before = where(problem)
    after = where(problem, Hypothesis((FRICTION, DAMPING)))
    names = (before.channels, before.units, before.noise)
    bars = gap_bars(*names, before.rms, after.rms).axes[0].patches
    heights = [bar.get_height() for bar in bars]
    np.testing.assert_allclose(heights, 1e3 * np.concatenate([before.rms, after.rms]))

    maps = [("before", before.heat), ("after", after.heat)]
    first, second = heat_map(*names, maps, [2]).axes[:2]
    shown = [axes.collections[0] for axes in (first, second)]
    np.testing.assert_allclose(shown[0].get_array(), 1e3 * before.heat.rms)
    # One scale for both, or mending would not show.
    assert shown[0].get_clim() == shown[1].get_clim()

    (stretch,) = best_stretches(problem, nothing_named(problem))
    _, below = trace_figure(stretch, "x").axes
    left = below.lines[-1].get_ydata()
    np.testing.assert_allclose(left, 1e3 * (stretch.measured - stretch.nominal))


def test_a_number_is_told_before_and_after_where_the_model_has_some(
    problem: Arm,
) -> None:
    friction, damping = named(problem).effects
    # The model has 0.3 N m s/rad and no friction, shown as 0.
    ((name, value, ends),) = numbers_of(damping, problem.model)
    assert (name, value, ends) == (
        "damping",
        "0.300 → 0.900 N m s/rad",
        "0.820 to 0.980",
    )
    assert numbers_of(friction, problem.model)[0][1] == "0 → 0.600 N m"
    factor = {"factor": Value(1.5, 1.4, 1.6, "")}
    heavier = NamedEffect("link_inertia", "lower", factor)
    ((name, value, ends),) = numbers_of(heavier, problem.model)
    assert (name, value, ends) == ("mass", "0.400 → 0.600 kg", "0.560 to 0.640")
    stiffer = NamedEffect("actuator_gain", "elbow", factor)
    assert numbers_of(stiffer, problem.model)[0][:2] == (
        "stiffness kp",
        "40.0 → 60.0 N m/rad",
    )
    weaker = NamedEffect("torque_limit", "elbow", {"limit": Value(6, 5, 7, "N m")})
    assert numbers_of(weaker, problem.model)[0][1] == "9.00 → 6.00 N m"
    late = NamedEffect("command_delay", None, {"delay": Value(0.04, 0.03, 0.05, "s")})
    assert numbers_of(late, problem.model)[0][1] == "40.0 ms"


@pytest.mark.slow
@pytest.mark.parametrize("kind", list(MEANING))
def test_what_to_do_now_comes_before_all_figures_in_plain_words(
    problem: Arm, kind: str
) -> None:
    effects = kind in ("named", "ambiguous")
    verdict = named(problem, kind) if effects else nothing_named(problem, kind)
    text = html(problem, verdict, record_next=[MOTION] if kind == "ambiguous" else ())
    top = text.partition("<h2>")[0]
    assert "What to do now" in top
    read = Read(top)
    assert kind not in read.text or kind == "unstable_model"
    if kind == "ambiguous":
        assert (
            "(slow triangle): it distinguishes Coulomb friction at elbow from"
            in read.text
        )


def test_what_no_motion_tells_apart_is_not_asked_for(problem: Arm) -> None:
    verdict = named(problem, "ambiguous")
    silent = {**MOTION, "motion": "no_motion_backlash", "tells_apart": "this, that"}
    alone = " ".join(next_steps(verdict, [silent]))
    assert "No motion of these joints tells these apart: this, that." in alone
    assert "proposed below" not in alone
    both = " ".join(next_steps(verdict, [MOTION, silent]))
    assert "Record what is proposed below (slow triangle)." in both
    assert "it distinguishes" not in both


def test_only_what_is_as_good_is_called_so(problem: Arm) -> None:
    verdict = named(problem)  # its rivals are ruled out
    text = Read(html(problem, verdict)).text
    assert "as well" not in text.partition("The gap, before")[0]
    assert "load friction at elbow: ruled out, 1 % worse" in text


@pytest.mark.slow
def test_nothing_is_listed_with_0_per_cent(problem: Arm) -> None:
    verdict = replace(
        nothing_named(problem),
        closest=(
            (Candidate("armature", "elbow"), 0.2),
            (Candidate("payload", "x"), 0.001),
        ),
    )
    text = Read(html(problem, verdict)).text
    assert "armature at elbow 20 %" in text
    assert "payload at x" not in text
    first = named(problem).effects[0]
    tied = replace(first, evidence={"backlash elbow": 0.001, "armature elbow": 9.0})
    text = Read(html(problem, replace(named(problem), effects=(tied,)))).text
    assert "backlash at elbow: ruled out armature" in text
    assert "armature at elbow: ruled out, 10 times as bad" in text
    assert "leaves as much in held-out recordings" in text


def test_joints_names_stand_whole_in_every_figure(problem: Arm) -> None:
    names = ("left_shoulder_pitch_joint", "left_shoulder_roll_joint")
    before = where(problem)
    told = (names, before.units, before.noise)
    bars = gap_bars(*told, before.rms, None)
    heat = heat_map(*told, [("before", before.heat)], [2])
    (stretch,) = best_stretches(problem, nothing_named(problem))
    trace = trace_figure(replace(stretch, channel=names[0]), f"Armature at {names[0]}")
    for figure, axis in ((bars, "x"), (heat, "y")):
        ticks = getattr(figure.axes[0], f"get_{axis}ticklabels")()
        assert [tick.get_text() for tick in ticks] == list(names)
    label = trace.axes[0].get_ylabel().replace("\n", "")
    assert label.startswith(names[0])
    # What is drawn of it lies inside the figure and beside the legend.
    trace.canvas.draw()
    title = trace._suptitle.get_window_extent()
    assert not title.overlaps(trace.legends[0].get_window_extent())
    bars.canvas.draw()
    edges = [tick.get_window_extent().x0 for tick in bars.axes[0].get_xticklabels()]
    assert min(edges) >= 0


def test_much_that_stays_is_said_before_the_names(problem: Arm) -> None:
    verdict = named(problem)
    gap = replace(verdict.gap, after_heldout=50.0 * verdict.gap.noise_floor)
    doubted = {**verdict.unexplained, "note": f"It grows with speed; {DOUBT}"}
    loud = replace(verdict, gap=gap, unexplained=doubted)
    assert headline(loud).startswith(
        "Not the whole gap: 20.0 mrad stay unexplained, 50 times the noise. Missing"
    )
    # A tolerance that explains as much raises no doubt.
    assert headline(replace(verdict, gap=gap)).startswith("Missing from the model")


def free_form() -> FreeForm:
    knots = np.array([-1.0, 0.0, 1.0])
    return FreeForm("elbow", 0.4, *(np.stack([k * knots, -knots]) for k in (1, 2, 9)))


@pytest.mark.thorough
def test_what_acts_outside_the_library_is_said_and_drawn(problem: Arm) -> None:
    verdict = replace(named(problem), free_form=free_form())
    assert headline(verdict).startswith("Something outside the library acts at elbow")
    assert "leaves 40 % less error" in " ".join(certainty(verdict))
    outside = written(problem, verdict)["outside"]
    assert outside["target"] == "elbow"
    assert outside["over_velocity"] == {"velocity": [-2, 0, 2], "torque": [1, 0, -1]}
    figure = free_form_figure(free_form(), "rad")
    lines = [axes.lines[1].get_xydata() for axes in figure.axes]
    assert [line[-1].tolist() for line in lines] == [[1, -1], [2, -1], [9, -1]]
    assert "Outside the library, at elbow" in free_form_section(free_form(), None)
    assert free_form_section(None, None) == ""


@pytest.mark.parametrize(
    ("kind", "unit"),
    [("hinge", "rad"), pytest.param("slide", "m", marks=pytest.mark.thorough)],
)
def test_a_free_form_is_drawn_in_its_joints_units_whatever_the_residuals_are_in(
    problem: Arm, monkeypatch: pytest.MonkeyPatch, kind: str, unit: str
) -> None:
    drawn: list[str] = []

    def spy(free: FreeForm, unit: str) -> Figure:
        drawn.append(unit)
        return free_form_figure(free, unit)

    monkeypatch.setattr("rlco.gap.report.free_form.free_form_figure", spy)
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body><joint name="elbow" type="{kind}"/>
        <geom size=".1"/></body><body><joint name="shoulder"/><geom size=".1"/></body>
        </worldbody></mujoco>"""
    )
    verdict = replace(named(problem), free_form=free_form())
    verdict = replace(verdict, gap=replace(verdict.gap, unit="N m"))
    html(problem, verdict, model=model)
    assert drawn == [unit]
