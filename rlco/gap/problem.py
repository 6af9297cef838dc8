"""What a search needs of a robot, a log and a way to compare them.

A problem turns hypotheses into residuals. Whatever is compared (joint positions after
rollouts, torques by inverse dynamics, a tossed body's pose, a task's own actions), the
search for effects, the verdict, the intervals and the report are the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.gap.log import Array, Log
from rlco.physics.effects import AppliedEffect

Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Hypothesis:
    """Effects that act at once, and small changes of what the model has already.

    Attributes:
        effects: The effects, each with its numbers.
        spread: By how much each of the problem's `spread_names` differs from the
            model, as a part of its value; empty for not at all. (spread,)
    """

    effects: tuple[AppliedEffect, ...] = ()
    spread: tuple[float, ...] = ()


@dataclass(frozen=True)
class Candidate:
    """An effect at a target that may be hypothesised."""

    name: str
    target: str | None


@dataclass(frozen=True)
class Layout:
    """What each residual is of, N of them in all.

    Attributes:
        recording: Index of its recording, (N,).
        time: Time in it [s], (N,).
        channel: Index of its channel, (N,).
        channels: Names of the channels: joints, or ``x``, ``y``, ``z``.
        units: Unit of each channel.
    """

    recording: Integers
    time: Array
    channel: Integers
    channels: tuple[str, ...]
    units: tuple[str, ...]


class Problem(Protocol):
    """A robot's model and log, and how simulation and measurement are compared.

    Subclass it, or have what it has: `has_outliers` and `usual_sizes` have defaults.
    """

    model: mujoco.MjModel
    log: Log
    layout: Layout
    # Standard deviation of the measurement itself, a channel, (channels,).
    noise: Array
    # What may be a little off everywhere: one name a number of `Hypothesis.spread`.
    spread_names: tuple[str, ...]
    # Whether some seconds may be wrong whatever is hypothesised (`rlco.gap.outliers`).
    has_outliers: bool = False

    def candidates(self) -> list[Candidate]:
        """Return each effect at each target that this comparison can show."""
        ...

    def usual_sizes(self) -> Mapping[Candidate, tuple[float, ...]]:
        """Return starts of first numbers, where the log tells more than the model."""
        return {}

    def residuals(
        self, hypotheses: Sequence[Hypothesis], recordings: Sequence[int] | None = None
    ) -> Array:
        """Return measured minus simulated under each hypothesis, (hypotheses, N).

        Rows of a simulation that diverged are infinite. With `recordings`, only the
        residuals of those, in the order of the layout.
        """
        ...

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        """Return signals of one recording for regimes and figures.

        Keys: ``time`` (T,), ``measured`` and ``simulated`` (T, channels), and where
        they exist ``velocity``, ``acceleration``, ``command``, ``torque`` (T, channels)
        and ``contact`` (T,), true where something touches.
        """
        ...


@dataclass(frozen=True)
class Value:
    """A number with the interval in which it lies nine times of ten."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Finding:
    """A named effect, its numbers, and who else explains the data as well.

    Attributes:
        name: The effect.
        target: Joint, body, geom or None.
        parameters: Its numbers by name.
        rivals: Others of the class that this data cannot tell from it.
        evidence: How much worse each rival does, held out, by ``name target``: 0.03
            is three per cent.
    """

    name: str
    target: str | None
    parameters: Mapping[str, Value]
    rivals: tuple[Candidate, ...] = ()
    evidence: Mapping[str, float] = field(default_factory=dict)


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
class Verdict:
    """What was found.

    Attributes:
        complete: False where the search was interrupted.
        verdict: ``no_gap``, ``no_improvement``, ``named``, ``ambiguous``,
            ``unexplained`` or ``not_identifiable``.
        effects: What was named, the most telling first.
        gap: The disagreement before and after.
        unexplained: Share of the held-out gap that stays, the channel with most of
            it, and a note: ``{"share", "target", "note"}``.
        closest: Candidates that came nearest, where none is named, with the share
            each would explain.
        seconds: How long the search took [s].
        hypothesis: The named effects with their numbers, as fitted.
        train: Recordings that were fitted.
        heldout: Recordings that were not.
        trail: What was tried, one row a step, for the report.
    """

    complete: bool
    verdict: str
    effects: tuple[Finding, ...]
    gap: Gap
    unexplained: Mapping[str, object]
    closest: tuple[tuple[Candidate, float], ...]
    seconds: float
    hypothesis: Hypothesis
    train: tuple[int, ...]
    heldout: tuple[int, ...]
    trail: tuple[Mapping[str, object], ...] = ()
