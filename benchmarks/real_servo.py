"""A real XL330 servo on BAM's pendulum: which effects hold on a gain never seen.

Every class is fitted to the runs of three of the four firmware gains and judged on the
fourth, as BAM is judged: mean absolute error of the position, mean over the four.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import real_data

from rlco.gap.comparison import DOUBT, block_test
from rlco.gap.fit import Fit, Library, fit, library_of
from rlco.gap.log import Array
from rlco.gap.problem import Candidate, Hypothesis
from rlco.gap.servo_bench import ServoBench
from rlco.gap.servo_plant import OWN, SERVO_NUMBERS, servo_numbers
from rlco.gap.servo_witness import supply_sag
from rlco.physics.effects import AppliedEffect

# The servo's own six numbers stand for these.
COVERED = ("viscous_damping", "armature", "coulomb_friction", "joint_offset")
DRIVE_SIDE = ("drive_loss", "actuator_gain", "torque_limit")
# The servo's own numbers that fits start from: as published, and with less friction.
STARTS = ((0.0, 0.0, 0.0, 0.0, 0.0, -0.02), (0.0, 0.0, -0.5, 0.5, 0.5, -0.02))
LIKELY = 5  # effects that are judged in each place
STEPS = 12  # of the fits that tell which: a limit of torque takes more than a few
SCALE = 0.03  # [rad], a typical residual: the fit only wants a number near one


@dataclass(frozen=True)
class Judged:
    """A class of effects, judged on each gain that was not fitted.

    Attributes:
        effects: What it has beside the servo's own numbers.
        parameters: How many numbers were fitted, the servo's own included.
        errors: Mean absolute error on each held-out gain [mrad], (gains,).
        residual: Of every run when its gain was held out, (N,) [rad].
        fits: The best numbers with each gain held out.
    """

    effects: tuple[Candidate, ...]
    parameters: int
    errors: Array
    residual: Array
    fits: tuple[tuple[AppliedEffect, ...], ...]

    @property
    def error(self) -> float:
        """Mean over the held-out gains [mrad]."""
        return float(self.errors.mean())

    def __str__(self) -> str:
        names = "+".join(("own numbers", *(one.name for one in self.effects)))
        folds = " ".join(f"{error:.1f}" for error in self.errors)
        return f"{names}: {self.error:.1f} ({folds}; {self.parameters} parameters)"


class Ladder:
    """Effects added one by one to a servo whose own numbers are always fitted."""

    def __init__(self, problem: ServoBench) -> None:
        self.problem = problem
        self.joint = problem.model.joint(0).name
        self.own = Candidate(SERVO_NUMBERS, self.joint)
        self.library: Library = {**library_of(problem), self.own: servo_numbers()}
        self.gains = np.array([r.facts["kp"] for r in problem.log.recordings])
        self.candidates = [
            one for one in library_of(problem) if one.name not in COVERED
        ]

    def judge(self, base: Judged, added: Sequence[Candidate]) -> list[Judged]:
        """Fit the base with each effect beside it, each gain held out in turn.

        Args:
            base: Whose numbers the fits start from.
            added: Effects to add, one at a time.
        """
        return [self._judge(base, (one,)) for one in added]

    def alone(self) -> Judged:
        """Fit the servo's own numbers, each gain held out in turn."""
        return self._judge(None, ())

    def likely(self, base: Judged) -> list[Candidate]:
        """Return the effects that tell most beside a base, all gains fitted."""
        left = [one for one in self.candidates if one not in base.effects]
        every = range(len(self.gains))
        costs = [self._fit(base.fits[:1], (one,), every, STEPS).cost for one in left]
        return [left[i] for i in np.argsort(costs)[:LIKELY]]

    def _judge(self, base: Judged | None, added: tuple[Candidate, ...]) -> Judged:
        layout = self.problem.layout
        residual, errors, fits = np.zeros(len(layout.time)), [], []
        for fold, gain in enumerate(np.unique(self.gains)):
            train = np.flatnonzero(self.gains != gain).tolist()
            held = np.flatnonzero(self.gains == gain).tolist()
            begin = self._begin()
            if base:
                # What fits best alone need not lie near what fits best with another.
                begin = [base.fits[fold], *self._starts(begin[:1], base.effects)]
            best = self._fit(begin, added, train, 20).effects
            rows = self.problem.residuals([Hypothesis(best)], held)[0]
            residual[np.isin(layout.recording, held)] = rows
            errors.append(1e3 * float(np.abs(rows).mean()))
            fits.append(best)
        effects = (*(base.effects if base else ()), *added)
        count = sum(len(self.library[one]) for one in (self.own, *effects))
        return Judged(effects, count, np.array(errors), residual, tuple(fits))

    def _fit(
        self,
        begin: Sequence[tuple[AppliedEffect, ...]],
        added: tuple[Candidate, ...],
        train: Sequence[int],
        steps: int,
    ) -> Fit:
        """Return the best fit, from each beginning and each start of what is added."""

        def weigh(lists: Sequence[tuple[AppliedEffect, ...]]) -> Array:
            hypotheses = [Hypothesis(tuple(one)) for one in lists]
            return self.problem.residuals(hypotheses, train) / SCALE

        starts = self._starts(begin, added)
        fits = fit(self.library, starts, weigh, steps=steps)
        return min(fits, key=lambda one: one.cost)

    def _starts(
        self,
        begin: Sequence[tuple[AppliedEffect, ...]],
        added: tuple[Candidate, ...],
    ) -> list[tuple[AppliedEffect, ...]]:
        starts = list(begin)
        for one in added:
            first, *others = self.library[one]
            rest = {p.name: p.starts[0] for p in others}
            starts = [
                (*start, AppliedEffect(one.name, one.target, {first.name: v, **rest}))
                for start in starts
                for v in first.starts
            ]
        return starts

    def _begin(self) -> list[tuple[AppliedEffect, ...]]:
        names = (*OWN, "zero")
        return [
            (
                AppliedEffect(
                    SERVO_NUMBERS, self.joint, dict(zip(names, n, strict=True))
                ),
            )
            for n in STARTS
        ]

    def class_of(self, best: Judged, others: Sequence[Judged]) -> str:
        """Return which others the runs cannot tell from the best."""
        runs = self.problem.layout.recording
        names = [
            f"{one.effects[-1].name} ({one.error / best.error - 1.0:+.0%})"
            for one in others
            if set(one.effects) != set(best.effects)
            and block_test(best.residual, one.residual, runs) < DOUBT
        ]
        return ", ".join(names) or "none"


def rows() -> list[real_data.Row]:
    """Measure, and return the rows of the table."""
    spec, log = real_data.servo()
    problem = ServoBench(spec, log)
    ladder = Ladder(problem)
    none = ladder.alone()
    singles = _sorted(ladder.judge(none, ladder.likely(none)))
    pairs = _sorted(ladder.judge(singles[0], ladder.likely(singles[0])))
    best = pairs[0]
    # Others in the place of each of the two: who does as well, as far as runs can tell?
    (second,) = ladder.judge(none, best.effects[1:])
    firsts = _sorted(ladder.judge(second, ladder.likely(second)))
    thirds = _sorted(ladder.judge(best, ladder.likely(best)))
    drive = [one for one in firsts if one.effects[-1].name in DRIVE_SIDE]
    loss = next(one for one in drive if "drive_loss" in str(one))
    witness = supply_sag(problem, Hypothesis(loss.fits[-1]))
    return [
        ("servo's own numbers", str(none), "-", "BAM's m1: 68.7"),
        ("best single effects", _said(singles[:2]), "-", "m3: 56.3"),
        ("best pair", str(best), "<= 38, <= 9 parameters", "36.6; BAM's best 54.4"),
        ("best with a third", str(thirds[0]), "-", "-"),
        (
            f"as good as {best.effects[0].name}",
            ladder.class_of(best, firsts),
            "drive_loss, actuator_gain, torque_limit are one class",
            "within 20 %",
        ),
        (
            f"as good as {best.effects[1].name}",
            ladder.class_of(best, pairs),
            "load_friction alone",
            "-",
        ),
        ("drive-side effects", _said(drive), "one class", "36.6 38.9 44.2"),
        ("witness", str(witness), "contradicted", "2.1 V needed, 0.15 measured"),
    ]


def _sorted(some: Sequence[Judged]) -> list[Judged]:
    return sorted(some, key=lambda one: one.error)


def _said(some: Sequence[Judged]) -> str:
    return "; ".join(map(str, some))
