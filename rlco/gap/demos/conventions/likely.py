"""Select the few conventions of a log that its motion makes likely."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rlco.gap.demos.conventions.action_units import (
    MOVES,
    TURNS,
    Scale,
    known_scale,
    nearest_scale,
)
from rlco.gap.demos.conventions.actions import (
    ActionConvention,
    Motion,
    Score,
    score,
    scores,
    size,
)
from rlco.gap.demos.conventions.states import StateConvention
from rlco.gap.demos.conventions.tool_motions import motions_of
from rlco.gap.logs.log import Log

EXPLAINED = 0.2  # share of the motion below which a convention is rejected
_TIE = 1.03  # ratio of residuals up to which conventions are equally good
_NEAR = 0.9  # ratio of explained rotation from which state conventions are tied
_MOST = 3  # conventions to replay at most


def likeliest_state(
    log: Log, columns: Sequence[str], likely: Sequence[StateConvention]
) -> tuple[StateConvention, list[str]]:
    """Choose a state convention by how well actions explain the tool's rotation.

    Returns:
        The convention, and phrases on what the log cannot determine.
    """
    if len(likely) == 1:
        return likely[0], []
    explained = []
    for convention in likely:
        turned = [motions_of(r, columns, convention)[1] for r in log.recordings]
        explained.append(scores(turned)[0].explained)
    best = int(np.argmax(explained))
    others = [
        " and ".join(convention.changes()) or "the simulator's own"
        for number, convention in enumerate(likely)
        if number != best and explained[number] > _NEAR * explained[best]
    ]
    return likely[best], [f"whether {other} instead" for other in others]


def best_distinct(ranking: Sequence[Score]) -> list[Score]:
    """Return the best conventions that the motion distinguishes, the simplest first.

    Different conventions can describe the same motion: along the axes of a hand that
    always points down, or with two axes swapped. Only the simple ones are alternatives.
    """
    best = ranking[0]
    near = [
        s for s in ranking if s.residual <= _TIE * best.residual and s.explained > 0.0
    ]
    near = sorted(near, key=lambda s: (s.convention.deviations, s.residual)) or [best]
    simple = near[0].convention.deviations + 1
    return [s for s in near if s.convention.deviations <= simple][:_MOST]


def move_scale(motions: Sequence[Motion], one: Score, nominal: Score) -> Scale:
    """Return the size of one unit of the translations."""
    return _scale(motions, one, nominal, MOVES)


def turn_conventions(
    turned: Sequence[Motion], moves: ActionConvention, nominal: Score
) -> list[tuple[ActionConvention, Scale]]:
    """Return conventions of the rotations, given that of the translations.

    Where the hand hardly turns, the motion does not distinguish them, and several are
    returned, the simplest first.
    """
    same = ActionConvention(moves.kind, moves.frame, lead=moves.lead)
    usual = score(turned, same)
    ranking = [s for s in scores(turned, moves.lead) if s.convention.kind == moves.kind]
    best = best_distinct(ranking)[0]
    if best.explained >= EXPLAINED:
        chosen = usual if usual.residual <= _TIE * best.residual else best
        return [(chosen.convention, _scale(turned, chosen, nominal, TURNS))]
    flipped = replace(same, axes=("-x", "-y", "-z"))
    whole, radians = (known_scale(n, TURNS) for n in list(TURNS)[:2])
    if moves.kind == "absolute":
        return [(same, whole), (flipped, whole)]
    return [(same, whole), (flipped, whole), (same, radians)]


def _scale(
    motions: Sequence[Motion], one: Score, nominal: Score, known: Mapping[str, float]
) -> Scale:
    own = known_scale(next(iter(known)), known)
    if one.convention.kind == "absolute" or one.explained < EXPLAINED:
        return own
    nearest = nearest_scale(size(motions, one.convention, nominal), known)
    return nearest if nearest.name else replace(own, measured=nearest.measured)
