"""Wording of effects, and of values with units, in messages and reports."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rlco.gap.compare.problem import Candidate
from rlco.gap.compare.verdict import NamedEffect
from rlco.physics.effects import AppliedEffect

_SMALLER = {"rad": ("mrad", 1e3), "m": ("mm", 1e3), "s": ("ms", 1e3)}
_LEAST, _MOST = 5e-7, 1e9  # beyond these a number has only zeros, or too many digits
_MIXED = "mixed"  # unit of a root mean square over radians and metres


def in_words(name: str) -> str:
    """Return a name with spaces, as in prose.

    Example:
        >>> in_words("viscous_damping")
        'viscous damping'
    """
    words = name.replace("_", " ")
    for person in ("Coulomb", "Stribeck"):
        words = words.replace(person.lower(), person)
    return words


def title(effect: Candidate | NamedEffect | AppliedEffect) -> str:
    """Name an effect and its target.

    Example:
        >>> title(Candidate("viscous_damping", "joint4"))
        'viscous damping at joint4'
    """
    return in_words(effect.name) + (f" at {effect.target}" if effect.target else "")


def title_of(key: str) -> str:
    """Name what a key of `NamedEffect.evidence` stands for: ``name target``.

    Example:
        >>> title_of("actuator_lag elbow"), title_of("command_delay None")
        ('actuator lag at elbow', 'command delay')
    """
    name, _, target = key.partition(" ")
    return title(Candidate(name, target if target not in ("", "None") else None))


def scale_of(unit: str, largest: float = 0.0) -> tuple[str, float]:
    """Choose the unit in which values up to `largest` read best.

    Example:
        >>> scale_of("rad", 0.02), scale_of("rad", 2.0), scale_of("N m", 0.02)
        (('mrad', 1000.0), ('rad', 1.0), ('N m', 1.0))
    """
    return _SMALLER[unit] if unit in _SMALLER and largest < 0.5 else (unit, 1.0)


def number(value: float, width: float = math.inf) -> str:
    """Format a number with three digits, or enough to resolve an interval's width.

    Example:
        >>> number(1.0007, 0.0048)
        '1.001'
        >>> number(0.012345), number(1234.5), number(-2.0), number(0.0)
        ('0.0123', '1234', '-2.00', '0')
        >>> number(4.2e-7), number(3.4e12)
        ('4.20e-07', '3.40e+12')
    """
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    if not _LEAST <= abs(value) < _MOST:
        return f"{value:.2e}"
    digits = 2 - math.floor(math.log10(abs(value)))
    if 0 < width < math.inf:
        digits = max(digits, -math.floor(math.log10(width)))
    return f"{value:.{min(max(digits, 0), 6)}f}"


def amount(value: float, unit: str) -> str:
    """Format a size with its unit.

    Example:
        >>> amount(0.0123, "rad"), amount(0.4, "")
        ('12.3 mrad', '0.400')
    """
    shown, factor = scale_of(unit, abs(value))
    if unit == _MIXED:
        shown, factor = "mrad or mm", 1e3
    return f"{number(value * factor)} {shown}".strip()


def listed(words: Sequence[str], last: str = "and") -> str:
    """Join words into an enumeration.

    Example:
        >>> listed(["a", "b", "c"])
        'a, b and c'
    """
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} {last} {words[-1]}"


def capital(words: str) -> str:
    """Capitalize the first letter.

    Example:
        >>> capital("payload at Hand")
        'Payload at Hand'
    """
    return words[:1].upper() + words[1:]


def plain(value: object) -> str:
    """Format a value of any type.

    Example:
        >>> plain(0.1234567), plain(True), plain([AppliedEffect("payload", "hand", {})])
        ('0.1235', 'yes', 'payload at hand')
    """
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, AppliedEffect | Candidate):
        return title(value)
    if isinstance(value, list | tuple):
        return ", ".join(map(plain, value)) or "nothing"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
