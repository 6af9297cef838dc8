"""The change of a rollout by a torque that takes any course over time at one joint.

The course is a sum of hats over time, each with an amount of its own. A servo forgets a
push within a fraction of a second, so one rollout measures the responses to every K-th
hat, and K rollouts measure all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rlco.gap.compare.arm.free_torque import hats
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis, Integers
from rlco.gap.compare.segments import command_steps, joint_velocity
from rlco.gap.logs.log import Array
from rlco.physics.effects.targets import actuator_of

USUAL = 0.1  # size of a column, as a servo's error [rad or m]
_SPACING = 0.1  # of the hats [s]
_MOST = 800  # hats in all: in longer logs they are further apart
_REMEMBERED = 0.8  # time in which an arm forgets a push [s]
_SMALL = 0.05  # part of the usual size that is tried
_READINGS = np.linspace(0.01, 0.99, 8)  # of the knots, quantiles of the position


@dataclass(frozen=True)
class TorqueOverTime:
    """Torques at one joint as hats over time, and errors of its encoder.

    Attributes:
        joint: The joint.
        recording: Recording of each hat, (K,).
        time: Time of each hat, on the recording's clock [s], (K,).
        torque: Torque of a column [N m or N].
        moved: Change of the residuals by the usual torque at each hat, (K, N).
        misread: Change by an error of the usual size that depends on the position, at
            each of several positions, (P, N).
    """

    joint: str
    recording: Integers
    time: Array
    torque: float
    moved: Array
    misread: Array

    def columns(self) -> Array:
        """Return all changes, those by torques first, (K + P, N)."""
        return np.concatenate([self.moved, self.misread])


def torque_over_time(
    problem: ArmRollouts, hypothesis: Hypothesis, joint: str
) -> TorqueOverTime | None:
    """Return what a torque over time at a joint would change; None without a motor.

    Args:
        problem: The robot and its log.
        hypothesis: What acts already.
        joint: Its servo adds the torque.
    """
    actuator = actuator_of(problem.model, joint)
    if actuator < 0:
        return None
    torque = USUAL * abs(_gain(problem, hypothesis, actuator))
    if torque == 0.0:
        return None
    knots = _knots(problem)
    spacing = min(float(np.diff(times[:2])[0]) for times in knots)
    teeth = int(np.ceil(_REMEMBERED / spacing)) + 1
    pushes: list[dict[int, Array]] = [{} for _ in range(teeth)]
    for index, times in enumerate(knots):
        for tooth, push in enumerate(pushes):
            amounts = np.zeros(len(times))
            amounts[tooth::teeth] = _SMALL
            push[index] = _commands(problem, actuator, index, times, amounts)
    everything = range(len(knots))
    rows = problem.pushed(hypothesis, [{}, *pushes], everything)
    if not np.isfinite(rows).all():
        return None
    moved = (rows[1:] - rows[0]) / _SMALL
    layout = problem.layout
    columns = np.zeros((sum(map(len, knots)), moved.shape[1]))
    at = 0
    for index, times in enumerate(knots):
        own = np.flatnonzero(layout.recording == index)
        since = layout.time[own] - times[:, None]
        held = (since >= -spacing) & (since < (teeth - 1) * spacing)
        for number, near in enumerate(held):
            columns[at + number, own[near]] = moved[number % teeth, own[near]]
        at += len(times)
    return TorqueOverTime(
        joint,
        np.repeat(np.arange(len(knots)), [len(times) for times in knots]),
        np.concatenate(knots),
        torque,
        columns,
        _misread(problem, joint),
    )


def pushes_of(
    problem: ArmRollouts, hypothesis: Hypothesis, free: TorqueOverTime, amounts: Array
) -> Mapping[int, Array]:
    """Return commands that add torques over time, see `ArmRollouts.pushed`.

    Args:
        problem: The robot and its log.
        hypothesis: What acts already.
        free: The hats.
        amounts: Of the usual torque at each, (K,).
    """
    actuator = actuator_of(problem.model, free.joint)
    found = {}
    for index in range(len(problem.log.recordings)):
        own = free.recording == index
        found[index] = _commands(
            problem, actuator, index, free.time[own], amounts[own]
        )
    return found


def _commands(
    problem: ArmRollouts, actuator: int, index: int, times: Array, amounts: Array
) -> Array:
    """Return additions to a recording's commands: amounts at times, (steps, nu)."""
    steps = command_steps(
        problem.log.recordings[index], float(problem.model.opt.timestep)
    )
    change = np.zeros((len(steps), problem.model.nu))
    within = steps >= times[0]
    change[within, actuator] = USUAL * np.interp(steps[within], times, amounts)
    return change


def _gain(problem: ArmRollouts, hypothesis: Hypothesis, actuator: int) -> float:
    model = problem.compiled(hypothesis)
    return float(model.actuator_gainprm[actuator, 0] * model.actuator_gear[actuator, 0])


def _knots(problem: ArmRollouts) -> list[Array]:
    """Return the times of each recording's hats [s]."""
    logs = problem.log.recordings
    total = sum(one.seconds for one in logs)
    spacing = max(_SPACING, total / max(_MOST - 2 * len(logs), len(logs)))
    return [
        one.time[0] + spacing * np.arange(int(np.ceil(one.seconds / spacing)) + 1)
        for one in logs
    ]


def _misread(problem: ArmRollouts, joint: str) -> Array:
    """Return the change by an encoder's error at several positions, (P, N)."""
    column = problem.log.joints.index(joint)
    logs = problem.log.recordings
    told = np.concatenate([np.asarray(one.position)[:, column] for one in logs])
    places = np.unique(np.quantile(told.astype(float), _READINGS))
    layout = problem.layout
    rows = np.zeros((len(places), len(layout.channel)))
    own = np.flatnonzero(layout.channel == column)
    position = np.zeros(len(own))
    for index, one in enumerate(logs):
        near = layout.recording[own] == index
        path = np.asarray(one.position, dtype=float)[:, column]
        position[near] = np.interp(layout.time[own][near], one.time, path)
    rows[:, own] = -USUAL * hats(position, places)
    return rows
