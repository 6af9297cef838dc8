"""Commands in flight when a simulation starts in the middle of a recording.

With a delay, or with commands that are read at a lower rate, the controller there still
executes an earlier command, relative to the tool's pose when it arrived.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BarycentricInterpolator
from scipy.spatial.transform import Rotation

from rlco.gap.logs.log import Array
from rlco.physics.spec.control import Control, Integers
from rlco.physics.spec.robot import GRIPPER, PANDA, POSE


@dataclass(frozen=True)
class Flight:
    """The controller's memory at the start of a simulation.

    Attributes:
        clock: Physics steps since the recording's first row.
        pending: Commands that have not arrived, the oldest first, (W, A).
        action: The command that arrived last, (A,).
        unread: Whether the controller has not read it yet.
        goal: Target position of the tool, world frame, (3,), [m].
        goal_rotation: Its target orientation, (3, 3).
    """

    clock: int
    pending: Array
    action: Array
    unread: bool
    goal: Array
    goal_rotation: Array


@dataclass(frozen=True)
class Path:
    """The tool's pose at each row of a recording, world frame.

    Attributes:
        position: (T, 3), [m].
        vector: Rotation vectors relative to the hand pointing straight down, (T, 3),
            [rad].
    """

    position: Array
    vector: Array

    def turn(self, row: int) -> Array:
        """Return the tool's orientation at a row, (3, 3)."""
        return np.asarray(
            Rotation.from_rotvec(self.vector[row]).as_matrix() @ PANDA.down
        )

    def at(self, row: float) -> tuple[Array, Array]:
        """Return position and orientation between two rows, by a cubic through four."""
        first = int(np.clip(np.floor(row) - 1, 0, max(len(self.position) - 4, 0)))
        rows = np.arange(first, min(first + 4, len(self.position)))
        both = np.concatenate([self.position[rows], self.vector[rows]], axis=1)
        found = BarycentricInterpolator(rows, both)(min(row, rows[-1]))
        turn = Rotation.from_rotvec(found[3:]).as_matrix() @ PANDA.down
        return found[:3], np.asarray(turn)


def is_late(control: Control) -> bool:
    """Return whether commands are executed later than they are sent."""
    acting = control.acting
    return bool(acting.whole or acting.phase or acting.period > 0.0)


def commands_read(control: Control, row: int) -> tuple[Integers, Integers]:
    """Return the commands that the controller has read before a row, and when.

    Args:
        control: The controller, with its command delays.
        row: The row.

    Returns:
        Rows of the commands, -1 for the initial hold before any has arrived, and the
        physics steps at which they were read, since the first row, (reads,) each.
    """
    acting, substeps = control.acting, control.substeps
    now, late = row * substeps, acting.whole * substeps + acting.phase
    arrivals: Integers = np.arange(row) * substeps + late
    arrivals = arrivals[arrivals < now]
    when = arrivals
    if acting.period > 0.0:
        # A command is read at the first tick of the controller after its arrival.
        since = np.arange(-1, now) - late
        ticks = np.flatnonzero(np.diff(np.floor(since / acting.period + 1e-9)) > 0)
        index = np.searchsorted(ticks, arrivals)
        when = np.unique(ticks[index[index < len(ticks)]])
    which: Integers = np.asarray(np.searchsorted(arrivals, when, side="right") - 1)
    if row > 0 and (not len(when) or when[0] > 0):
        # A robot holds its position until the first command arrives.
        which, when = np.r_[-1, which], np.r_[0, when]
    return which.astype(np.int64), when.astype(np.int64)


def grip_after(control: Control, actions: Array, first: Array, row: int) -> Array:
    """Return the gripper's goals at a row, (2,), given those at the first row."""
    goal = first
    for command in commands_read(control, row)[0]:
        side = np.sign(actions[command, GRIPPER]) if command >= 0 else 0.0
        goal = np.clip(goal + control.finger_step * side, -1.0, 1.0)
    return goal


def in_flight(control: Control, actions: Array, path: Path, row: int) -> Flight:
    """Return the controller's memory at a row.

    Args:
        control: The controller, with its command delays.
        actions: As sent, (T, A).
        path: The tool's pose.
        row: The row, at least 1.
    """
    acting, substeps = control.acting, control.substeps
    which, when = commands_read(control, row)
    sent = np.concatenate([np.zeros((1, actions.shape[1])), actions])
    low, high, middle, scale, shift = control.inputs
    command = np.clip(sent[which[-1] + 1, POSE], low, high)
    move = (command - middle) * scale + shift
    # The reported pose lags the tool by one physics step.
    position, turn = path.at((when[-1] + 1) / substeps)
    frame = control.origin[3:].reshape(3, 3) if control.base_frame else np.eye(3)
    turned = frame @ Rotation.from_rotvec(move[3:]).as_matrix() @ frame.T @ turn
    travelling = np.arange(row - acting.whole, row)
    arrived = max(0, row - acting.whole)
    return Flight(
        clock=row * substeps,
        pending=sent[np.clip(travelling + 1, 0, None)],
        action=sent[arrived],
        unread=int(which[-1]) + 1 < arrived,
        goal=position + frame @ move[:3],
        goal_rotation=turned,
    )
