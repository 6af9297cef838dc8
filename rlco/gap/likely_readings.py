"""The few readings of a log that its motion leaves likely."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rlco.gap.action_readings import ActionReading, Motion, Score, score, scores, size
from rlco.gap.action_units import MOVES, TURNS, Scale, nearest_scale
from rlco.gap.log import Log
from rlco.gap.state_readings import StateReading
from rlco.gap.task_motions import motions_of

EXPLAINED = 0.2  # of the motion; what explains less is not believed
_TIE = 1.03  # readings that leave so much more are as good
_NEAR = 0.9  # and of states, those whose turns are explained so nearly as well
_MOST = 3  # readings that are worth a replay


def likeliest_state(
    log: Log, columns: Sequence[str], likely: Sequence[StateReading]
) -> tuple[StateReading, list[str]]:
    """Choose among readings of the state by how well actions explain its turns.

    Returns:
        The reading, and what the log cannot tell of it, in words.
    """
    if len(likely) == 1:
        return likely[0], []
    explained = []
    for reading in likely:
        turned = [motions_of(r, columns, reading)[1] for r in log.recordings]
        explained.append(scores(turned)[0].explained)
    best = int(np.argmax(explained))
    others = [
        " and ".join(reading.changes()) or "the simulator's own"
        for number, reading in enumerate(likely)
        if number != best and explained[number] > _NEAR * explained[best]
    ]
    return likely[best], [f"whether {other} instead" for other in others]


def as_good_as(ranking: Sequence[Score]) -> list[Score]:
    """Return the best readings, the simplest first, that the motion tells apart.

    The same motion can be said in many ways: along the axes of a hand that always
    points down, or with two axes changed round. Only simple ones are rivals.
    """
    best = ranking[0]
    near = [s for s in ranking if s.left <= _TIE * best.left and s.explained > 0.0]
    near = sorted(near, key=lambda s: (s.reading.deviations, s.left)) or [best]
    simple = near[0].reading.deviations + 1
    return [s for s in near if s.reading.deviations <= simple][:_MOST]


def move_scale(motions: Sequence[Motion], one: Score, nominal: Score) -> Scale:
    """Return what one number of the translations is worth."""
    return _scale(motions, one, nominal, MOVES)


def turn_readings(
    turned: Sequence[Motion], moves: ActionReading, nominal: Score
) -> list[tuple[ActionReading, Scale]]:
    """Return readings of the rotations, given that of the translations.

    Where a hand hardly turns, its motion does not tell them apart, and several are
    returned, the simplest first.
    """
    same = ActionReading(moves.kind, moves.frame, lead=moves.lead)
    usual = score(turned, same)
    ranking = [s for s in scores(turned, moves.lead) if s.reading.kind == moves.kind]
    best = as_good_as(ranking)[0]
    if best.explained >= EXPLAINED:
        chosen = usual if usual.left <= _TIE * best.left else best
        return [(chosen.reading, _scale(turned, chosen, nominal, TURNS))]
    flipped = replace(same, axes=("-x", "-y", "-z"))
    whole, radians = (Scale(n, TURNS[n], TURNS[n]) for n in list(TURNS)[:2])
    if moves.kind == "absolute":
        return [(same, whole), (flipped, whole)]
    return [(same, whole), (flipped, whole), (same, radians)]


def _scale(
    motions: Sequence[Motion], one: Score, nominal: Score, known: Mapping[str, float]
) -> Scale:
    if one.reading.kind == "absolute" or one.explained < EXPLAINED:
        name = next(iter(known))
        return Scale(name, known[name], known[name])
    return nearest_scale(size(motions, one.reading, nominal), known)
