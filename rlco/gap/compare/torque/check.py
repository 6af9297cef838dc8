"""Torques as a check of what positions named."""

from __future__ import annotations

import numpy as np

from rlco.gap.compare.problem import Hypothesis
from rlco.gap.compare.torque.torque_log import TorqueLog
from rlco.gap.compare.verdict import Gap
from rlco.physics.effects import EFFECTS
from rlco.physics.effects.actuator import ACTUATOR_GAIN, TORQUE_BIAS

# Of a drive: what a motion takes is the same, whichever drive gives it.
_DRIVES = (ACTUATOR_GAIN.name, TORQUE_BIAS.name)


def carried_over(hypothesis: Hypothesis) -> Hypothesis:
    """Return those effects that change the torques which a motion takes.

    A command that comes late changes the motion; what that motion takes stays.

    Example:
        >>> from rlco.physics.effects import AppliedEffect
        >>> delay = AppliedEffect("command_delay", None, {"delay": 0.04})
        >>> damping = AppliedEffect("viscous_damping", "elbow", {"damping": 2.0})
        >>> [e.name for e in carried_over(Hypothesis((delay, damping))).effects]
        ['viscous_damping']
    """
    kept = []
    for effect in hypothesis.effects:
        known = EFFECTS[effect.name]
        sent = known.acts_on & {"command", "goal"}
        if "torques" in known.shown_by and not sent and effect.name not in _DRIVES:
            kept.append(effect)
    return Hypothesis(tuple(kept))


def check_gap(problem: TorqueLog, hypothesis: Hypothesis) -> Gap:
    """Return how far torques disagree without and with effects, in all recordings.

    Args:
        problem: The torques.
        hypothesis: Effects, see `carried_over`.
    """
    before, after = (
        float(np.sqrt(np.mean(rows**2)))
        for rows in problem.residuals([Hypothesis(), hypothesis])
    )
    noise = np.asarray(problem.noise)[problem.layout.channel]
    units = set(problem.layout.units)
    unit = units.pop() if len(units) == 1 else "mixed"
    floor = float(np.sqrt(np.mean(noise**2)))
    return Gap(unit, before, before, after, after, floor)
