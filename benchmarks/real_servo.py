"""A real XL330 servo on BAM's pendulum: which effects hold on a gain never seen.

Every class is fitted to the runs of three of the four firmware gains and judged on the
fourth, as BAM is judged: mean absolute error of the position, mean over the four.
"""

from __future__ import annotations

from collections.abc import Mapping

import real_data

from rlco.gap import find_gap, make_problem
from rlco.gap.compare.verdict import NamedEffect, Verdict
from rlco.gap.compare.wording import title, title_of

ERROR = "held-out error [mrad]"
Row = Mapping[str, object]


def rows() -> list[real_data.Row]:
    """Measure, and return the rows of the table."""
    loaded, log = real_data.servo()
    verdict = find_gap(make_problem(loaded, log))
    return [
        ("servo's own numbers", _best(verdict, 0), "-", "BAM's m1: 68.7"),
        ("best single effects", _best(verdict, 1, few=2), "-", "m3: 56.3"),
        ("best pair", _best(verdict, 2), "<= 38, <= 9 parameters", "36.6; BAM's 54.4"),
        ("best with a third", _best(verdict, 3), "-", "-"),
        ("named", real_data.said(verdict), "two effects", "-"),
        *(_class_row(effect) for effect in verdict.effects),
        (
            "independent channel",
            verdict.remarks[0],
            "contradicted",
            "2.1 V needed, 0.15 measured",
        ),
    ]


def _best(verdict: Verdict, effects: int, *, few: int = 1) -> str:
    """Return the best explanations with so many effects beside the own numbers."""
    judged = [row for row in verdict.trail if len(_effects(row)) == effects]
    # One set of effects may have been reached on two ways.
    sets = {frozenset(map(title, _effects(row))): row for row in reversed(judged)}
    best = sorted(sets.values(), key=lambda row: float(str(row[ERROR])))
    return "; ".join(map(_said, best[:few])) or "-"


def _effects(row: Row) -> tuple[NamedEffect, ...]:
    effects = row["effects"]
    return effects if isinstance(effects, tuple) else ()


def _said(row: Row) -> str:
    names = "+".join(("own numbers", *(one.name for one in _effects(row))))
    folds = " ".join(str(value) for key, value in row.items() if key.startswith("kp "))
    return f"{names}: {row[ERROR]} ({folds}; {row['numbers']} parameters)"


def _class_row(effect: NamedEffect) -> real_data.Row:
    """Say which others do as well in the place of an effect, and which do not."""
    rivals = [title(rival) for rival in effect.rivals]
    worse = {title_of(key): f"+{share:.0%}" for key, share in effect.evidence.items()}
    as_good = ", ".join(f"{one} ({worse[one]})" for one in rivals) or "none"
    others = [f"{one} ({by})" for one, by in worse.items() if one not in rivals]
    targets = {
        "drive_loss": "drive_loss, actuator_gain, torque_limit are one class",
        "load_friction": "load_friction alone",
    }
    return (
        f"as good as {effect.name}",
        f"{as_good}; ruled out: {', '.join(others) or 'none'}",
        targets.get(effect.name, "-"),
        "-",
    )
