"""The change of a rollout by a torque that takes any course over time at one joint.

The course is a sum of hats over time, each with an amount of its own. A servo forgets a
push within a fraction of a second, so one rollout measures the responses to every K-th
hat, and K rollouts measure all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rlco.gap.compare.arm.free_torque import hats, servo_gain
from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis, Integers
from rlco.gap.compare.segments import command_steps, joint_velocity
from rlco.gap.logs.log import Array
from rlco.physics.effects.targets import actuator_of

_USUAL = 0.1  # size of a column, as a servo's error [rad or m]
_SPACING = 0.1  # of the hats [s]
_MOST = 800  # hats in all: in longer logs they are further apart
_REMEMBERED = 0.8  # time in which an arm forgets a push [s]
_SMALL = 0.05  # part of the usual size that is tried
_QUANTILES = np.linspace(0.01, 0.99, 8)  # of the position: knots of its error


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
    torque = _USUAL * abs(servo_gain(problem, hypothesis, actuator))
    if torque == 0.0:
        return None
    knots = _knots(problem)
    spacing = min(float(np.diff(times[:2])[0]) for times in knots)
    teeth = int(np.ceil(_REMEMBERED / spacing)) + 1
    pushed = [problem]
    for tooth in range(teeth):
        push = {}
        for index, times in enumerate(knots):
            amounts = np.zeros(len(times))
            amounts[tooth::teeth] = _SMALL * torque
            push[index] = _each_step(problem, index, times, amounts)
        pushed.append(problem.with_torques(joint, push))
    rows = np.concatenate([one.residuals([hypothesis]) for one in pushed])
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


def with_amounts(
    problem: ArmRollouts, free: TorqueOverTime, amounts: Array
) -> ArmRollouts:
    """Return the problem with a torque over time, see `ArmRollouts.with_torques`.

    Args:
        problem: The robot and its log.
        free: The hats.
        amounts: Of the usual torque at each, (K,).
    """
    found = {}
    for index in range(len(problem.log.recordings)):
        own = free.recording == index
        torque = amounts[own] * free.torque
        found[index] = _each_step(problem, index, free.time[own], torque)
    return problem.with_torques(free.joint, found)


def _each_step(problem: ArmRollouts, index: int, times: Array, amounts: Array) -> Array:
    """Return amounts at times as one at each physics step of a recording, (steps,)."""
    steps = command_steps(
        problem.log.recordings[index], float(problem.model.opt.timestep)
    )
    return np.asarray(np.interp(steps, times, amounts) * (steps >= times[0]))


def _knots(problem: ArmRollouts) -> list[Array]:
    """Return the times of each recording's hats [s]."""
    logs = problem.log.recordings
    total = sum(one.seconds for one in logs)
    spacing = max(_SPACING, total / max(_MOST - 2 * len(logs), len(logs)))
    return [
        one.time[0] + spacing * np.arange(int(np.ceil(one.seconds / spacing)) + 1)
        for one in logs
    ]


def at_times(
    problem: ArmRollouts, joint: str, recording: Integers, time: Array
) -> tuple[Array, Array]:
    """Return position and velocity of a joint at times of recordings, (T,) both.

    Args:
        problem: The robot and its log.
        joint: The joint.
        recording: Recording of each time, (T,).
        time: On its clock [s], (T,).
    """
    column = problem.log.joints.index(joint)
    position, velocity = np.zeros(len(time)), np.zeros(len(time))
    for index, one in enumerate(problem.log.recordings):
        own = recording == index
        path = np.asarray(one.position, dtype=float)[:, column]
        position[own] = np.interp(time[own], one.time, path)
        speed = joint_velocity(one)[:, column]
        velocity[own] = np.interp(time[own], one.time, speed)
    return position, velocity


def _misread(problem: ArmRollouts, joint: str) -> Array:
    """Return the change by an encoder's error at several positions, (P, N)."""
    layout = problem.layout
    own = np.flatnonzero(layout.channel == problem.log.joints.index(joint))
    position, _ = at_times(problem, joint, layout.recording[own], layout.time[own])
    knots = np.unique(np.quantile(position, _QUANTILES))
    rows = np.zeros((len(knots), len(layout.channel)))
    rows[:, own] = -_USUAL * hats(position, knots)
    return rows
