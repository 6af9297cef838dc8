"""An independent channel that may rule out an explanation: the supply's voltage.

A drive that loses torque under high demand may have a supply that sags. Then its
voltage, where it was logged, must fall accordingly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rlco.errors import DataError
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.servo.bench import ServoBench
from rlco.gap.logs.log import Array
from rlco.physics.effects.step_forces import Laws, law_along

_SATURATED, _IDLE = 0.95, 0.3  # duty


@dataclass(frozen=True)
class SupplySag:
    """The voltage drop that a sagging supply needs, and the measured one.

    Attributes:
        needed: Voltage drop at full duty that explains the lost torque [V].
        measured: Voltage at low duty minus voltage at full duty [V].
    """

    needed: float
    measured: float

    @property
    def contradicted(self) -> bool:
        """Whether the voltage drops by less than half of what is needed."""
        return self.measured < 0.5 * self.needed

    def __str__(self) -> str:
        verb = "contradict" if self.contradicted else "support"
        return (
            f"the measured volts {verb} a sagging supply: at full duty they fall by "
            f"{self.measured:.2f} V, the lost torque needs {self.needed:.2f} V"
        )


def supply_sag(problem: ServoBench, hypothesis: Hypothesis) -> SupplySag:
    """Compare the torque that a hypothesis loses with the measured supply.

    Args:
        problem: Its recordings hold ``input_volts``.
        hypothesis: With a `drive_loss`.

    Raises:
        DataError: If no recording has volts both at full and at little duty.
    """
    needed, full, little = [], [], []
    for index, recording in enumerate(problem.log.recordings):
        volts = recording.extra.get("input_volts")
        if volts is None:
            continue
        pendulum = problem.pendulums[index]
        plant, supply = problem.plant(hypothesis, pendulum), pendulum.volts
        traces = problem.traces(hypothesis, index)
        duty, speed = traces["duty"][:, 0], traces["velocity"][:, 0]
        hard = np.abs(duty) > _SATURATED
        asked = np.abs(duty * plant.stall - plant.back_emf * speed)[hard]
        lost = _lost(plant.forces.torque, asked)
        # Torque is proportional to voltage: duty * stall at the nominal voltage.
        needed.append(supply * lost / (np.abs(duty[hard]) * plant.stall))
        full.append(volts[hard])
        little.append(volts[np.abs(duty) < _IDLE])
    if not full or not len(np.concatenate(full)) or not len(np.concatenate(little)):
        raise DataError(
            "no recording has input_volts both at full and at little duty: log the "
            "supply's voltage while the servo is driven to its limit."
        )
    measured = np.concatenate(little).mean() - np.concatenate(full).mean()
    return SupplySag(float(np.concatenate(needed).mean()), float(measured))


def _lost(laws: Laws, asked: Array) -> Array:
    """Return by how much a drive falls short of the requested torque, (T,) [N m]."""
    still = np.zeros_like(asked)
    lost = np.zeros_like(asked)
    for row in range(len(laws.rows)):
        lost -= law_along(laws, row, still, still, asked, asked)
    return lost
