"""Explanations of a servo on its bench, each judged where it was not fitted.

Every explanation is the servo's own numbers and some effects. It is fitted to all
groups of recordings but one (a gain of the firmware, for instance) and judged on that
one, in turn, as BAM judges its models: by the mean absolute error of the position, of
which the mean over the groups is taken (arXiv 2410.08650).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from rlco.errors import DataError
from rlco.gap.compare.problem import Candidate, Hypothesis
from rlco.gap.compare.servo.bench import ServoBench
from rlco.gap.compare.servo.plant import OWN, SERVO_NUMBERS, servo_numbers
from rlco.gap.logs.log import Array, Log
from rlco.gap.search.fit import Fit, Library, fit, library_of
from rlco.gap.servo_models import JOINT
from rlco.physics.effects import AppliedEffect

Effects = tuple[AppliedEffect, ...]
# The servo's own six numbers stand for these.
COVERED = ("viscous_damping", "armature", "coulomb_friction", "joint_offset")
# The servo's own numbers that fits start from: as published, and with less friction.
STARTS = ((0.0, 0.0, 0.0, 0.0, 0.0, -0.02), (0.0, 0.0, -0.5, 0.5, 0.5, -0.02))
LIKELY = 5  # effects that are judged in each place
SCREENING_STEPS = 12  # a limit of torque takes more than a few
STEPS = 20
# Of many starts all go a short way, so many steps, and so many that fit best go on.
HEATS = ((1, 30), (4, 3))
GROUPS = 4  # at most, where recordings differ in nothing that their headers give
_SCALE = 0.03  # [rad], a typical residual: the fit only wants a number near one


@dataclass(frozen=True)
class Group:
    """Recordings that are held out together.

    Attributes:
        label: What they share, for reports.
        heldout: Their indices.
        train: Those of all others.
    """

    label: str
    heldout: tuple[int, ...]
    train: tuple[int, ...]


@dataclass(frozen=True)
class Judged:
    """An explanation, judged on each group of recordings that was not fitted.

    Attributes:
        effects: What it has beside the servo's own numbers.
        parameters: How many numbers were fitted, the servo's own included.
        errors: Mean absolute error on each held-out group [rad], (groups,).
        residual: Of every recording when its group was held out, (N,) [rad].
        fits: The best numbers with each group held out.
    """

    effects: tuple[Candidate, ...]
    parameters: int
    errors: Array
    residual: Array
    fits: tuple[Effects, ...]

    @property
    def error(self) -> float:
        """Mean over the held-out groups [rad]."""
        return float(self.errors.mean())

    @property
    def rms(self) -> float:
        """Root of the mean square of the residual [rad]."""
        return math.sqrt(float(np.mean(self.residual**2)))


@dataclass(frozen=True)
class Ladder:
    """What explanations are made of, and how they are judged.

    Attributes:
        problem: The servo and its recordings.
        library: What may be hypothesised, the servo's own numbers among it.
        candidates: The effects that may stand beside these.
        groups: Recordings that are held out together.
    """

    problem: ServoBench
    library: Library
    candidates: tuple[Candidate, ...]
    groups: tuple[Group, ...]


def ladder_of(problem: ServoBench, exclude: Collection[str] = ()) -> Ladder:
    """Return the ladder of a bench.

    Args:
        problem: The servo and its recordings.
        exclude: Names of effects that are not considered.

    Raises:
        DataError: There is but one recording.
    """
    effects = library_of(problem, exclude)
    own = Candidate(SERVO_NUMBERS, JOINT)
    candidates = tuple(one for one in effects if one.name not in COVERED)
    library = {**effects, own: servo_numbers()}
    return Ladder(problem, library, candidates, groups_of(problem.log))


def groups_of(log: Log) -> tuple[Group, ...]:
    """Return what is held out together: gains, pendulums, voltages, or some recordings.

    The first of these in which recordings differ: an explanation that carries over to
    another gain says more than one that carries over to another run of the same.

    Raises:
        DataError: There is but one recording.
    """
    every = range(len(log.recordings))
    facts = [recording.facts for recording in log.recordings]
    for kinds in (("kp",), ("mass", "length"), ("vin",)):
        labels = [" ".join(f"{k} {f[k]:g}" for k in kinds) for f in facts]
        if len(set(labels)) > 1:
            break
    else:
        if len(every) < 2:
            raise DataError(
                "the log holds one recording of the servo: an explanation is judged on "
                "recordings that it was not fitted to, so record at least two, best "
                "with several gains of the firmware."
            )
        count = min(GROUPS, len(every))
        labels = [f"part {i % count + 1} of {count}" for i in every]
    return tuple(
        Group(
            label,
            tuple(i for i in every if labels[i] == label),
            tuple(i for i in every if labels[i] != label),
        )
        for label in sorted(set(labels), key=_as_counted)
    )


def _as_counted(label: str) -> list[tuple[float, str]]:
    """Return a key that sorts the numbers in labels as numbers."""
    words = label.split()
    return [
        (float(word), "") if word.replace(".", "").isdigit() else (0.0, word)
        for word in words
    ]


def without_own_numbers(effects: Effects) -> Effects:
    """Return effects without the servo's own numbers."""
    return tuple(one for one in effects if one.name != SERVO_NUMBERS)


def alone(ladder: Ladder) -> Judged:
    """Fit the servo's own numbers, each group held out in turn."""
    return _judge(ladder, None, ())


def judge(ladder: Ladder, base: Judged, added: Candidate) -> Judged:
    """Fit an explanation with one more effect, each group held out in turn."""
    return _judge(ladder, base, (added,))


def likely(ladder: Ladder, base: Judged) -> tuple[Candidate, ...]:
    """Return the effects that fit all recordings best beside an explanation."""
    left = [one for one in ladder.candidates if one not in base.effects]
    every = range(len(ladder.problem.log.recordings))
    costs = [
        _fit(ladder, base.fits[:1], (one,), every, SCREENING_STEPS).cost for one in left
    ]
    return tuple(left[i] for i in np.argsort(costs)[:LIKELY])


def fit_all(ladder: Ladder, judged: Judged) -> Fit:
    """Return an explanation as it fits all recordings best."""
    every = range(len(ladder.problem.log.recordings))
    return _fit(ladder, judged.fits, (), every, STEPS)


def _judge(ladder: Ladder, base: Judged | None, added: tuple[Candidate, ...]) -> Judged:
    problem = ladder.problem
    residual, errors, fits = np.zeros(len(problem.layout.time)), [], []
    for index, group in enumerate(ladder.groups):
        begin = _own_starts()
        if base:
            # What fits best alone need not lie near what fits best with another.
            others = _starts(ladder.library, begin[:1], base.effects)
            begin = [base.fits[index], *others]
        best = _fit(ladder, begin, added, group.train, STEPS).effects
        rows = problem.residuals([Hypothesis(best)], group.heldout)[0]
        residual[np.isin(problem.layout.recording, group.heldout)] = rows
        errors.append(float(np.abs(rows).mean()))
        fits.append(best)
    effects = (*(base.effects if base else ()), *added)
    numbers = [parameter for one in effects for parameter in ladder.library[one]]
    count = len(servo_numbers()) + len(numbers)
    return Judged(effects, count, np.array(errors), residual, tuple(fits))


def _fit(
    ladder: Ladder,
    begin: Sequence[Effects],
    added: tuple[Candidate, ...],
    train: Sequence[int],
    steps: int,
) -> Fit:
    """Return the best fit, from each beginning and each start of what is added."""

    def scaled(lists: Sequence[Effects]) -> Array:
        hypotheses = [Hypothesis(tuple(one)) for one in lists]
        return ladder.problem.residuals(hypotheses, train) / _SCALE

    starts = _starts(ladder.library, begin, added)
    for short, most in HEATS:
        if len(starts) > most:
            tried = fit(ladder.library, starts, scaled, steps=short)
            tried.sort(key=lambda one: one.cost)
            starts = [one.effects for one in tried[:most]]
    fits = fit(ladder.library, starts, scaled, steps=steps)
    return min(fits, key=lambda one: one.cost)


def _starts(
    library: Library, begin: Sequence[Effects], added: Sequence[Candidate]
) -> list[Effects]:
    starts = list(begin)
    for one in added:
        first, *others = library[one]
        rest = {p.name: p.starts[0] for p in others}
        starts = [
            (*start, AppliedEffect(one.name, one.target, {first.name: v, **rest}))
            for start in starts
            for v in first.starts
        ]
    return starts


def _own_starts() -> list[Effects]:
    names = (*OWN, "zero")
    return [
        (AppliedEffect(SERVO_NUMBERS, JOINT, dict(zip(names, n, strict=True))),)
        for n in STARTS
    ]
