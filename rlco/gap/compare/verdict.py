"""What a search says of a robot and its log: named effects, and what they leave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from rlco.gap.compare.problem import Candidate, Hypothesis, Instability
from rlco.gap.logs.log import Array


@dataclass(frozen=True)
class Value:
    """A value with its 90 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class NamedEffect:
    """A named effect, its parameters, and the effects it cannot be distinguished from.

    Attributes:
        name: The effect.
        target: Joint, body, geom or None.
        parameters: Its parameters by name.
        rivals: Other effects of its class that this data cannot distinguish from it.
        evidence: By how much each rival is worse on held-out data, by
            ``name target``: 0.03 is three per cent.
        calibrated: Whether a calibration found it beyond what is usual, and no search.
    """

    name: str
    target: str | None
    parameters: Mapping[str, Value]
    rivals: tuple[Candidate, ...] = ()
    evidence: Mapping[str, float] = field(default_factory=dict)
    calibrated: bool = False


@dataclass(frozen=True)
class Gap:
    """Root mean square disagreement [unit], in training and held-out recordings."""

    unit: str
    before_train: float
    before_heldout: float
    after_train: float
    after_heldout: float
    noise_floor: float


@dataclass(frozen=True)
class HeldOutGroup:
    """Recordings that were judged together, by fits that did not use them.

    Attributes:
        label: What they share.
        recordings: Their indices.
        nominal: Mean absolute error of the model as it is, in the unit of the gap.
        before: The same with the model's own numbers fitted to all other recordings.
        after: The same with the named effects beside them; `before` where none is.
        hypothesis_before: What `before` is of.
        hypothesis_after: What `after` is of.
    """

    label: str
    recordings: tuple[int, ...]
    nominal: float
    before: float
    after: float
    hypothesis_before: Hypothesis
    hypothesis_after: Hypothesis


@dataclass(frozen=True)
class HeldOut:
    """Recordings that were held out in turn, a group at a time.

    Attributes:
        unit: Of the errors.
        numbers_before: How many numbers were fitted without effects.
        numbers_after: How many with the named ones.
        groups: The groups; each recording is in one of them.
    """

    unit: str
    numbers_before: int
    numbers_after: int
    groups: tuple[HeldOutGroup, ...]

    @property
    def nominal(self) -> float:
        """Mean over the groups, of the model as it is."""
        return float(np.mean([group.nominal for group in self.groups]))

    @property
    def before(self) -> float:
        """Mean over the groups, with the model's own numbers fitted."""
        return float(np.mean([group.before for group in self.groups]))

    @property
    def after(self) -> float:
        """Mean over the groups, with the named effects beside them."""
        return float(np.mean([group.after for group in self.groups]))

    def hypotheses(self) -> tuple[list[Hypothesis], list[Hypothesis]]:
        """Return what each recording was judged with, before and after."""
        of = {index: group for group in self.groups for index in group.recordings}
        groups = [of[index] for index in sorted(of)]
        before = [group.hypothesis_before for group in groups]
        return before, [group.hypothesis_after for group in groups]


@dataclass(frozen=True)
class FreeForm:
    """A torque or encoder's error outside the library, clearly better than the names.

    Attributes:
        target: The joint that it acts on.
        gain: By how much less of the held-out error it leaves: 0.3 is 30 per cent.
        over_position: Positions [rad or m] and torques [N m or N], (2, P).
        over_velocity: Velocities [rad/s or m/s] and torques, (2, V).
        over_time: Times, recordings one after the other [s], and torques, (2, T).
        predicts: Whether it was fitted to the training recordings alone. Otherwise it
            takes any course over time, and was estimated in those held out, too.
        of_encoder: Whether it is an error of the joint's encoder [rad or m], instead of
            a torque, over its position alone.
    """

    target: str
    gain: float
    over_position: Array
    over_velocity: Array
    over_time: Array
    predicts: bool = True
    of_encoder: bool = False


@dataclass(frozen=True)
class Verdict:
    """The result of a search.

    Attributes:
        complete: False where the search was interrupted.
        verdict: ``no_gap``, ``no_improvement``, ``named``, ``ambiguous``,
            ``unexplained``, ``not_identifiable`` or ``unstable_model``; between two
            recordings of one robot ``no_change``.
        effects: The named effects, the most informative first.
        gap: The disagreement before and after.
        unexplained: Share of the held-out gap that remains, the channel with most of
            it, and a note: ``{"share", "target", "note"}``.
        closest: The best candidates where none is named, with the share that each
            would explain.
        seconds: Duration of the search [s].
        hypothesis: The named effects with their fitted parameters.
        train: Recordings used for fitting.
        heldout: Recordings held out.
        trail: The steps of the search, one row each, for the report.
        instability: Where the model's simulation diverges; None unless the verdict is
            ``unstable_model``.
        held_out: Where each recording was held out in turn, how each group of them did;
            `train` and `heldout` then are all recordings, and the gap before is with
            the model's own numbers fitted.
        remarks: What else was noticed, one sentence each.
        free_form: A torque of free form that does clearly better than the named
            effects; None where there is none.
        sample: Values of all parameters of `effects`, in their order: parameter sets
            that are about as believable as the fitted one, (sets, parameters). None
            where nothing is named, or a comparison has no joint intervals.
        since_reference: Whether it is of what changed since earlier recordings, and the
            noise is what these leave unknown.
        calibrated: Whether it is of what the model lacks that was calibrated to these
            recordings; the gap before is then that of the calibrated one.
    """

    complete: bool
    verdict: str
    effects: tuple[NamedEffect, ...]
    gap: Gap
    unexplained: Mapping[str, object]
    closest: tuple[tuple[Candidate, float], ...]
    seconds: float
    hypothesis: Hypothesis
    train: tuple[int, ...]
    heldout: tuple[int, ...]
    trail: tuple[Mapping[str, object], ...] = ()
    instability: Instability | None = None
    held_out: HeldOut | None = None
    remarks: tuple[str, ...] = ()
    free_form: FreeForm | None = None
    sample: Array | None = None
    since_reference: bool = False
    calibrated: bool = False
