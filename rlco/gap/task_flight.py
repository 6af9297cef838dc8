"""Commands on their way where a simulation starts in the middle of a recording.

With a delay, or with commands that are read at a slower rate, a controller still
follows an earlier command there, counted from where the tool was when it came.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BarycentricInterpolator
from scipy.spatial.transform import Rotation

from rlco.gap.log import Array
from rlco.physics.arm_control import Control, Integers
from rlco.physics.observation import TOOL_DOWN


@dataclass(frozen=True)
class Flight:
    """What a controller remembers at the start of a simulation.

    Attributes:
        clock: Physics steps since the recording's first row.
        pending: Commands that have not arrived, the oldest first, (W, 7).
        action: The command that arrived last, (7,).
        unread: Whether it is not read yet.
        goal: Where the tool is to go, world frame, (3,), [m].
        goal_rotation: How it is to be turned, (3, 3).
    """

    clock: int
    pending: Array
    action: Array
    unread: bool
    goal: Array
    goal_rotation: Array


@dataclass(frozen=True)
class Path:
    """Where the tool was at each row of a recording, world frame.

    Attributes:
        place: (T, 3), [m].
        vector: Rotation vectors from the hand straight down, (T, 3), [rad].
    """

    place: Array
    vector: Array

    def turn(self, row: int) -> Array:
        """Return the tool's orientation at a row, (3, 3)."""
        return np.asarray(
            Rotation.from_rotvec(self.vector[row]).as_matrix() @ TOOL_DOWN
        )

    def at(self, row: float) -> tuple[Array, Array]:
        """Return place and orientation between two rows, by a cubic through four."""
        first = int(np.clip(np.floor(row) - 1, 0, max(len(self.place) - 4, 0)))
        rows = np.arange(first, min(first + 4, len(self.place)))
        both = np.concatenate([self.place[rows], self.vector[rows]], axis=1)
        found = BarycentricInterpolator(rows, both)(min(row, rows[-1]))
        turn = Rotation.from_rotvec(found[3:]).as_matrix() @ TOOL_DOWN
        return found[:3], np.asarray(turn)


def is_late(control: Control) -> bool:
    """Return whether commands are not executed as they come."""
    acting = control.acting
    return bool(acting.whole or acting.phase or acting.period > 0.0)


def commands_read(control: Control, row: int) -> tuple[Integers, Integers]:
    """Return which commands the controller has read before a row, and when.

    Args:
        control: The controller, with what delays its commands.
        row: The row.

    Returns:
        Rows of the commands, -1 for the stand-still before any has come, and the
        physics steps at which they were read, since the first row, (reads,) each.
    """
    acting, substeps = control.acting, control.substeps
    now, late = row * substeps, acting.whole * substeps + acting.phase
    arrivals: Integers = np.arange(row) * substeps + late
    arrivals = arrivals[arrivals < now]
    when = arrivals
    if acting.period > 0.0:
        # Read at the first tick of the controller's clock from their arrival on.
        since = np.arange(-1, now) - late
        ticks = np.flatnonzero(np.diff(np.floor(since / acting.period + 1e-9)) > 0)
        place = np.searchsorted(ticks, arrivals)
        when = np.unique(ticks[place[place < len(ticks)]])
    which: Integers = np.asarray(np.searchsorted(arrivals, when, side="right") - 1)
    if row > 0 and (not len(when) or when[0] > 0):
        # A robot that no command has reached yet holds its place.
        which, when = np.r_[-1, which], np.r_[0, when]
    return which.astype(np.int64), when.astype(np.int64)


def grip_after(control: Control, actions: Array, first: Array, row: int) -> Array:
    """Return the gripper's goals at a row, (2,), from those at the first row."""
    goal = first
    for command in commands_read(control, row)[0]:
        side = np.sign(actions[command, 6]) if command >= 0 else 0.0
        goal = np.clip(goal + control.finger_step * side, -1.0, 1.0)
    return goal


def in_flight(control: Control, actions: Array, path: Path, row: int) -> Flight:
    """Return what the controller remembers at a row.

    Args:
        control: The controller, with what delays its commands.
        actions: As they were sent, (T, 7).
        path: Where the tool was.
        row: The row, from 1 on.
    """
    acting, substeps = control.acting, control.substeps
    which, when = commands_read(control, row)
    sent = np.concatenate([np.zeros((1, actions.shape[1])), actions])
    low, high, middle, scale, shift = control.inputs
    command = np.clip(sent[which[-1] + 1, :6], low, high)
    move = (command - middle) * scale + shift
    # Told is where the tool was one physics step before.
    place, turn = path.at((when[-1] + 1) / substeps)
    frame = control.origin[3:].reshape(3, 3) if control.base_frame else np.eye(3)
    turned = frame @ Rotation.from_rotvec(move[3:]).as_matrix() @ frame.T @ turn
    travelling = np.arange(row - acting.whole, row)
    arrived = max(0, row - acting.whole)
    return Flight(
        clock=row * substeps,
        pending=sent[np.clip(travelling + 1, 0, None)],
        action=sent[arrived],
        unread=int(which[-1]) + 1 < arrived,
        goal=place + frame @ move[:3],
        goal_rotation=turned,
    )
