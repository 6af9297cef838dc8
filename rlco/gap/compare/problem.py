"""Interface between a robot's log and the search: hypotheses in, residuals out.

The compared quantity may be joint positions after rollouts, torques from inverse
dynamics, a tossed body's pose or a task's own actions. The search for effects, the
verdict, the intervals and the report are the same for all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
    `noise_was_observed`, `inexact`, `usual_sizes`, `by_guesses`, `runs` and
    `weighted_base` have defaults.
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

    def weighted_base(self) -> tuple[Problem, Array]:
        """Return the plain comparison that this one is of, and its rows' weights, (N,).

        One that is of no other is its own, all rows alike.
        """
        return self, np.ones(len(self.layout.recording))

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
