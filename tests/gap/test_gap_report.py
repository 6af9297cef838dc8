"""The reports: every key, the right numbers, one file, and nothing made up."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from small_problems import Arm, arm_problem
from small_verdicts import DAMPING, FRICTION, named, nothing_named

from rlco.gap.best_traces import best_stretches
from rlco.gap.figures import gap_bars, heat_map, trace_figure
from rlco.gap.nothing_yet import nothing_yet
from rlco.gap.problem import Hypothesis, Value, Verdict
from rlco.gap.regimes import label_regimes
from rlco.gap.report_html import Page, page
from rlco.gap.report_json import report
from rlco.gap.where import where
from rlco.gap.words import MEANING, certainty, headline
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
        *("closest", "record_next", "seconds"),
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
    assert content["where"][0].keys() == {"target", "share", "regime"}  # type: ignore[index]


def test_json_says_after_is_before_where_nothing_is_named(problem: Arm) -> None:
    content = written(problem, nothing_named(problem))
    gap = content["gap"]
    assert gap["after"] == gap["before"]  # type: ignore[index]
    assert content["effects"] == []
    nearest = {"name": "armature", "target": "elbow", "share": 0.2}
    assert content["closest"] == [nearest]


def test_json_ends_an_open_interval_at_the_bounds_of_the_search(problem: Arm) -> None:
    verdict = named(problem)
    open_ended = Value(0.6, -math.inf, math.inf, "N m")
    finding = replace(verdict.effects[0], parameters={"frictionloss": open_ended})
    content = written(problem, replace(verdict, effects=(finding,)))
    (bounds,) = EFFECTS["coulomb_friction"].parameters(problem.model, "elbow")
    number = content["effects"][0]["parameters"]["frictionloss"]  # type: ignore[index]
    assert (number["low"], number["high"]) == (bounds.low, bounds.high)


class Read(HTMLParser):
    """Collects the text, the first headline and the addresses of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.words: list[str] = []
        self.first: list[str] = []
        self.addresses: list[str] = []
        self.alts: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        given = dict(attrs)
        self.addresses += [str(given[n]) for n in ("src", "href") if n in given]
        self.alts += [str(given["alt"])] if "alt" in given else []

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.words += data.split()
        if "h1" in self.open:
            self.first += data.split()

    @property
    def text(self) -> str:
        return " ".join(self.words)


def html(problem: Arm, verdict: Verdict, **more: object) -> str:
    labels = label_regimes(problem)
    before = where(problem, labels=labels)
    return page(Page(problem, verdict, before, labels, **more))


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
    assert "none of these is the answer" in read.text
    assert len(read.alts) == 3  # one trace: where the disagreement is largest


def test_the_page_escapes_what_came_from_files(problem: Arm) -> None:
    strange = replace(problem.log, notes=("<b>note</b> & more",))
    arm = Arm(strange)
    text = html(arm, named(arm), command="uv run x out='<a>'")
    assert "&lt;b&gt;note&lt;/b&gt; &amp; more" in text
    assert "&lt;a&gt;" in text
    assert Read(text).open == []


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
    assert "as far as the search came" in headline(verdict, where(problem))
    assert "The search was stopped early" in " ".join(certainty(verdict))


def test_a_search_that_never_began_names_nothing(problem: Arm) -> None:
    verdict = nothing_yet(problem)
    size = float(np.sqrt(np.mean(problem.residuals([Hypothesis()]) ** 2)))
    assert verdict.gap.before_heldout == verdict.gap.after_heldout == size
    words = Read(html(problem, verdict)).first
    assert " ".join(words).startswith("The search was stopped before it named anything")


@pytest.mark.parametrize("kind", ["no_gap", "no_improvement", "not_identifiable"])
def test_each_verdict_has_its_own_words(problem: Arm, kind: str) -> None:
    before = where(problem)
    words = headline(nothing_named(problem, kind), before)
    others = [k for k in MEANING if k not in (kind, "named", "ambiguous")]
    assert words not in [headline(nothing_named(problem, k), before) for k in others]
    assert f"{1e3 * nothing_named(problem).gap.before_heldout:.1f} mrad" in words


def test_a_trace_shows_its_own_effect_where_it_helps_most(problem: Arm) -> None:
    friction, damping = best_stretches(problem, named(problem))
    assert (friction.channel, damping.channel) == ("elbow", "shoulder")
    for stretch in (friction, damping):
        assert stretch.recording == "episode 2"  # the only one that was held out
        assert stretch.mended is not None
        left = np.sqrt(np.mean((stretch.measured - stretch.mended) ** 2))
        before = np.sqrt(np.mean((stretch.measured - stretch.nominal) ** 2))
        assert left < 0.1 * before
    # Each window of 4 s of the elbow, tried one after the other.
    (whole,) = (problem.traces(h, 2) for h in [Hypothesis((FRICTION, DAMPING))])
    other = problem.traces(Hypothesis((DAMPING,)), 2)
    gains = [
        sum(
            np.sum((t["measured"] - t["simulated"])[i : i + 200, 1] ** 2) * sign
            for t, sign in ((other, 1), (whole, -1))
        )
        for i in range(len(whole["time"]) - 199)
    ]
    assert friction.time[0] == whole["time"][int(np.argmax(gains))]


def test_without_effects_the_largest_disagreement_is_shown(problem: Arm) -> None:
    (stretch,) = best_stretches(problem, nothing_named(problem))
    assert stretch.mended is None
    worst = where(problem, recordings=[2])
    assert stretch.channel == worst.channels[int(worst.rms.argmax())]


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
