"""The state of a search: a frozen value that each step takes, and returns updated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from rlco.gap.compare.problem import Candidate, Problem
from rlco.gap.compare.verdict import FreeForm, Gap
from rlco.gap.logs.log import Array
from rlco.gap.search.fit import Fit, fit
from rlco.gap.search.lateness import Lateness
from rlco.gap.search.screening import Screening
from rlco.gap.search.setting import Scored, Setting
from rlco.gap.search.whitening import Whitening
from rlco.physics.effects import AppliedEffect


@dataclass(frozen=True)
class Round:
    """One round of the search for another effect.

    Attributes:
        at: The best effects so far, with their Jacobian, in the screening's recordings.
        candidates: Candidates to screen in addition.
        screenings: The change by each of these.
        options: Sets of effects with one more, fitted.
    """

    at: Fit
    candidates: tuple[Candidate, ...]
    screenings: tuple[Screening, ...] = ()
    options: tuple[Scored, ...] = ()


@dataclass(frozen=True)
class Rivals:
    """Alternatives to one effect.

    Attributes:
        as_good: Those that explain the data equally well, the best first.
        evidence: By how much the nearest are worse, held out, by ``name target``.
    """

    as_good: tuple[Candidate, ...]
    evidence: Mapping[str, float]


@dataclass(frozen=True)
class Residual:
    """The remaining gap with the named effects.

    Attributes:
        gap: The disagreement before and after.
        target: The channel with most of it; None where it is no more than noise.
        note: Its channel, and the signal that it correlates with.
    """

    gap: Gap
    target: str | None = None
    note: str = ""


@dataclass(frozen=True)
class State:
    """Everything that a search has found so far.

    Attributes:
        setting: Hypotheses, recordings and weights.
        best: The best set of effects so far.
        screened: Training recordings of a screening.
        scores: The best fit of every set of candidates that was fitted.
        screenings: The last screening at each candidate.
        trail: The attempts, one row each.
        sensitivity: Ratio of the squared sensitivities to the tolerance with and
            without the effects of the last step; large where motors hardly hold.
        visible: Whether effects of typical sizes would show in these recordings.
        beside: Effects, and `Weights.counted_once` with the tolerance's change under
            them.
        round: The current round.
        ended: Whether no further effect helps.
        rivals: Alternatives to each effect of `best`, once they were tried.
        widths: Half the width of the interval of each parameter of `best`.
        correlation: Correlations of these parameters, (parameters, parameters); None
            where nothing is named.
        residual: The remaining gap.
        free_form: A torque of free form that does clearly better than `best`.
        plain: Share of the gap that single effects explain without any tolerance,
            where nothing is named.
        lateness: Times of commands that arrive late at random; None where they do not.
        as_it_is: The robot and its log without the torque from outside that the effects
            were found beside, `free_form`; None where there is none.
    """

    setting: Setting
    best: Scored
    screened: tuple[int, ...]
    scores: Mapping[frozenset[Candidate], Scored]
    screenings: tuple[Screening, ...] = ()
    trail: tuple[Mapping[str, object], ...] = ()
    sensitivity: float = 1.0
    visible: bool = True
    beside: tuple[tuple[AppliedEffect, ...], Whitening] | None = None
    round: Round | None = None
    ended: bool = False
    rivals: tuple[Rivals, ...] = ()
    widths: tuple[float, ...] = ()
    correlation: Array | None = None
    residual: Residual | None = None
    free_form: FreeForm | None = None
    plain: Mapping[Candidate, float] = field(default_factory=dict)
    lateness: Lateness | None = None
    as_it_is: Problem | None = None

    @property
    def none(self) -> Scored:
        """The model without effects."""
        return self.scores[frozenset()]

    def screening_setting(self) -> Setting:
        """Return the setting with only the recordings of a screening."""
        return self.setting.restricted_to(self.screened)

    def noted(self, **row: object) -> State:
        """Return the state with one more row in its trail."""
        return replace(self, trail=(*self.trail, row))

    def score(self, fits: Sequence[Fit]) -> tuple[State, list[Scored]]:
        """Return a state that contains the fits, and those that are finite, scored."""
        scored, scores = self.setting.score(fits), dict(self.scores)
        for one in scored:
            known = scores.get(one.names)
            if known is None or known.fit.cost > one.fit.cost:
                scores[one.names] = one
        return replace(self, scores=scores), scored

    def fit(
        self, starts: Sequence[Sequence[AppliedEffect]], steps: int = 6
    ) -> tuple[State, list[Scored]]:
        """Return a state that contains the fits from these starts, and these, scored.

        Args:
            starts: Effects with their initial parameters.
            steps: Maximum number of steps of each fit.

        Returns:
            The state, and the best of each set of effects, the best first.
        """
        setting = self.setting
        state, scored = self.score(
            fit(setting.library, starts, setting.whiten, steps=steps)
        )
        best: dict[frozenset[Candidate], Scored] = {}
        for one in scored:
            if one.names not in best or best[one.names].fit.cost > one.fit.cost:
                best[one.names] = one
        return state, sorted(best.values(), key=lambda one: one.fit.cost)
