"""Names in a log matched to those in a model."""

from __future__ import annotations

import re
from collections.abc import Sequence

from rlco.physics.effects.names import plain_name


def match_names(given: Sequence[str], known: Sequence[str]) -> dict[str, str]:
    """Match names in a log to known ones; those that match none are left out.

    Tried in this order, each for all names at once: the same name; the same but for
    upper case and punctuation; the same without robosuite's prefixes; the same without
    a beginning or an end that all names on one side share (``fer_joint1`` and
    ``joint1``); numbers that count them, from 0 or 1, where there are as many; and one
    without a name for one.

    Example:
        >>> match_names(["fer_joint1", "fer_joint2"], ["joint1", "joint2"])
        {'fer_joint1': 'joint1', 'fer_joint2': 'joint2'}
        >>> match_names(["0", "1"], ["hip", "knee"])
        {'0': 'hip', '1': 'knee'}
    """
    best: dict[str, str] = {}
    for simplify in (list, _plain, _as_in_robosuite, _without_shared):
        theirs, ours = simplify(given), simplify(known)
        if len(set(theirs)) < len(theirs) or len(set(ours)) < len(ours):
            continue
        named = dict(zip(ours, known, strict=True))
        found = {
            name: named[key]
            for name, key in zip(given, theirs, strict=True)
            if key in named
        }
        best = found if len(found) > len(best) else best
    return best or _counted(given, known)


def _counted(given: Sequence[str], known: Sequence[str]) -> dict[str, str]:
    if len(given) == len(known) == 1 and not given[0]:
        return {given[0]: known[0]}
    if (
        not given
        or len(given) != len(known)
        or not all(name.isdecimal() for name in given)
    ):
        return {}
    numbers = sorted(given, key=int)
    first = int(numbers[0])
    counts = [int(name) for name in numbers] == list(range(first, first + len(known)))
    return dict(zip(numbers, known, strict=True)) if counts and first < 2 else {}


def _plain(names: Sequence[str]) -> list[str]:
    return [re.sub(r"[\W_]+", "", name).lower() for name in names]


def _as_in_robosuite(names: Sequence[str]) -> list[str]:
    return _plain([plain_name(name) for name in names])


def _without_shared(names: Sequence[str]) -> list[str]:
    plain = _plain(names)
    if len(plain) < 2:
        return plain
    before = len(_shared_words(names))
    after = len(_shared_words([name[::-1] for name in names]))
    return [name[before : len(name) - after] for name in plain]


def _shared_words(names: Sequence[str]) -> str:
    """Return the beginning that all names share, up to a mark between words."""
    first, last = min(names).lower(), max(names).lower()
    same = [a == b for a, b in zip(first, last, strict=False)]
    shared = first[: [*same, False].index(False)]
    end = max((m.end() for m in re.finditer(r"[\W_]+", shared)), default=0)
    return re.sub(r"[\W_]+", "", shared[:end])
