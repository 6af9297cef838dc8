"""A verdict in words: what is missing, where, how much, and how sure that is."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rlco.gap.problem import Candidate, Finding, Verdict
from rlco.gap.verdict import LOUD
from rlco.gap.where import EVERYWHERE, Cell, Where
from rlco.physics.effects import AppliedEffect

#: What each verdict means, in one sentence.
MEANING = {
    "no_gap": "No single effect explains more of what is left than a few per cent on "
    "every number of the model would.",
    "no_improvement": "Some effects fit the recordings that they were fitted to, and "
    "none makes the model better on the others.",
    "named": "One explanation fits recordings that were not fitted, and all others "
    "do clearly worse.",
    "ambiguous": "Several explanations fit these recordings equally well: they are "
    "listed as rivals, and what to record next would tell them apart.",
    "unexplained": "There is a disagreement, and nothing in the library explains it.",
    "not_identifiable": "The recorded motion does not show enough to tell.",
}
_SMALLER = {"rad": ("mrad", 1e3), "m": ("mm", 1e3), "s": ("ms", 1e3)}
_MIXED = "mixed"  # unit of a root mean square over radians and metres


def in_words(name: str) -> str:
    """Return a name as prose has it.

    Example:
        >>> in_words("viscous_damping")
        'viscous damping'
    """
    words = name.replace("_", " ")
    for person in ("Coulomb", "Stribeck"):
        words = words.replace(person.lower(), person)
    return words


def title(effect: Candidate | Finding | AppliedEffect) -> str:
    """Name an effect and its target.

    Example:
        >>> title(Candidate("viscous_damping", "joint4"))
        'viscous damping at joint4'
    """
    return in_words(effect.name) + (f" at {effect.target}" if effect.target else "")


def title_of(key: str) -> str:
    """Name what a key of `Finding.evidence` stands for: ``name target``.

    Example:
        >>> title_of("actuator_lag elbow"), title_of("command_delay None")
        ('actuator lag at elbow', 'command delay')
    """
    name, _, target = key.partition(" ")
    return title(Candidate(name, target if target not in ("", "None") else None))


def scale_of(unit: str, largest: float = 0.0) -> tuple[str, float]:
    """Choose the unit in which numbers up to `largest` read best.

    Example:
        >>> scale_of("rad", 0.02), scale_of("rad", 2.0), scale_of("N m", 0.02)
        (('mrad', 1000.0), ('rad', 1.0), ('N m', 1.0))
    """
    return _SMALLER[unit] if unit in _SMALLER and largest < 0.5 else (unit, 1.0)


def number(value: float, width: float = math.inf) -> str:
    """Write a number with three digits, or so many that an interval's width shows.

    Example:
        >>> number(1.0007, 0.0048)
        '1.001'
        >>> number(0.012345), number(1234.5), number(-2.0), number(0.0)
        ('0.0123', '1234', '-2.00', '0')
    """
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    digits = 2 - math.floor(math.log10(abs(value)))
    if 0 < width < math.inf:
        digits = max(digits, -math.floor(math.log10(width)))
    return f"{value:.{min(max(digits, 0), 6)}f}"


def amount(value: float, unit: str) -> str:
    """Write a size with its unit.

    Example:
        >>> amount(0.0123, "rad"), amount(0.4, "")
        ('12.3 mrad', '0.400')
    """
    shown, factor = scale_of(unit, abs(value))
    if unit == _MIXED:
        shown, factor = "mrad or mm", 1e3
    return f"{number(value * factor)} {shown}".strip()


def numbers_of(finding: Finding) -> list[tuple[str, str, str]]:
    """Write each number of an effect: its name, its value, its interval.

    Example:
        >>> from rlco.gap.problem import Value
        >>> numbers = {"delay": Value(0.031, 0.029, 0.033, "s")}
        >>> numbers_of(Finding("command_delay", None, numbers))
        [('delay', '31.0 ms', '29.0 to 33.0')]
    """
    texts = []
    for name, value in finding.parameters.items():
        ends = (value.value, value.low, value.high)
        unit, factor = scale_of(value.unit, max(map(abs, ends)))
        width = (value.high - value.low) * factor
        best, low, high = (number(end * factor, width) for end in ends)
        texts.append((in_words(name), f"{best} {unit}".strip(), f"{low} to {high}"))
    return texts


def listed(words: Sequence[str], last: str = "and") -> str:
    """Join words as prose does.

    Example:
        >>> listed(["a", "b", "c"])
        'a, b and c'
    """
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} {last} {words[-1]}"


def capital(words: str) -> str:
    """Begin a sentence.

    Example:
        >>> capital("payload at Hand")
        'Payload at Hand'
    """
    return words[:1].upper() + words[1:]


def place(cell: Cell) -> str:
    """Say where a cell of the table is.

    Example:
        >>> place(Cell("elbow", "fast", 10, 0.1, 0.1, 0.5, 9.0, 1.0))
        'elbow, fast'
    """
    return cell.target if cell.regime == EVERYWHERE else f"{cell.target}, {cell.regime}"


def headline(verdict: Verdict, where: Where) -> str:
    """Say the verdict in one sentence: what, where, how sure."""
    left = amount(verdict.gap.before_heldout, verdict.gap.unit)
    most = where.telling[0] if where.telling else None
    at = f", most of it at {place(most)}" if most else ""
    if verdict.effects:
        effects = listed([_missing(finding) for finding in verdict.effects])
        better = "" if verdict.complete else ", as far as the search came"
        return f"Missing from the model: {effects}{better}."
    if not verdict.complete:
        return f"The search was stopped before it named anything: {left} remain{at}."
    if verdict.verdict == "no_gap":
        return f"The model agrees with the recordings: {left} are left, held out."
    if verdict.verdict == "no_improvement":
        return f"Nothing in the library makes the model better: {left} stay{at}."
    if verdict.verdict == "not_identifiable":
        return f"These recordings cannot tell what is missing: {left} remain{at}."
    return f"Model and recordings disagree by {left}{at}, and nothing here explains it."


def _missing(finding: Finding) -> str:
    if not finding.rivals:
        return title(finding)
    rivals = listed([title(rival) for rival in finding.rivals], "or")
    return f"{title(finding)} (or {rivals})"


def is_loud(verdict: Verdict) -> bool:
    """Return whether what named effects leave is clearly more than the noise.

    Of a gap hundreds of times the noise a wrong effect may leave less than a hundredth.
    """
    gap = verdict.gap
    return bool(verdict.effects) and gap.after_heldout > LOUD * gap.noise_floor


def certainty(verdict: Verdict) -> list[str]:
    """Say what the effects explain, and how far behind their rivals are."""
    gap, lines = verdict.gap, []
    if verdict.effects:
        before, after = (
            amount(size, gap.unit) for size in (gap.before_heldout, gap.after_heldout)
        )
        those = "it" if len(verdict.effects) == 1 else "them"
        lines.append(
            f"With {those}, the disagreement in recordings that were not fitted falls "
            f"from {before} to {after}; the measurement's own noise is "
            f"{amount(gap.noise_floor, gap.unit)}."
        )
    for finding in verdict.effects:
        worse = sorted(finding.evidence.items(), key=lambda item: item[1])
        if finding.rivals:
            rivals = listed([title(rival) for rival in finding.rivals], "or")
            lines.append(
                f"{capital(title(finding))} cannot be told from {rivals} by these "
                "recordings."
            )
        elif worse:
            name, by = worse[0]
            lines.append(
                f"{capital(title(finding))}: the next best explanation, "
                f"{title_of(name)}, leaves {100 * by:.0f} % more in recordings that "
                "were not fitted."
            )
    share, note = (verdict.unexplained.get(key) for key in ("share", "note"))
    if is_loud(verdict):
        after = amount(gap.after_heldout, gap.unit)
        lines.append(f"{after} stay unexplained, more than noise: {note}.")
    elif verdict.effects and isinstance(share, int | float) and share >= 0.05:
        lines.append(f"{100 * share:.0f} % of the gap stays unexplained: {note}.")
    if not verdict.complete:
        lines.append("The search was stopped early: this is the best so far.")
    return lines
