"""What a calibration leaves open: in which directions a model may still change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from rlco.gap.calibrate.fit import Calibration
from rlco.gap.calibrate.numbers import Number, effects_of
from rlco.gap.logs.log import Array
from rlco.gap.search.whitening import often
from rlco.physics.effects import AppliedEffect

#: The tolerance of a search in such a problem: one standard deviation of a direction.
SPREAD = 0.03
_LEAST = 1e-9  # variance of a direction, in priors, that is left out
_WORDS = "what the calibration leaves open"


@dataclass(frozen=True)
class Remaining:
    """A `Calibrated`: a calibration, and the directions of its covariance.

    Attributes:
        nominal: The model without the calibration.
        names: One for each direction.
        words: What they are.
        model: `nominal`, compiled.
        numbers: The calibrated numbers, N of them.
        amounts: As fitted, (N,).
        directions: One standard deviation of each direction, (directions, N).
    """

    nominal: mujoco.MjSpec
    names: tuple[str, ...]
    words: str
    model: mujoco.MjModel
    numbers: tuple[Number, ...]
    amounts: Array
    directions: Array

    @classmethod
    def of(cls, calibration: Calibration, nominal: mujoco.MjSpec) -> Remaining:
        """Return a calibration with what its recordings leave open, for others."""
        return cls._along(calibration, nominal, calibration.covariance_per_row())

    @classmethod
    def of_prior(cls, calibration: Calibration, nominal: mujoco.MjSpec) -> Remaining:
        """Return a calibration with what its priors allow, for the same recordings."""
        basis = calibration.basis
        allowed = basis @ basis.T / often(calibration.rows)
        return cls._along(calibration, nominal, allowed)

    @classmethod
    def _along(
        cls, calibration: Calibration, nominal: mujoco.MjSpec, covariance: Array
    ) -> Remaining:
        sizes, vectors = np.linalg.eigh(covariance)
        kept = sizes > _LEAST
        directions = (vectors[:, kept] * np.sqrt(sizes[kept])).T
        names = tuple(f"calibration:direction {i + 1}" for i in range(len(directions)))
        return cls(
            nominal,
            names,
            _WORDS,
            nominal.copy().compile(),
            calibration.numbers,
            calibration.amounts,
            directions,
        )

    def effects(self, parts: Sequence[float] = ()) -> tuple[AppliedEffect, ...]:
        """Return the calibration, changed by an amount of each direction.

        Args:
            parts: `SPREAD` for one standard deviation, (directions,); empty for none.
        """
        amounts = self.amounts
        if len(parts):
            # Not relative to the calibrated link: what moves nothing there is another
            # direction.
            amounts = amounts + np.asarray(parts) @ self.directions / SPREAD
        return effects_of(self.model, self.numbers, amounts)
