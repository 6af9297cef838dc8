"""Interface between a robot's log and the search: hypotheses in, residuals out.

The compared quantity may be joint positions after rollouts, torques from inverse
dynamics, a tossed body's pose or a task's own actions. The search for effects, the
verdict, the intervals and the report are the same for all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.gap.logs.log import Array, Log
from rlco.physics.effects import AppliedEffect

Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Hypothesis:
    """Effects that act together, and small changes of the model's own parameters.

    Attributes:
        effects: The effects, each with its parameters.
        spread: Model tolerance: relative change of each of the problem's
            `tolerance_names`; empty for no change. (spread,)
    """

    effects: tuple[AppliedEffect, ...] = ()
    spread: tuple[float, ...] = ()


@dataclass(frozen=True)
class Candidate:
    """An effect at a target that may be part of a hypothesis."""

    name: str
    target: str | None


@dataclass(frozen=True)
class Layout:
    """Recording, time and channel of each residual, N of them in all.

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


@dataclass(frozen=True)
class Run:
    """One rollout: its initial state and its actuator commands.

    Attributes:
        recording: Index of its recording.
        time: When it starts, on the recording's clock [s].
        model: The model that is stepped.
        qpos: Positions at the start, (nq,).
        qvel: Velocities at the start, (nv,).
        commands: One row per physics step, (steps, nu).
    """

    recording: int
    time: float
    model: mujoco.MjModel
    qpos: Array
    qvel: Array
    commands: Array


@dataclass(frozen=True)
class Divergence:
    """Where and when the simulation of one recording diverges.

    Attributes:
        recording: Index of the recording.
        name: Its name.
        time: When, on the recording's clock [s].
        joint: The joint that diverged first, None where that is not known.
        body: The body that it moves.
        touching: Pairs of bodies that touched just before.
    """

    recording: int
    name: str
    time: float
    joint: str | None = None
    body: str | None = None
    touching: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Instability:
    """A model whose simulation diverges without any effect.

    Attributes:
        divergences: One for each recording that diverges.
        bounded: Whether the state swings to and fro at each step instead of
            diverging, bounded only by the limits of its servos.
        changed: The parameter in `Problem.tolerance_names` that makes the simulation
            diverge when it is one per cent larger; None where it diverges unchanged.
        timestep: The largest time step tried at which the first of them does not
            diverge [s], None for none.
        implicit: Whether it stays stable at the model's time step with the integrator
            ``implicitfast``.
        advice: What to check, one sentence each.
    """

    divergences: tuple[Divergence, ...]
    bounded: bool = False
    changed: str | None = None
    timestep: float | None = None
    implicit: bool = False
    advice: tuple[str, ...] = ()


class Calibrated(Protocol):
    """A calibration, and what it leaves open in place of a tolerance."""

    @property
    def nominal(self) -> mujoco.MjSpec:
        """The model without it."""
        ...

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the directions in which its numbers may still change."""
        ...

    @property
    def words(self) -> str:
        """The same in words, after "what the noise and"."""
        ...

    def effects(self, parts: Sequence[float] = ()) -> tuple[AppliedEffect, ...]:
        """Return the calibration as effects, changed by an amount of each direction."""
        ...


class Problem(Protocol):
    """A robot's model and log, and the comparison of simulation with measurement.

    Subclass it, or implement its members; `has_outliers`, `calibration`,
    `noise_was_observed`, `inexact`, `usual_sizes`, `by_guesses` and `runs` have
    defaults.
    """

    model: mujoco.MjModel
    log: Log
    layout: Layout
    # Standard deviation of the measurement noise of each channel, (channels,).
    noise: Array
    # Parameters with a tolerance: one name for each number of `Hypothesis.spread`.
    tolerance_names: tuple[str, ...]
    # Whether some seconds may be wrong under any hypothesis: outliers.
    has_outliers: bool = False
    # Calibration of the model; None where each number may be a few per cent off.
    calibration: Calibrated | None = None
    # Whether `noise` is what the model was observed to leave in earlier recordings, so
    # that each channel's is known by itself.
    noise_was_observed: bool = False
    # Part of the mean square of an effect that the comparison itself may get wrong,
    # where `noise_was_observed`: less beside this effect is no further one.
    inexact: float = 0.0

    def candidates(self) -> list[Candidate]:
        """Return each effect at each target that this comparison can reveal."""
        ...

    def usual_sizes(self) -> Mapping[Candidate, tuple[float, ...]]:
        """Return initial values of first parameters that the log suggests."""
        return {}

    def residuals(
        self, hypotheses: Sequence[Hypothesis], recordings: Sequence[int] | None = None
    ) -> Array:
        """Return measured minus simulated under each hypothesis, (hypotheses, N).

        Rows of a simulation that diverged are infinite. With `recordings`, only their
        residuals are returned, in the order of the layout.
        """
        ...

    def by_guesses(self, hypothesis: Hypothesis) -> Array:
        """Return changes of the residuals by what of the log is guessed, (K, N).

        Each for one standard deviation of a guess; none where nothing is guessed.
        """
        return np.zeros((0, len(self.layout.recording)))

    def runs(self, hypothesis: Hypothesis, recordings: Sequence[int]) -> Sequence[Run]:
        """Return the rollouts of some recordings, to locate a divergence.

        Empty where a comparison has no plain rollouts.
        """
        return ()

    def traces(self, hypothesis: Hypothesis, recording: int) -> Mapping[str, Array]:
        """Return signals of one recording for regimes and figures.

        Keys: ``time`` (T,), ``measured`` and ``simulated`` (T, channels), and where
        available ``velocity``, ``acceleration``, ``command``, ``torque``, ``duty`` (the
        fraction of its voltage that a drive is given), (T, channels), and ``contact``
        (T,), true where something touches.
        """
        ...


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
