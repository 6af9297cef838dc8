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

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Hypothesis, Integers
from rlco.gap.compare.segments import SETTLE, earlier_steps
from rlco.gap.logs.log import Array

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

    def weights(self) -> Array:
        """Return how much each command's lateness moves, in squares, (C,)."""
        return self.along(np.ones((len(self.rows), 1)), power=2)[:, 0]

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

    def gram(self, scale: Array) -> Array:
        """Return ``S^T S`` in units of the noise, in banded form, (2 K, C).

        Row b holds the products of each command with the one b before it, as
        `scipy.linalg.cholesky_banded` reads it with ``lower=True``.

        Args:
            scale: Standard deviation of the noise of each residual, (N,).
        """
        teeth = self.rows.shape[1]
        scaled = self.rows / scale[:, None]
        # Commands that are late by more than a period are remembered out of order.
        bands = np.zeros((2 * teeth, self.commands))
        for one in range(teeth):
            for other in range(teeth):
                first, second = self.command[:, one], self.command[:, other]
                apart = second - first
                held = (first >= 0) & (apart >= 0) & (apart < len(bands))
                product = (scaled[:, one] * scaled[:, other])[held]
                np.add.at(bands, (apart[held], first[held]), product)
        return bands

    def along(self, values: Array, power: int = 1) -> Array:
        """Return ``S^T values`` for values (N, k), of each command, (C, k).

        Args:
            values: Of each residual.
            power: Of each number of S.
        """
        out = np.zeros((self.commands, values.shape[1]))
        for tooth in range(self.rows.shape[1]):
            held = self.command[:, tooth] >= 0
            product = self.rows[held, tooth, None] ** power * values[held]
            np.add.at(out, self.command[held, tooth], product)
        return out


def responses(
    problem: ArmRollouts, hypothesis: Hypothesis, late: Mapping[int, Array]
) -> Responses | None:
    """Measure the responses to the lateness of every command; None where they diverge.

    Args:
        problem: The robot and its log.
        hypothesis: What acts.
        late: By recording, how late the problem has its commands, (rows,) [s]; the
            residuals of these recordings, in the order of the layout.
    """
    recordings = sorted(late)
    step = float(problem.model.opt.timestep)
    logs = [problem.log.recordings[index] for index in recordings]
    period = float(np.median(np.concatenate([np.diff(log.time) for log in logs])))
    teeth = int(np.clip(np.ceil(SETTLE / period) + 1, _LEAST_TEETH, _MOST_TEETH))
    delay = sum(
        effect.parameters["delay"]
        for effect in hypothesis.effects
        if effect.name == "command_delay"
    )
    pushes: list[dict[int, Array]] = [{} for _ in range(teeth)]
    arrivals: dict[int, Array] = {}
    begins: dict[int, int] = {}
    first = 0
    for index, log in zip(recordings, logs, strict=True):
        when = log.time - log.time[0] + late[index] + delay
        for tooth, push in enumerate(pushes):
            # A step later is what it is now, less what it changes by in this step.
            push[index] = -problem.changes(
                index, when, np.arange(tooth, log.rows, teeth)
            )
        arrivals[index] = when / step + earlier_steps(log, step)
        begins[index] = first
        first += log.rows
    rows = problem.pushed(hypothesis, [{}, *pushes], recordings)
    if not np.isfinite(rows).all():
        return None
    moved = ((rows[1:] - rows[0]) / step).T
    joints = len(problem.log.joints)
    command = np.full((len(moved), teeth), -1)
    at = 0
    for segment in problem.segments:
        if segment.recording not in recordings:
            continue
        steps = segment.steps + segment.frames
        rows_of = slice(at, at + len(steps) * joints)
        for tooth in range(teeth):
            arrive = arrivals[segment.recording][tooth::teeth]
            latest = np.searchsorted(arrive, steps, side="right") - 1
            own = begins[segment.recording] + tooth + teeth * latest
            command[rows_of, tooth] = np.repeat(np.where(latest >= 0, own, -1), joints)
        at += len(steps) * joints
    moved = np.where(command >= 0, moved, 0.0)
    kept = np.isin(problem.layout.recording, recordings)
    return Responses(
        problem.layout.channel[kept],
        problem.layout.recording[kept],
        moved,
        command,
        first,
    )
