"""What a search on a servo's bench knows so far."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from rlco.gap.compare.problem import Candidate
from rlco.gap.search.comparison import DOUBT, block_test, seconds_of
from rlco.gap.search.servo.ladder import Judged, Ladder, judge

Known = Mapping[tuple[Candidate, ...], Judged]


@dataclass(frozen=True)
class ServoState:
    """What a search knows so far.

    Attributes:
        ladder: What explanations are made of.
        none: The servo's own numbers alone.
        best: The best explanation so far.
        known: All that were judged, in this order, by their effects.
        path: Effects of the explanations that led to the best.
        others: For each effect of the best, explanations with another in its place;
            empty until they were judged.
    """

    ladder: Ladder
    none: Judged
    best: Judged
    known: Known
    path: tuple[tuple[Candidate, ...], ...] = ()
    others: Mapping[Candidate, tuple[Judged, ...]] = field(default_factory=dict)

    def judged(self, base: Judged, added: Candidate) -> tuple[ServoState, Judged]:
        """Return a state that knows one more explanation, and that explanation."""
        effects = (*base.effects, added)
        if effects in self.known:
            return self, self.known[effects]
        one = judge(self.ladder, base, added)
        return replace(self, known={**self.known, effects: one}), one


def better(ladder: Ladder, one: Judged, other: Judged) -> bool:
    """Return whether held-out recordings are better with one explanation, surely."""
    blocks = seconds_of(ladder.problem.layout)
    return block_test(one.residual, other.residual, blocks) > DOUBT
