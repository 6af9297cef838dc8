"""A verdict in words: what is missing, where, how much, and how certain that is."""

from __future__ import annotations

import mujoco

from rlco.gap.compare.problem import Candidate
from rlco.gap.compare.stability.instability import UNSTABLE, summary
from rlco.gap.compare.verdict import FreeForm, HeldOut, NamedEffect, Verdict
from rlco.gap.compare.wording import (
    amount,
    capital,
    in_words,
    listed,
    number,
    scale_of,
    title,
    title_of,
)
from rlco.gap.diagnose.where import EVERYWHERE, Cell, Where
from rlco.gap.search.judge import LOUD
from rlco.gap.search.verdict import DOUBT
from rlco.physics.effects import EFFECTS, Parameter

#: Share of an unexplained gap from which on the effect that explains it is reported.
NEARLY = 0.8
#: Each verdict in plain English.
PLAIN_VERDICTS = {
    "no_gap": "no gap",
    "no_improvement": "nothing helps on other recordings",
    "named": "a missing effect found",
    "ambiguous": "several explanations",
    "unexplained": "a gap that nothing explains",
    "not_identifiable": "these recordings cannot tell",
    "no_change": "no change",
    UNSTABLE: "the simulation breaks",
}
#: What each verdict means, in one sentence.
MEANING = {
    "no_gap": "No single effect explains more of the residual than a change of a few "
    "per cent in every parameter of the model would.",
    "no_improvement": "Some effects fit the recordings that they were fitted to, but "
    "none improves the model on the others.",
    "named": "One explanation fits the held-out recordings, and all others do clearly "
    "worse.",
    "ambiguous": "Several explanations fit these recordings equally well: they are "
    "listed, and the motions to record next would distinguish them.",
    "unexplained": "There is a disagreement, and nothing in the library explains it.",
    "not_identifiable": "The recorded motion is not informative enough to decide.",
    "no_change": "Nothing in the library explains more of the difference between the "
    "two recordings than what is not known of either.",
    UNSTABLE: "The model's simulation breaks before anything is compared, so there was "
    "no search: correct the model, and run this again.",
}


#: The same where the model was calibrated to these recordings before.
_MEANING_CALIBRATED = {
    "no_gap": "No single effect explains more of what the calibration left than what "
    "that leaves open would.",
    "named": "One explanation fits what the calibration left in held-out recordings, "
    "and all others do clearly worse.",
    "unexplained": "There is a disagreement that the calibration left, and nothing in "
    "the library explains it.",
}
#: When a disagreement was computed.
_MEANING_NEAREST = (
    "There is a disagreement that one effect nearly explains. It is not named: most of "
    "what it explains is no more than numbers of the model that are each a little off "
    "would explain, and of what is beyond that it leaves more than half."
)
BEFORE_FITS = "before any fit"
AFTER_CALIBRATION = "after the calibration"
BESIDE_KNOWN = "beside what was known before"


def meaning(verdict: Verdict) -> str:
    """Return what a verdict means, in one sentence."""
    kind = verdict.verdict
    if verdict.calibrated and kind in _MEANING_CALIBRATED:
        return _MEANING_CALIBRATED[kind]
    return MEANING[kind] if nearest(verdict) is None else _MEANING_NEAREST


def before_of(verdict: Verdict) -> str:
    """Return when the disagreement before was computed."""
    if verdict.calibrated:
        return AFTER_CALIBRATION
    return BESIDE_KNOWN if verdict.since_reference else BEFORE_FITS


def numbers_of(
    finding: NamedEffect, model: mujoco.MjModel | None = None
) -> list[tuple[str, str, str]]:
    """Return each parameter of an effect as text: its name, value and interval.

    Args:
        finding: The effect.
        model: The nominal model: where it already has some of the effect, the value is
            given before and after.

    Example:
        >>> from rlco.gap.compare.verdict import Value
        >>> numbers = {"delay": Value(0.031, 0.029, 0.033, "s")}
        >>> numbers_of(NamedEffect("command_delay", None, numbers))
        [('delay', '31.0 ms', '29.0 to 33.0')]
    """
    known = {} if model is None else _parameters(finding, model)
    texts = []
    for name, value in finding.parameters.items():
        ends, words, given = [value.value, value.low, value.high], name, value.unit
        present = known[name].present if name in known else None
        if present is not None:
            ends = [known[name].after(end) for end in ends]
            words, given = present.multiplied or name, present.unit or given
        unit, factor = scale_of(given, max(map(abs, ends)))
        width = (ends[2] - ends[1]) * factor
        best, low, high = (number(end * factor, width) for end in ends)
        if present is not None:
            best = f"{number(present.value * factor)} → {best}"
        texts.append((in_words(words), f"{best} {unit}".strip(), f"{low} to {high}"))
    return texts


def _parameters(finding: NamedEffect, model: mujoco.MjModel) -> dict[str, Parameter]:
    known = EFFECTS[finding.name].parameters(model, finding.target)
    return {parameter.name: parameter for parameter in known}


def worse(by: float) -> str:
    """Return how much larger an explanation's residual is; empty if it rounds to 0.

    Example:
        >>> worse(0.27), worse(23.84), worse(0.001)
        ('27 % worse', '24.8 times as bad', '')
    """
    if by >= 1.0:
        return f"{1.0 + by:.3g} times as bad"
    return f"{100 * by:.0f} % worse" if by >= 0.005 else ""


def place(cell: Cell) -> str:
    """Return the joint and the regime of a cell of the table.

    Example:
        >>> place(Cell("elbow", "fast", 10, 0.1, 0.1, 0.5, 9.0, 1.0))
        'elbow, fast'
    """
    return cell.target if cell.regime == EVERYWHERE else f"{cell.target}, {cell.regime}"


def where_lines(before: Where, when: str = BEFORE_FITS) -> list[str]:
    """Return where the model disagrees most, in a few lines.

    Args:
        before: Where it does.
        when: When that was computed.
    """
    units = dict(zip(before.channels, before.units, strict=True))
    cells = before.informative[:4]
    lines = []
    if before.diverged > 0:
        lines.append(f"{100 * before.diverged:.0f} % of the simulation diverges")
    elif not cells:
        lines.append("no disagreement")
    if cells:
        lines.append(f"{when}, the disagreement is")
    for cell in cells:
        size = amount(cell.rms, units[cell.target])
        lines.append(f"  {100 * cell.share:3.0f} % in {place(cell)} ({size})")
    return lines


def verdict_lines(
    verdict: Verdict, before: Where, model: mujoco.MjModel | None = None
) -> list[str]:
    """Return the verdict in a few lines: the headline, parameters and certainty."""
    lines = [headline(verdict, before)]
    for effect in verdict.effects:
        for name, value, ends in numbers_of(effect, model):
            lines.append(f"  {title(effect)}: {name} {value} ({ends})")
    return lines + [f"  {line}" for line in certainty(verdict)]


def headline(verdict: Verdict, where: Where | None = None) -> str:
    """Return the verdict in one sentence: what, where (if known), how certain."""
    if verdict.instability is not None:
        return capital(f"{summary(verdict.instability)}.")
    residual = amount(verdict.gap.before_heldout, verdict.gap.unit)
    most = where.informative[0] if where and where.informative else None
    at = f", most of it at {place(most)}" if most else ""
    if verdict.effects:
        effects = listed([_missing(finding) for finding in verdict.effects])
        better = "" if verdict.complete else ", as far as the search got"
        what = "Changed" if verdict.since_reference else "Missing from the model"
        return f"{_first(verdict)}{what}: {effects}{better}."
    if not verdict.complete:
        return f"The search was stopped before naming anything: {residual} remain{at}."
    model = "The calibrated model" if verdict.calibrated else "The model"
    if verdict.verdict == "no_gap":
        return f"{model} agrees with the recordings: {residual} on held-out ones."
    if verdict.verdict == "no_change":
        return f"Nothing changed: {residual} on held-out recordings."
    if verdict.verdict == "no_improvement":
        return f"Nothing in the library improves the model: {residual} remain{at}."
    if verdict.verdict == "not_identifiable":
        return f"These recordings do not show what is missing: {residual} remain{at}."
    both = f"{model} and the log" if verdict.calibrated else "Model and log"
    gap = f"{both} disagree by {residual}{at}"
    if (near := nearest(verdict)) is None:
        return f"{gap}, and nothing here explains it."
    one, share = near
    return (
        f"{gap}. {capital(title(one))} alone explains {100 * share:.0f} % of it, "
        "but numbers of the model that are a little off would explain most of that too."
    )


def nearest(verdict: Verdict) -> tuple[Candidate, float] | None:
    """Return an effect that nearly explains an unexplained gap, and its share of it."""
    if verdict.verdict != "unexplained" or verdict.effects or not verdict.closest:
        return None
    one, share = verdict.closest[0]
    return (one, share) if share >= NEARLY else None


def _first(verdict: Verdict) -> str:
    """Return what to know before the names: that something else is missing."""
    gap, note = verdict.gap, str(verdict.unexplained.get("note"))
    if is_loud(verdict) and DOUBT in note:
        times = f"{gap.after_heldout / gap.noise_floor:.0f} times the noise"
        after = amount(gap.after_heldout, gap.unit)
        return f"Not the whole gap: {after} stay unexplained, {times}. "
    if verdict.free_form is not None:
        joint = verdict.free_form.target
        return f"Something outside the library acts at {joint}, too, or instead. "
    return ""


def _missing(finding: NamedEffect) -> str:
    if not finding.rivals:
        return title(finding)
    rivals = listed([title(rival) for rival in finding.rivals], "or")
    return f"{title(finding)} (or {rivals})"


def is_loud(verdict: Verdict) -> bool:
    """Return whether the residual of the named effects is clearly above the noise.

    Of a gap hundreds of times the noise, even a wrong effect may explain 99 %.
    """
    gap = verdict.gap
    return bool(verdict.effects) and gap.after_heldout > LOUD * gap.noise_floor


_HELD_OUT = " in held-out recordings: something outside the library acts there."
_OF_ALL = (
    ": something outside the library acts there. It was estimated in all recordings, "
    "held-out ones too, so it predicts none."
)


def outside_line(free: FreeForm) -> str:
    """Return in one sentence what acts outside the library.

    Example:
        >>> import numpy as np
        >>> none = np.zeros((2, 1))
        >>> outside_line(FreeForm("elbow", 0.4, none, none, none))
        'A torque of some shape over position and velocity at elbow, besides, leaves \
40 % less error in held-out recordings: something outside the library acts there.'
    """
    less = f"leaves {100 * free.gain:.0f} % less error"
    if free.of_encoder:
        return (
            f"An error of the encoder at {free.target}, of some shape over its "
            f"position, besides, {less}" + (_HELD_OUT if free.predicts else _OF_ALL)
        )
    if not free.predicts:
        return (
            f"A torque that takes a course of its own over time at {free.target}, "
            f"besides, {less}{_OF_ALL}"
        )
    return (
        f"A torque of some shape over position and velocity at {free.target}, besides, "
        f"{less}{_HELD_OUT}"
    )


def held_out_line(held_out: HeldOut, *, named: bool) -> str:
    """Return how much the error on recordings held out in turn improves.

    Args:
        held_out: The groups and their errors.
        named: Whether effects were named.
    """
    groups = listed([group.label for group in held_out.groups])
    line = (
        f"Each of {groups} was held out once: the mean absolute error there is "
        f"{amount(held_out.before, held_out.unit)} with the model's own "
        f"{held_out.numbers_before} parameters fitted"
    )
    if named:
        after = amount(held_out.after, held_out.unit)
        line += f", and {after} with the effects ({held_out.numbers_after} parameters)"
    return f"{line}."


def certainty(verdict: Verdict) -> list[str]:
    """Return what the effects explain, and by how much they beat other explanations.

    For a model that diverges, return what to look at.
    """
    if verdict.instability is not None:
        return list(verdict.instability.advice)
    gap, lines = verdict.gap, []
    if verdict.held_out is not None:
        lines.append(held_out_line(verdict.held_out, named=bool(verdict.effects)))
    elif verdict.effects:
        before, after = (
            amount(size, gap.unit) for size in (gap.before_heldout, gap.after_heldout)
        )
        those = "it" if len(verdict.effects) == 1 else "them"
        floor = "the measurement's own noise is"
        if verdict.since_reference:
            floor = "the recordings before leave unknown"
        lines.append(
            f"With {those}, the disagreement in held-out recordings falls "
            f"from {before} to {after}; {floor} {amount(gap.noise_floor, gap.unit)}."
        )
    for finding in verdict.effects:
        others = sorted(finding.evidence.items(), key=lambda item: item[1])
        if finding.rivals:
            rivals = listed([title(rival) for rival in finding.rivals], "or")
            lines.append(
                f"These recordings cannot distinguish {title(finding)} from {rivals}."
            )
        elif others:
            name, by = others[0]
            more = "as much" if by < 0.005 else f"{100 * by:.0f} % more"
            if by >= 1.0:
                more = f"{1.0 + by:.3g} times as much"
            lines.append(
                f"{capital(title(finding))}: the next best explanation, "
                f"{title_of(name)}, leaves {more} in held-out recordings."
            )
    if verdict.free_form is not None:
        lines.append(outside_line(verdict.free_form))
    lines += verdict.remarks
    share, note = (verdict.unexplained.get(key) for key in ("share", "note"))
    if is_loud(verdict):
        residual = gap.after_heldout
        if verdict.held_out is not None:
            residual = verdict.held_out.after
        after = amount(residual, gap.unit)
        lines.append(f"{after} stay unexplained, more than noise: {note}.")
    elif verdict.effects and isinstance(share, int | float) and share >= 0.05:
        lines.append(f"{100 * share:.0f} % of the gap stays unexplained: {note}.")
    if not verdict.complete:
        lines.append("The search was stopped early: this is the best so far.")
    return lines
