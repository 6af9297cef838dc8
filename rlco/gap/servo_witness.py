"""A second channel that may rule an explanation out: the supply's measured voltage.

A drive that loses torque where much is asked for may have a supply that sags. Then its
voltage, where it was logged, must fall by as much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rlco.errors import DataError
from rlco.gap.problem import Hypothesis
from rlco.gap.servo_bench import ServoBench

_SATURATED, _IDLE = 0.95, 0.3  # duty


@dataclass(frozen=True)
class SupplySag:
    """What a sagging supply would have to do, and what it did.

    Attributes:
        needed: Fall of the voltage at full duty that explains the lost torque [V].
        measured: By how much it is lower at full duty than at little [V].
    """

    needed: float
    measured: float

    @property
    def contradicted(self) -> bool:
        """Whether the supply does not fall even half as far as it would have to."""
        return self.measured < 0.5 * self.needed

    def __str__(self) -> str:
        verb = "contradict" if self.contradicted else "bear out"
        return (
            f"the measured volts {verb} a sagging supply: at full duty they fall by "
            f"{self.measured:.2f} V, the lost torque needs {self.needed:.2f} V"
        )


def supply_sag(problem: ServoBench, hypothesis: Hypothesis) -> SupplySag:
    """Compare the torque that a hypothesis loses with the measured supply.

    Args:
        problem: Its recordings hold ``input_volts`` and, among their facts, ``vin``.
        hypothesis: With a `drive_loss`.

    Raises:
        DataError: If no recording has volts both at full and at little duty.
    """
    plant = problem.plant(hypothesis)
    needed, full, little = [], [], []
    for index, recording in enumerate(problem.log.recordings):
        volts, supply = recording.extra.get("input_volts"), recording.facts.get("vin")
        if volts is None or supply is None:
            continue
        traces = problem.traces(hypothesis, index)
        duty, speed = traces["duty"][:, 0], traces["velocity"][:, 0]
        hard = np.abs(duty) > _SATURATED
        asked = np.abs(duty * plant.stall - plant.back_emf * speed)[hard]
        lost = asked - asked / (1.0 + plant.loss * asked)
        # Torque goes with the voltage: duty * stall of it at the nominal one.
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
