"""A Unitree G1's right arm, commands and positions at 30 Hz, of a LeRobot data set.

The gains of its controller and the masses that its joints carry are not known. Each
joint is a servo with a constant torque for its weight: what is found holds for the way
from command to position, not for the arm's dynamics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import real_data

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.noise import position_noise
from rlco.gap.compare.problem import Candidate, Hypothesis
from rlco.gap.diagnose.record_next import recommend
from rlco.gap.logs.log import Array
from rlco.gap.search.comparison import DOUBT, block_test
from rlco.gap.search.find_gap import find_gap
from rlco.gap.search.fit import Fit, fit, library_of, with_values
from rlco.physics.effects import AppliedEffect

BANDWIDTH = 60.0  # [rad/s] of the model's servos: a lag of 33 ms
FAMILY = ("command_delay", "actuator_lag", "actuator_gain", "viscous_damping")
EPISODES = 12  # of 20; every third is held out


def rows() -> list[real_data.Row]:
    """Measure, and return the rows of the table."""
    joints = real_data.g1_right_arm()
    table: list[real_data.Row] = []
    most, travel = None, 0.0
    for joint in joints:
        problem = one_joint(joint)
        positions = [np.ptp(np.asarray(r.position)) for r in problem.log.recordings]
        if max(positions) > travel:
            most, travel = problem, float(max(positions))
        said = family(problem)
        table.append((joint, said, "the family, 0.13-0.17 s", "0.13-0.17 s"))
    assert most is not None
    verdict = find_gap(most)
    motions = [f"{one.name}: {one.how}" for one in recommend(most, verdict)]
    return [
        *table,
        (f"search, {most.log.joints[0]}", real_data.said(verdict), "the family", "-"),
        ("record next", " ".join(motions) or "nothing", "a motion", "fast sweep"),
    ]


def one_joint(joint: str) -> ArmRollouts:
    """Return one joint as a servo, with some of its episodes."""
    spec, log = real_data.g1_servo(joint, BANDWIDTH)
    log = replace(log, recordings=log.recordings[:EPISODES])
    # What 30 Hz and single precision can tell; many rows repeat the one before.
    noise = np.maximum(position_noise(log).deviation, 1e-3)
    return ArmRollouts(spec, log, noise)


def family(problem: ArmRollouts) -> str:
    """Fit each of the family beside a weight: who does as well, and how late."""
    library = library_of(problem)
    members = [one for one in library if one.name in FAMILY]
    held = [i for i in range(len(problem.log.recordings)) if i % 3 == 2]
    train = [i for i in range(len(problem.log.recordings)) if i % 3 != 2]

    def weigh(lists: Sequence[tuple[AppliedEffect, ...]]) -> Array:
        hypotheses = [Hypothesis(tuple(one)) for one in lists]
        return problem.residuals(hypotheses, train) / problem.noise[0]

    weight = next(one for one in library if one.name == "torque_bias")
    starts = [
        with_values(library, [one, weight], np.array([first, 0.0]))
        for one in members
        for first in library[one][0].starts
    ]
    best: dict[Candidate, Fit] = {}
    for found in fit(library, starts, weigh, steps=10):
        one = Candidate(found.effects[0].name, found.effects[0].target)
        if one not in best or found.cost < best[one].cost:
            best[one] = found
    fits = list(best.values())
    left = problem.residuals(
        [Hypothesis(), *(Hypothesis(one.effects) for one in fits)], held
    )
    shown = np.isin(problem.layout.recording, held)
    blocks = 1000 * problem.layout.recording + problem.layout.time.astype(np.int64)
    errors = np.sqrt((left**2).mean(axis=1))
    winner = int(np.argmin(errors[1:])) + 1
    parts = []
    for i in np.argsort(errors[1:]) + 1:
        worse = block_test(left[winner], left[i], blocks[shown]) > DOUBT
        late = lateness(fits[i - 1].effects[0])
        parts.append(
            f"{fits[i - 1].effects[0].name} {late:.3f} s leaves {1e3 * errors[i]:.1f} "
            f"mrad{' (worse)' if worse else ''}"
        )
    return f"{1e3 * errors[0]:.1f} mrad without; " + ", ".join(parts)


def lateness(effect: AppliedEffect) -> float:
    """Return by how much a servo under an effect follows a ramp late [s].

    A servo follows a ramp late by its damping over its stiffness, 2 / bandwidth here,
    and by what delays and filters its commands.
    """
    stiffness = real_data.STIFFNESS
    damping, beside = 2.0 * stiffness / BANDWIDTH, 0.0
    value = float(effect.values[0])
    if effect.name == "viscous_damping":
        damping += value
    elif effect.name == "actuator_gain":
        stiffness *= value
    else:
        beside = value
    return damping / stiffness + beside
