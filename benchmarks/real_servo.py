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
LIKELY = 4  # effects that are judged in each place
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

    def judge(self, classes: Sequence[tuple[Candidate, ...]]) -> list[Judged]:
        """Fit each class with each gain held out."""
        layout = self.problem.layout
        residual = np.zeros((len(classes), len(layout.time)))
        errors = np.zeros((len(classes), len(np.unique(self.gains))))
        fits: list[list[tuple[AppliedEffect, ...]]] = [[] for _ in classes]
        for fold, gain in enumerate(np.unique(self.gains)):
            train = np.flatnonzero(self.gains != gain).tolist()
            held = np.flatnonzero(self.gains == gain).tolist()
            best = [effects for effects, _ in self._fit(classes, train)]
            rows = self.problem.residuals([Hypothesis(one) for one in best], held)
            residual[:, np.isin(layout.recording, held)] = rows
            errors[:, fold] = 1e3 * np.abs(rows).mean(axis=1)
            for kept, one in zip(fits, best, strict=True):
                kept.append(one)
        return [
            Judged(
                effects,
                sum(len(self.library[one]) for one in (self.own, *effects)),
                errors[i],
                residual[i],
                tuple(fits[i]),
            )
            for i, effects in enumerate(classes)
        ]

    def class_of(self, best: Judged, others: Sequence[Judged]) -> str:
        """Return which others the runs cannot tell from the best."""
        runs = self.problem.layout.recording
        names = [
            f"{one.effects[-1].name} ({one.error / best.error - 1.0:+.0%})"
            for one in others
            if block_test(best.residual, one.residual, runs) < DOUBT
        ]
        return ", ".join(names) or "none"

    def likely(self, base: tuple[Candidate, ...]) -> list[tuple[Candidate, ...]]:
        """Return the base with each of the effects beside it that tell most."""
        classes = [(*base, one) for one in self.candidates if one not in base]
        every = range(len(self.gains))
        fits = self._fit(classes, every, steps=4, begin=STARTS[:1])
        order = np.argsort([cost for _, cost in fits])
        return [classes[i] for i in order[:LIKELY]]

    def _fit(
        self,
        classes: Sequence[tuple[Candidate, ...]],
        train: Sequence[int],
        steps: int = 15,
        begin: Sequence[tuple[float, ...]] = STARTS,
    ) -> list[tuple[tuple[AppliedEffect, ...], float]]:
        """Return the best numbers of each class, and their cost."""

        def weigh(lists: Sequence[tuple[AppliedEffect, ...]]) -> Array:
            hypotheses = [Hypothesis(tuple(one)) for one in lists]
            return self.problem.residuals(hypotheses, train) / SCALE

        starts = [
            (i, one) for i, c in enumerate(classes) for one in self._starts(c, begin)
        ]
        fits = fit(self.library, [one for _, one in starts], weigh, steps=steps)
        best: dict[int, Fit] = {}
        for (i, _), found in zip(starts, fits, strict=True):
            if i not in best or found.cost < best[i].cost:
                best[i] = found
        return [(best[i].effects, best[i].cost) for i in range(len(classes))]

    def _starts(
        self, effects: tuple[Candidate, ...], begin: Sequence[tuple[float, ...]]
    ) -> list[tuple[AppliedEffect, ...]]:
        names = (*OWN, "zero")
        starts = [
            (AppliedEffect(*_key(self.own), dict(zip(names, numbers, strict=True))),)
            for numbers in begin
        ]
        for one in effects:
            first, *others = self.library[one]
            rest = {p.name: p.starts[0] for p in others}
            starts = [
                (*start, AppliedEffect(*_key(one), {first.name: value, **rest}))
                for start in starts
                for value in first.starts
            ]
        return starts


def rows() -> list[real_data.Row]:
    """Measure, and return the rows of the table."""
    spec, log = real_data.servo()
    problem = ServoBench(spec, log)
    ladder = Ladder(problem)
    (none,) = ladder.judge([()])
    singles = sorted(ladder.judge(ladder.likely(())), key=_error)
    pairs = sorted(ladder.judge(ladder.likely(singles[0].effects)), key=_error)
    best = pairs[0]
    # Others in the place of each of the two: who does as well, as far as runs can tell?
    firsts = [
        one for one in ladder.likely(best.effects[1:]) if set(one) != set(best.effects)
    ]
    others = [pairs[1:], sorted(ladder.judge(firsts), key=_error)]
    thirds = sorted(ladder.judge(ladder.likely(best.effects)), key=_error)
    drive = [
        one
        for one in (best, *others[1])
        if {e.name for e in one.effects} & set(DRIVE_SIDE)
    ]
    loss = next(one for one in drive if "drive_loss" in str(one))
    witness = supply_sag(problem, Hypothesis(loss.fits[-1]))
    return [
        ("servo's own numbers", str(none), "-", "BAM's m1: 68.7"),
        ("best single effects", _said(singles[:2]), "-", "m3: 56.3"),
        ("best pair", str(best), "<= 38, <= 9 parameters", "36.6; BAM's best 54.4"),
        ("best with a third", str(thirds[0]), "-", "-"),
        (
            f"as good as {best.effects[0].name}",
            ladder.class_of(best, others[1]),
            "drive_loss, actuator_gain, torque_limit are one class",
            "within 20 %",
        ),
        (
            f"as good as {best.effects[1].name}",
            ladder.class_of(best, others[0]),
            "load_friction alone",
            "-",
        ),
        ("drive-side effects", _said(drive), "one class", "36.6 38.9 44.2"),
        ("witness", str(witness), "contradicted", "2.1 V needed, 0.15 measured"),
    ]


def _error(one: Judged) -> float:
    return one.error


def _said(some: Sequence[Judged]) -> str:
    return "; ".join(map(str, some))


def _key(one: Candidate) -> tuple[str, str | None]:
    return one.name, one.target
