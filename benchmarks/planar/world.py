"""N planes with three discs each, pushed by a point: dynamics, reward, expert.

All lengths in metres, x ahead and y to the left. A disc is pushed onto its mark; the
instruction says which of the three counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planar.gaps import Gap

Array = NDArray[np.float64]

RADIUS = 0.045  # of a disc [m]
STEP = 0.05  # the tool's motion in a control step at full command [m]
SUBSTEPS = 4  # of a control step, so that the tool cannot jump over an edge
SOLVED = 0.03  # distance of a disc from its mark [m]
DISCS = 3


@dataclass(frozen=True)
class Start:
    """Where an episode begins.

    Attributes:
        tool: Position [m], shape (2,).
        discs: Positions [m], shape (3, 2).
        marks: Where the discs are to go [m], shape (3, 2).
        target: Which disc counts.
    """

    tool: Array
    discs: Array
    marks: Array
    target: int


def draw_start(rng: np.random.Generator) -> Start:
    """Draw a start: discs in three lanes, each with its mark ahead of it."""
    lanes = (rng.permutation(DISCS) - 1) * 0.14
    discs = np.stack(
        [rng.uniform(-0.10, -0.05, DISCS), lanes + rng.uniform(-0.02, 0.02, DISCS)], 1
    )
    ahead = np.stack(
        [rng.uniform(0.13, 0.18, DISCS), rng.uniform(-0.01, 0.01, DISCS)], 1
    )
    tool = np.array([-0.2, 0.0]) + rng.normal(0.0, 0.01, 2)
    return Start(tool, discs, discs + ahead, int(rng.integers(DISCS)))


class World:
    """N planes, stepped together.

    Attributes:
        tool: Positions [m], shape (N, 2).
        discs: Positions [m], shape (N, 3, 2).
        marks: Positions [m], shape (N, 3, 2).
        target: Which disc counts, shape (N,).
    """

    def __init__(self, count: int, gap: Gap) -> None:
        self.gap = gap
        self.tool = np.zeros((count, 2))
        self.discs = np.zeros((count, DISCS, 2))
        self.marks = np.zeros((count, DISCS, 2))
        self.target = np.zeros(count, dtype=np.int64)
        self._waiting = np.zeros((count, gap.delay, 2))  # commands, oldest first
        self._all = np.arange(count)

    def reset(self, which: Sequence[int], starts: Sequence[Start]) -> None:
        """Start these planes anew; commands on their way are forgotten."""
        for plane, start in zip(which, starts, strict=True):
            self.tool[plane] = start.tool
            self.discs[plane] = start.discs
            self.marks[plane] = start.marks
            self.target[plane] = start.target
        self._waiting[np.asarray(which, dtype=np.int64)] = 0.0

    def step(self, command: Array, active: NDArray[np.bool_]) -> None:
        """Execute one control step.

        Args:
            command: Of the tool, in units of its full speed, clipped to [-1, 1]. Shape
                (N, 2).
            active: Planes whose episode goes on; the others stand still. Shape (N,).
        """
        command = self._delayed(np.clip(command, -1.0, 1.0), active)
        motion = command * (STEP * self.gap.gain / SUBSTEPS) * active[:, None]
        for _ in range(SUBSTEPS):
            self._push(motion)

    def _delayed(self, command: Array, active: NDArray[np.bool_]) -> Array:
        if not self.gap.delay:
            return command
        due = self._waiting[:, 0].copy()
        queue = np.concatenate([self._waiting[:, 1:], command[:, None]], axis=1)
        self._waiting = np.where(active[:, None, None], queue, self._waiting)
        return due

    def _push(self, motion: Array) -> None:
        """Move the tool, and the discs that it moves into.

        Contact: a disc that the tool touches and moves towards is carried along by
        1 - slip of the tool's motion. Then no disc is left nearer than its radius: it
        is moved away from the tool along the line between them.
        """
        self.tool += motion
        away = self.discs - self.tool[:, None]
        squared = np.einsum("nij,nij->ni", away, away)
        plane, disc = np.nonzero(squared < RADIUS**2)
        if not plane.size:
            return  # most of the time: nothing is touched anywhere
        moved = motion[plane]
        carried = np.einsum("kj,kj->k", away[plane, disc], moved) > 0.0
        touched = self.discs[plane, disc]
        touched += (1.0 - self.gap.slip) * moved * carried[:, None]
        away = touched - self.tool[plane]
        distance = np.sqrt(np.einsum("kj,kj->k", away, away))
        near = distance < RADIUS
        scale = np.where(near, RADIUS / np.maximum(distance, 1e-9), 1.0)
        self.discs[plane, disc] = self.tool[plane] + away * scale[:, None]

    # -- What is to be done ------------------------------------------------------------

    def remaining(self) -> Array:
        """Return from the target disc to its mark [m], shape (N, 2)."""
        return self.marks[self._all, self.target] - self.discs[self._all, self.target]

    def solved(self) -> NDArray[np.bool_]:
        """Return whether the target disc is on its mark, shape (N,)."""
        return np.hypot(*self.remaining().T) < SOLVED

    def placement(self) -> tuple[Array, Array, Array, Array]:
        """Return how the tool stands to the target disc.

        Returns:
            The direction to the mark (N, 2), the way there [m] (N,), the tool's
            position along that direction from the disc [m] (N,), and its
            distance from that line [m] (N,).
        """
        remaining = self.remaining()
        way = np.hypot(*remaining.T)
        ahead = remaining / np.maximum(way, 1e-9)[:, None]
        offset = self.tool - self.discs[self._all, self.target]
        along = (offset * ahead).sum(1)
        side = np.hypot(*(offset - along[:, None] * ahead).T)
        return ahead, way, along, side

    def potential(self) -> Array:
        """Return what a shaped reward is the growth of, shape (N,).

        Ten per metre that the disc is nearer to its mark; and, as long as it is not
        there, four per metre that the tool is nearer to the place behind the disc.
        """
        _, way, along, side = self.placement()
        short, past = np.maximum(-0.06 - along, 0.0), np.maximum(along + 0.03, 0.0)
        astray = np.sqrt(side**2 + short**2 + past**2)
        return -10.0 * way - 4.0 * np.clip((way - 0.01) / 0.02, 0.0, 1.0) * astray

    def expert(self) -> Array:
        """Return the command of a scripted expert, shape (N, 2).

        It goes behind the disc, pushes it to the mark, and backs away.
        """
        ahead, way, along, side = self.placement()
        behind = self.discs[self._all, self.target] - 0.06 * ahead
        # The nearer the disc, the better it must be aimed at.
        tolerance = 0.010 + 0.018 * np.clip((along + 0.05) / 0.008, 0.0, 1.0)
        aimed = np.clip(2.0 - side / tolerance, 0.0, 1.0)
        placed = (aimed * np.clip((-0.02 - along) / 0.01, 0.0, 1.0))[:, None]
        push = np.clip(way - 0.004, 0.0, 0.035)[:, None] * ahead
        go = placed * push + (1.0 - placed) * 0.6 * (behind - self.tool)
        working = np.clip((way - 0.014) / 0.01, 0.0, 1.0)[:, None]
        leave = np.where(along > -0.08, 1.0, 0.0)[:, None] * np.array([-0.02, 0.0])
        return np.clip((working * go + (1.0 - working) * leave) / STEP, -1.0, 1.0)

    def observed(self, noise: Array) -> tuple[Array, Array]:
        """Return what the domain's sensors report.

        Args:
            noise: Standard normal, shape (N, 6, 2).

        Returns:
            The tool's position [m], shape (N, 2), and the positions of discs and
            marks as the camera reports them [m], shape (N, 12): three discs, three
            marks, x and y each.
        """
        points = np.concatenate([self.discs, self.marks], axis=1)
        return self.tool.copy(), self.gap.report(points, noise)
