"""``report.html``: the verdict for people, one file that needs nothing but itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files

from rlco.gap.best_traces import best_stretches
from rlco.gap.figures import gap_bars, heat_map, trace_figure
from rlco.gap.html_parts import (
    definitions,
    image,
    lines,
    paragraphs,
    plain,
    table,
)
from rlco.gap.problem import Finding, Problem, Verdict
from rlco.gap.regimes import Labels
from rlco.gap.report_where import cell_table, contact_line, regime_table
from rlco.gap.where import Where, where
from rlco.gap.words import (
    MEANING,
    amount,
    capital,
    certainty,
    headline,
    in_words,
    is_loud,
    numbers_of,
    place,
    title,
    title_of,
)
from rlco.physics.effects import EFFECTS


@dataclass(frozen=True)
class Page:
    """What a report is written from.

    Attributes:
        problem: The robot's model and log.
        verdict: What was found.
        before: Where the model as it is disagrees, over all recordings.
        labels: The regimes of every recording.
        record_next: Motions that would tell more.
        command: What was typed to get this report.
        files: What lies beside the report, by name, and what it is for.
    """

    problem: Problem
    verdict: Verdict
    before: Where
    labels: Sequence[Labels]
    record_next: Sequence[Mapping[str, object]] = ()
    command: str = ""
    files: Mapping[str, str] | None = None


def page(source: Page) -> str:
    """Return ``report.html``."""
    heldout = source.verdict.heldout or None
    problem, labels = source.problem, source.labels
    first = where(problem, labels=labels, recordings=heldout)
    mended = source.verdict.hypothesis if source.verdict.effects else None
    last = where(problem, mended, labels=labels, recordings=heldout) if mended else None
    sections = (
        _header(source),
        _effects(source),
        _gap(source, first, last),
        _traces(source),
        _where(source),
        _unexplained(source, last),
        _next(source),
        _trail(source),
        _log(source),
        _again(source),
    )
    heading = headline(source.verdict, source.before)
    style = "".join(
        (files("rlco") / name).read_text("utf-8")
        for name in ("report.css", "gap/report_html.css")
    )
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(heading)}</title>\n<style>\n{style}</style>\n</head>\n"
        f"<body>\n<main>\n{chr(10).join(filter(None, sections))}\n</main>\n"
        "</body>\n</html>\n"
    )


def _header(source: Page) -> str:
    verdict, log = source.verdict, source.problem.log
    facts = (
        f"{len(log.recordings)} recordings, {log.seconds:.0f} s",
        f"{len(verdict.train)} fitted, {len(verdict.heldout)} held out",
        f"searched for {verdict.seconds:.0f} s",
    )
    gap = verdict.gap
    cards = [("before", amount(gap.before_heldout, gap.unit))]
    if verdict.effects:
        cards.append(("after", amount(gap.after_heldout, gap.unit)))
    cards.append(("noise floor", amount(gap.noise_floor, gap.unit)))
    shown = "".join(
        f'<div class="card"><span class="quiet">{escape(name)}</span>'
        f"<strong>{escape(size)}</strong></div>"
        for name, size in cards
    )
    sure = paragraphs(certainty(verdict))
    if verdict.complete:
        sure += f'<p class="quiet">{escape(MEANING[verdict.verdict])}</p>'
    return (
        f'<header>\n<p class="kicker">rlco · find_gap · '
        f"{escape(in_words(verdict.verdict))}</p>\n"
        f"<h1>{escape(headline(verdict, source.before))}</h1>\n"
        f'<p class="quiet">{escape(" · ".join(facts))}</p>\n</header>\n'
        f'<div class="cards">{shown}</div>\n{sure}'
    )


def _effects(source: Page) -> str:
    verdict = source.verdict
    if not verdict.effects:
        rows = [
            [escape(title(one)), f"{100 * share:.0f} %"]
            for one, share in verdict.closest
        ]
        if not rows:
            return ""
        return (
            "<h2>What comes nearest</h2>\n"
            + table(["effect", "share of the held-out gap it would explain"], rows)
            + '<p class="quiet">Tried and not named: none of these is the answer.</p>'
        )
    rows = [_effect_row(finding) for finding in verdict.effects]
    return (
        "<h2>What is missing</h2>\n"
        + table(["effect", "numbers", "rivals"], rows)
        + '<p class="quiet">Below each number the interval that holds it nine times of '
        "ten. A rival explains these recordings as well; how much worse one does is "
        "counted in recordings that were not fitted.</p>"
    )


def _effect_row(finding: Finding) -> list[str]:
    known = EFFECTS[finding.name]
    name = (
        f"<strong>{escape(title(finding))}</strong>"
        f'<p class="quiet">{escape(known.summary)} {escape(known.signature)}</p>'
    )
    numbers = "".join(
        f'<p class="number">{escape(word)} <strong>{escape(best)}</strong><br>'
        f'<span class="interval">{escape(ends)}</span></p>'
        for word, best, ends in numbers_of(finding)
    )
    rivals = {title(rival): "as good" for rival in finding.rivals}
    for key, worse in sorted(finding.evidence.items(), key=lambda item: item[1]):
        known_rival = title_of(key) in rivals
        how = f"{100 * worse:.0f} % worse"
        rivals[title_of(key)] = how if known_rival else f"ruled out, {how}"
    told = [f"{label}: {how}" for label, how in list(rivals.items())[:5]]
    return [name, numbers, lines(told or ["none"])]


def _gap(source: Page, first: Where, last: Where | None) -> str:
    after = None if last is None else last.rms
    names = (first.channels, first.units, first.noise)
    heldout = bool(source.verdict.heldout)
    heading = "The gap" if after is None else "The gap, before and after"
    figure = gap_bars(*names, first.rms, after, heldout)
    return f"<h2>{heading}</h2>\n" + image(figure)


def _traces(source: Page) -> str:
    stretches = best_stretches(source.problem, source.verdict)
    names = [title(finding) for finding in source.verdict.effects]
    headings = [capital(name) for name in names] or ["The largest disagreement"]
    figures = [
        image(trace_figure(stretch, heading))
        for stretch, heading in zip(stretches, headings, strict=True)
    ]
    lead = (
        "<p>For each effect the seconds in which it helps most, from recordings that "
        "were not fitted.</p>\n"
        if names
        else ""
    )
    return "<h2>How it looks</h2>\n" + lead + "\n".join(figures)


def _where(source: Page) -> str:
    before, verdict = source.before, source.verdict
    maps = [("the model as it is", before.heat)]
    if verdict.effects:
        after = where(source.problem, verdict.hypothesis, labels=source.labels)
        maps.append(("mended", after.heat))
    figure = heat_map(
        before.channels, before.units, before.noise, maps, verdict.heldout
    )
    parts = ["<h2>Where it disagreed</h2>", cell_table(before), contact_line(before)]
    if before.diverged > 0:
        parts.append(
            f"<p>{100 * before.diverged:.1f} % of the simulation with the model as it "
            "is diverged, and is left out here.</p>"
        )
    return "\n".join([*parts, image(figure), regime_table(before)])


def _unexplained(source: Page, last: Where | None) -> str:
    left = source.verdict.unexplained
    share, target, note = (left.get(key) for key in ("share", "target", "note"))
    if not isinstance(share, int | float):
        return ""
    if share < 0.01 and not is_loud(source.verdict):
        return ""
    part = f"{100 * share:.0f} %" if share >= 0.01 else "Less than 1 %"
    words = f"{part} of the held-out gap stays"
    words += f", most of it at {target}." if target else "."
    found = last or source.before
    rows = [f"{place(cell)}: {100 * cell.share:.0f} %" for cell in found.telling[:3]]
    text = paragraphs([words, str(note or "")])
    if rows:
        text += f"<p>Where it is now:</p>{lines(rows)}"
    return f"<h2>What stays unexplained</h2>\n{text}"


def _next(source: Page) -> str:
    if not source.record_next:
        return ""
    rows = [
        [escape(str(value)) for value in motion.values()]
        for motion in source.record_next
    ]
    head = [in_words(str(key)) for key in source.record_next[0]]
    return "<h2>What to record next</h2>\n" + table(head, rows)


def _trail(source: Page) -> str:
    trail = source.verdict.trail
    if not trail:
        return ""
    head = list(dict.fromkeys(key for row in trail for key in row))
    rows = [[escape(plain(row.get(key, ""))) for key in head] for row in trail]
    return (
        "<h2>What was tried</h2>\n<details><summary>"
        f'{len(rows)} steps of the search</summary><div class="wide">'
        f"{table([in_words(key) for key in head], rows)}</div></details>"
    )


def _log(source: Page) -> str:
    notes = source.problem.log.notes
    return "<h2>Notes on the log</h2>\n" + lines(notes) if notes else ""


def _again(source: Page) -> str:
    parts = []
    if source.files:
        parts.append(
            f"<h2>Beside this report</h2>\n{definitions(source.files.items())}"
        )
    if source.command:
        parts.append(f"<h2>Make it again</h2>\n<pre>{escape(source.command)}</pre>")
    return "\n".join(parts)
