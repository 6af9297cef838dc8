"""``report.html``: the verdict for people, in one self-contained file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files

import mujoco
from matplotlib.figure import Figure

from rlco.gap.calibrate.summary import Before, Summary
from rlco.gap.compare.comparisons import Comparison
from rlco.gap.compare.problem import Instability
from rlco.gap.compare.stability.instability import changed_words
from rlco.gap.compare.verdict import NamedEffect, Verdict
from rlco.gap.compare.wording import amount, capital, in_words, plain, title, title_of
from rlco.gap.diagnose.traces import MODELS, FigureData
from rlco.gap.logs.log import Log
from rlco.gap.report.calibration import calibration_section, reference_section
from rlco.gap.report.compared import comparison_lines
from rlco.gap.report.figures import gap_bars, heat_map, png, trace_figure
from rlco.gap.report.film import Film
from rlco.gap.report.free_form import free_form_section
from rlco.gap.report.held_out import held_out_section
from rlco.gap.report.next_steps import next_steps
from rlco.gap.report.trail import trail_section
from rlco.gap.report.verdict_text import (
    MEANING,
    PLAIN_VERDICTS,
    before_of,
    certainty,
    headline,
    is_loud,
    meaning,
    nearest,
    numbers_of,
    place,
    worse,
)
from rlco.gap.report.where_tables import cell_table, contact_line, regime_table
from rlco.gap.search.judge import BETTER
from rlco.physics.effects import EFFECTS
from rlco.reporting import html


@dataclass(frozen=True)
class Page:
    """The content of a report.

    Attributes:
        verdict: The result of the search.
        figures: Where simulation and measurement disagree, before and after.
        log: The recordings.
        record_next: Motions that would be more informative.
        command: The command that made this report.
        files: The files beside the report, by name, and their purpose.
        comparisons: All comparisons, that of the verdict first.
        compared: The same in sentences, with what was left out.
        model: The nominal model, for parameters before and after.
        calibration: What a calibration fitted before the search.
        before: What is known from recordings made before.
        beyond: What the calibration found beyond what is usual.
        film: The robot, measured and simulated; or why it is not to be seen.
        known: The model with what was known before the search; None: `model`.
    """

    verdict: Verdict
    figures: FigureData
    log: Log
    record_next: Sequence[Mapping[str, object]] = ()
    command: str = ""
    files: Mapping[str, str] | None = None
    comparisons: Sequence[Comparison] = ()
    compared: Sequence[str] = ()
    model: mujoco.MjModel | None = None
    calibration: Summary | None = None
    before: Before | None = None
    beyond: Sequence[NamedEffect] = ()
    film: Film | str = ""
    known: mujoco.MjModel | None = None


def page(source: Page) -> str:
    """Return ``report.html``."""
    if source.verdict.instability is not None:
        return _unstable(source, source.verdict.instability)
    sections = (
        _header(source),
        _effects(source),
        _beyond(source),
        reference_section(
            source.calibration, source.before, named=bool(source.verdict.effects)
        ),
        held_out_section(source.verdict),
        _gap(source),
        _traces(source),
        _where(source),
        _unexplained(source),
        free_form_section(source.verdict.free_form, source.model),
        calibration_section(
            source.calibration,
            source.beyond,
            source.model,
            sizes=source.before is None,
        ),
        _next(source),
        trail_section(source.verdict.trail),
        _log(source),
        _again(source),
    )
    return _document(headline(source.verdict, source.figures.before), sections)


def _unstable(source: Page, instability: Instability) -> str:
    """Return the page of a model whose simulation diverges."""
    verdict, log = source.verdict, source.log
    divergences = instability.divergences
    heading = headline(verdict, source.figures.before)
    count = f"in {len(divergences)} of {len(log.recordings)} recordings"
    if instability.changed:
        kind, name = changed_words(instability.changed)
        count += f", with the {kind} of {name} one per cent larger"
    rows = [
        [
            escape(one.name),
            f"{one.time:.3f} s",
            *map(escape, (one.joint or "", one.body or "")),
        ]
        for one in divergences
    ]
    what = "oscillates" if instability.bounded else "diverges"
    sections = (
        f"<header>\n{_kicker(verdict)}\n<h1>{escape(heading)}</h1>\n</header>\n"
        f"{_now(source)}\n<p>{escape(MEANING[verdict.verdict])}</p>",
        "<h2>What to look at</h2>\n" + html.bullets(instability.advice),
        f"<h2>Where and when it {what}</h2>\n"
        f"<p>It does {escape(count)}; the joint is the first that goes wrong.</p>\n"
        + html.table(["recording", "at", "joint", "body"], rows),
        _log(source),
        _again(source),
    )
    return _document(heading, sections)


def _document(heading: str, sections: Iterable[str]) -> str:
    """Return a whole page, without empty sections."""
    style = (files("rlco") / "gap" / "report" / "report_html.css").read_text("utf-8")
    return html.page(heading, "\n".join(filter(None, sections)), style=style)


def _kicker(verdict: Verdict) -> str:
    plain = PLAIN_VERDICTS.get(verdict.verdict, in_words(verdict.verdict))
    if verdict.since_reference and verdict.verdict == "named":
        plain = "a change found"
    if nearest(verdict) is not None:
        plain = "a gap that one effect nearly explains"
    words = escape(plain)
    return f'<p class="kicker">rlco · find_gap · {words}</p>'


def _now(source: Page) -> str:
    steps = next_steps(source.verdict, source.record_next, source.comparisons)
    return f"<aside><strong>What to do now</strong>{html.bullets(steps)}</aside>"


def _header(source: Page) -> str:
    verdict, log = source.verdict, source.log
    split = f"{len(verdict.train)} fitted, {len(verdict.heldout)} held out"
    if verdict.held_out is not None:
        split = f"{len(verdict.held_out.groups)} groups held out in turn"
    facts = (
        f"{len(log.recordings)} recordings, {log.seconds:.0f} s",
        split,
        f"searched for {verdict.seconds:.0f} s",
    )
    gap, held_out = verdict.gap, verdict.held_out
    before, after = gap.before_heldout, gap.after_heldout
    if held_out is not None:
        before, after = held_out.before, held_out.after
    first = "calibrated" if verdict.calibrated else "before"
    cards = [(first, amount(before, gap.unit))]
    if verdict.effects:
        cards.append(("after", amount(after, gap.unit)))
    floor = "not known" if verdict.since_reference else "noise floor"
    cards.append((floor, amount(gap.noise_floor, gap.unit)))
    boxes = "".join(
        f'<div class="card"><span class="quiet">{escape(name)}</span>'
        f"<strong>{escape(size)}</strong></div>"
        for name, size in cards
    )
    sure = html.paragraphs(certainty(verdict))
    if verdict.complete:
        sure += f'<p class="quiet">{escape(meaning(verdict))}</p>'
    now = " ".join(next_steps(verdict, source.record_next, source.comparisons))
    words = [*comparison_lines(source.comparisons), *source.compared]
    words = [line for line in words if line not in now]
    return (
        f"<header>\n{_kicker(verdict)}\n"
        f"<h1>{escape(headline(verdict, source.figures.before))}</h1>\n"
        f'<p class="quiet">{escape(" · ".join(facts))}</p>\n</header>\n'
        f'<div class="cards">{boxes}</div>\n{_now(source)}\n{sure}'
        f"{html.paragraphs(words)}"
    )


def _effects(source: Page) -> str:
    verdict = source.verdict
    if not verdict.effects:
        rows = [
            [escape(title(one)), f"{100 * share:.0f} %"]
            for one, share in verdict.closest
            if share >= 0.005
        ]
        if not rows:
            return ""
        rejected = "Tried and rejected: none of these is the answer."
        if nearest(verdict) is not None:
            rejected = "The first may be the answer, which these recordings do not say."
        return (
            "<h2>The closest explanations</h2>\n"
            + html.table(["effect", "share of the error it would explain"], rows)
            + f'<p class="quiet">{escape(rejected)}</p>'
        )
    known = source.known or source.model
    rows = [_effect_row(finding, known) for finding in verdict.effects]
    what, whose = "is missing", "model's value"
    if verdict.since_reference:
        what, whose = "changed", "value before"
    arrow = f"An arrow leads from the {whose} to the identified one. "
    return (
        f"<h2>What {what}</h2>\n"
        + html.table(["effect", "parameters", "other explanations"], rows)
        + f'<p class="quiet">{arrow if "→" in str(rows) else ""}Below each value is '
        "its 90 % interval. Other explanations were fitted in place of the effect: "
        "these recordings cannot distinguish those that are as good; those that are "
        "ruled out leave a larger residual in held-out recordings.</p>"
    )


def _beyond(source: Page) -> str:
    if not source.beyond:
        return ""
    rows = [_effect_row(one, source.model)[:2] for one in source.beyond]
    return (
        "<h2>What the calibration found</h2>\n"
        + html.table(["effect", "parameters"], rows)
        + '<p class="quiet">Further from the model than 95 % of its prior, and known '
        "from these recordings. No search compared it with other explanations.</p>"
    )


def _effect_row(finding: NamedEffect, model: mujoco.MjModel | None) -> list[str]:
    known = EFFECTS[finding.name]
    name = (
        f"<strong>{escape(title(finding))}</strong>"
        f'<p class="quiet">{escape(known.summary)} {escape(known.signature)}</p>'
    )
    numbers = "".join(
        f'<p class="number">{escape(word)} <strong>{escape(best)}</strong><br>'
        f'<span class="interval">{escape(ends)}</span></p>'
        for word, best, ends in numbers_of(finding, model)
    )
    others = {title(rival): "as good" for rival in finding.rivals}
    for key, by in sorted(finding.evidence.items(), key=lambda item: item[1]):
        if title_of(key) not in others:
            others[title_of(key)] = ", ".join(filter(None, ["ruled out", worse(by)]))
        elif worse(by):
            doubt = ", but not beyond doubt" if by > BETTER else ""
            others[title_of(key)] = worse(by) + doubt
    listed = [f"{label}: {how}" for label, how in list(others.items())[:5]]
    return [name, numbers, html.bullets(listed) if listed else "none"]


def _gap(source: Page) -> str:
    first, last = source.figures.heldout_before, source.figures.heldout_after
    after = None if last is None else last.rms
    names = (first.channels, first.units, first.noise)
    heldout = bool(source.verdict.heldout)
    heading = "The gap" if after is None else "The gap, before and after"
    nominal = source.figures.nominal
    figure = gap_bars(*names, first.rms, after, heldout, nominal)
    return f"<h2>{heading}</h2>\n" + _image(figure)


def _traces(source: Page) -> str:
    names = [title(finding) for finding in source.verdict.effects]
    headings = [capital(name) for name in names] or ["The largest disagreement"]
    figures = [
        _image(trace_figure(stretch, heading, source.figures.nominal))
        for stretch, heading in zip(source.figures.stretches, headings, strict=True)
    ]
    lead = (
        "<p>For each effect, the seconds in which it helps most, from held-out "
        "recordings.</p>\n"
        if names
        else ""
    )
    return "<h2>How it looks</h2>\n" + _film(source.film) + lead + "\n".join(figures)


def _film(film: Film | str) -> str:
    if isinstance(film, str):
        return f'<p class="quiet">{escape(film)}</p>\n' if film else ""
    address = html.data_address(film.content, "video/mp4")
    return (
        f'<figure><video src="{address}" controls loop muted playsinline '
        f'preload="auto" aria-label="{escape(film.caption)}"></video>'
        f"<figcaption>{escape(film.caption)}</figcaption></figure>\n"
    )


def _where(source: Page) -> str:
    before, verdict = source.figures.before, source.verdict
    when = capital(before_of(verdict))
    model = MODELS.get(source.figures.nominal, "nominal model")
    maps = [(model, before.heat)]
    if source.figures.after is not None:
        maps.append(("corrected", source.figures.after.heat))
    figure = heat_map(
        before.channels, before.units, before.noise, maps, verdict.heldout
    )
    table = cell_table(before, when)
    parts = ["<h2>Where it disagreed</h2>", table, contact_line(before)]
    if before.diverged > 0:
        parts.append(
            f"<p>{100 * before.diverged:.1f} % of the simulation with the {model} "
            "diverged, and is excluded here.</p>"
        )
    return "\n".join([*parts, _image(figure), regime_table(before)])


def _unexplained(source: Page) -> str:
    residual = source.verdict.unexplained
    share, target, note = (residual.get(key) for key in ("share", "target", "note"))
    if not isinstance(share, int | float):
        return ""
    if share < 0.01 and not is_loud(source.verdict):
        return ""
    part = f"{100 * share:.0f} %" if share >= 0.01 else "Less than 1 %"
    words = f"{part} of the held-out gap stays"
    words += f", most of it at {target}." if target else "."
    found = source.figures.heldout_after or source.figures.before
    rows = [
        f"{place(cell)}: {100 * cell.share:.0f} %" for cell in found.informative[:3]
    ]
    text = html.paragraphs([words, capital(str(note or ""))])
    if rows:
        text += f"<p>Where it remains:</p>{html.bullets(rows)}"
    return f"<h2>What stays unexplained</h2>\n{text}"


def _next(source: Page) -> str:
    if not source.record_next:
        return ""
    rows = [
        [escape(_cell(key, value)) for key, value in motion.items()]
        for motion in source.record_next
    ]
    head = [in_words(str(key)) for key in source.record_next[0]]
    return "<h2>What to record next</h2>\n" + html.table(head, rows)


def _cell(key: str, value: object) -> str:
    if value is None:
        return "-"
    return in_words(str(value)) if key == "motion" else plain(value)


def _log(source: Page) -> str:
    notes = source.log.notes
    return "<h2>Notes on the log</h2>\n" + html.bullets(notes) if notes else ""


def _again(source: Page) -> str:
    parts = []
    if source.files:
        parts.append(
            f"<h2>Beside this report</h2>\n{html.definitions(source.files.items())}"
        )
    if source.command:
        parts.append(f"<h2>Make it again</h2>\n<pre>{escape(source.command)}</pre>")
    return "\n".join(parts)


def _image(figure: Figure) -> str:
    alt = f"{figure.get_suptitle()}. {figure.get_label()}"
    return html.figure(png(figure), alt)
