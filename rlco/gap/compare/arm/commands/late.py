"""Commands that each arrive late by a time of their own: what they do to positions.

One message holds the commands of all joints, so what is late is late for all of them:
that tells late messages from whatever else disturbs single joints. To first order, a
command that is late by d seconds leaves the servo for so long with the command before,
and moves the joints by d times a response that ends when the servo has forgotten it.
One rollout measures the responses to every K-th command, so K rollouts measure all.

With the times d independent, of variance s^2, a residual r in units of the noise has
covariance ``I + s^2 S S^T``, where column k of S is the response to command k. Since a
response is short, ``S^T S`` is banded and its likelihood costs as much as the log is
long (Rasmussen and Williams, *Gaussian Processes for Machine Learning*, 2006, equations
A.9 and A.10).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis, Integers
from rlco.gap.compare.segments import SETTLE, earlier_steps
from rlco.gap.logs.log import Array
from rlco.physics.effects.command import COMMAND_DELAY

_LEAST_TEETH, _MOST_TEETH = 6, 40  # commands whose responses a rollout keeps apart


@dataclass(frozen=True)
class Responses:
    """Responses of some recordings' residuals to the lateness of each command.

    Attributes:
        channel: Joint of each residual, (N,).
        block: Recording of each residual, (N,).
        rows: Change of each residual per second by each command it still remembers,
            (N, K) [rad/s or m/s].
        command: Which commands these are, of all C; -1 for none, (N, K).
        commands: C.
    """

    channel: Integers
    block: Integers
    rows: Array
    command: Integers
    commands: int

    def sum(self) -> Array:
        """Return the change by all commands at once, one second late, (N,)."""
        return np.asarray(self.rows.sum(axis=1))

    def by(self, late: Array) -> Array:
        """Return the change by commands that are late by times (C,) [s], (N,)."""
        times = np.where(self.command >= 0, late[self.command], 0.0)
        return np.asarray((self.rows * times).sum(axis=1))

    def part(self, rows: Any) -> Responses:
        """Return the responses of some residuals."""
        return Responses(
            self.channel[rows],
            self.block[rows],
            self.rows[rows],
            self.command[rows],
            self.commands,
        )

    def gram(self) -> Array:
        """Return ``S^T S`` in banded form, (2 K, C).

        Row b holds the products of each command with the one b before it, as
        `scipy.linalg.cholesky_banded` reads it with ``lower=True``.
        """
        teeth = self.rows.shape[1]
        # Commands that are late by more than a period are remembered out of order.
        bands = np.zeros((2 * teeth, self.commands))
        for one in range(teeth):
            for other in range(teeth):
                first, second = self.command[:, one], self.command[:, other]
                apart = second - first
                held = (first >= 0) & (apart >= 0) & (apart < len(bands))
                product = (self.rows[:, one] * self.rows[:, other])[held]
                np.add.at(bands, (apart[held], first[held]), product)
        return bands

    def along(self, values: Array) -> Array:
        """Return ``S^T values`` for values (N, k), of each command, (C, k)."""
        out = np.zeros((self.commands, values.shape[1]))
        for tooth in range(self.rows.shape[1]):
            held = self.command[:, tooth] >= 0
            product = self.rows[held, tooth, None] * values[held]
            np.add.at(out, self.command[held, tooth], product)
        return out


def responses(
    problem: ArmRollouts, hypothesis: Hypothesis, late: Sequence[Array]
) -> Responses | None:
    """Measure the responses to the lateness of every command; None where they diverge.

    Args:
        problem: The robot and its log.
        hypothesis: What acts.
        late: Of each recording, how late the problem has its commands, (rows,) [s].
    """
    step, logs = float(problem.model.opt.timestep), problem.log.recordings
    period = float(np.median(np.concatenate([np.diff(log.time) for log in logs])))
    teeth = int(np.clip(np.ceil(SETTLE / period) + 1, _LEAST_TEETH, _MOST_TEETH))
    delay = sum(
        float(effect.values[0])
        for effect in hypothesis.effects
        if effect.name == COMMAND_DELAY.name
    )
    # A step later, commands are what they are now less what they change by in a step.
    pushes = [
        {
            index: -problem.of_actuators(
                one.at((one.row >= 0) & (one.row % teeth == tooth), delay)
            )
            for index, one in enumerate(problem.changes(late))
        }
        for tooth in range(teeth)
    ]
    rows = problem.pushed(hypothesis, [{}, *pushes], range(len(logs)))
    if not np.isfinite(rows).all():
        return None
    begins = np.cumsum([0, *(log.rows for log in logs)])
    remembered = []
    for segment in problem.segments:
        log, first = logs[segment.recording], int(begins[segment.recording])
        when = log.time - log.time[0] + late[segment.recording] + delay
        arrive = when / step + earlier_steps(log, step)
        steps = segment.steps + segment.frames
        columns = []
        for tooth in range(teeth):
            latest = np.searchsorted(arrive[tooth::teeth], steps, side="right") - 1
            columns.append(np.where(latest >= 0, first + tooth + teeth * latest, -1))
        own = np.stack(columns, axis=1)
        remembered.append(np.repeat(own, len(problem.log.joints), axis=0))
    command = np.concatenate(remembered)
    moved = np.where(command >= 0, ((rows[1:] - rows[0]) / step).T, 0.0)
    layout = problem.layout
    return Responses(layout.channel, layout.recording, moved, command, int(begins[-1]))
