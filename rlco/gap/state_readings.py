"""How a log writes the tool's pose: frames, units, rotations, quaternion orders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from rlco.errors import DataError
from rlco.gap.log import Array, Log, Recording
from rlco.gap.task_channels import ARM_JOINTS, known_names
from rlco.physics.observation import BASE_POSITION, STATE_NAMES, TOOL_DOWN
from rlco.physics.task import Task

_UNIT = 1e-2  # how far a quaternion's length may be from one
_FAR, _TURNED = 0.15, 0.3  # by how much episodes may start elsewhere [m], [rad]
_STRANGE = 1.0  # so many times that beyond is no start of the task
_CLOSE = 0.02  # starts that are so much further off are as likely
_SAME = 0.05  # orientations that differ by less are the same to a replay [rad]
UNITS = {"metres": 1.0, "centimetres": 0.01, "millimetres": 0.001}


@dataclass(frozen=True)
class StateReading:
    """How the tool's pose is written.

    Attributes:
        frame: Whose origin positions count from: ``base`` or ``world``.
        unit: One of `UNITS`.
        rotation: ``vector`` (axis times angle), ``euler`` (about fixed x, y, z),
            ``wxyz`` or ``xyzw`` (quaternions).
        zero: What no rotation means: ``down``, the hand straight down, or ``axes``,
            the tool's axes along the base's.
        degrees: Whether angles are in degrees.
    """

    frame: str = "base"
    unit: str = "metres"
    rotation: str = "vector"
    zero: str = "down"
    degrees: bool = False

    def position(self, columns: Array) -> Array:
        """Return the tool's position in the base's frame, (T, 3), [m]."""
        place = columns[:, :3] * UNITS[self.unit]
        return place - BASE_POSITION if self.frame == "world" else place

    def orientation(self, columns: Array) -> Rotation:
        """Return the tool's orientation in the base's frame, T rotations."""
        turn = as_rotation(columns[:, 3:], self.rotation, self.degrees)
        return turn * Rotation.from_matrix(TOOL_DOWN) if self.zero == "down" else turn

    def changes(self) -> list[str]:
        """Return what differs from the simulator, in words."""
        told = {
            "base": "",
            "world": "positions count from the world's origin, not the base's",
            "metres": "",
            "centimetres": "positions are in centimetres",
            "millimetres": "positions are in millimetres",
            "vector": "",
            "euler": "rotations are Euler angles",
            "wxyz": "rotations are quaternions (w, x, y, z)",
            "xyzw": "rotations are quaternions (x, y, z, w)",
            "down": "",
            "axes": "rotations count from the base's axes, not from the hand's pose "
            "straight down",
        }
        words = [told[w] for w in (self.frame, self.unit, self.rotation, self.zero)]
        words.append("rotations are in degrees" if self.degrees else "")
        return [word for word in words if word]


def as_rotation(numbers: Array, kind: str, degrees: bool) -> Rotation:
    """Return rotations from vectors, Euler angles or quaternions, (T, 3 or 4)."""
    if kind in ("wxyz", "xyzw"):
        return Rotation.from_quat(numbers[:, :4], scalar_first=kind == "wxyz")
    if kind == "euler":
        return Rotation.from_euler("xyz", numbers[:, :3], degrees=degrees)
    scale = np.pi / 180.0 if degrees else 1.0
    return Rotation.from_rotvec(numbers[:, :3] * scale)


def state_columns(log: Log, task: Task) -> tuple[str, ...]:
    """Return the names of the columns that hold the robot's state.

    Raises:
        DataError: If they are not six to nine.
    """
    extra = log.recordings[0].extra
    if all(name in extra for name in STATE_NAMES[:6]):
        return tuple(name for name in STATE_NAMES if name in extra)
    others = set(known_names(task)) - set(STATE_NAMES)
    names = tuple(
        name for name in extra if name not in others and not name.endswith(ARM_JOINTS)
    )
    if not 6 <= len(names) <= 9:
        raise DataError(
            f"the robot's state has {len(names)} columns ({', '.join(names)}); it "
            "should hold the tool's position, its rotation (three numbers, or a "
            "quaternion) and the gripper."
        )
    return names


def columns_of(recording: Recording, names: Sequence[str]) -> Array:
    """Return columns of a recording, (T, names)."""
    return np.stack([np.asarray(recording.extra[n], dtype=float) for n in names], 1)


def is_quaternion(columns: Array) -> bool:
    """Return whether the numbers after the position have length one, always."""
    if columns.shape[1] < 7:
        return False
    length = np.linalg.norm(columns[:, 3:7], axis=1)
    return bool((np.abs(length - 1.0) < _UNIT).all())


def possible(columns: Array) -> list[StateReading]:
    """Return the readings that the columns allow, the simulator's own first."""
    kinds = ("wxyz", "xyzw") if is_quaternion(columns) else ("vector", "euler")
    # No hand stays within half a degree.
    large = kinds[0] == "vector" and bool(np.abs(columns[:, 3:6]).max() > 0.5)
    turns = (False, True) if large else (False,)
    return [
        StateReading(frame, unit, kind, zero, degrees)
        for kind, zero, degrees, unit, frame in product(
            kinds, ("down", "axes"), turns, UNITS, ("base", "world")
        )
    ]


def read_state(told: Sequence[Array], home: Array) -> list[StateReading]:
    """Find out how the tool's pose is written, by where the task's episodes start.

    Args:
        told: State columns of each recording, (T, columns).
        home: Where the tool usually starts, as our data sets tell it, (6,).

    Returns:
        The likeliest reading, and others that are as likely and differ in this log.

    Raises:
        DataError: If no reading puts the tool near there.
    """
    every, first = np.concatenate(list(told)), np.stack([rows[0] for rows in told])
    usual = Rotation.from_rotvec(home[3:]) * Rotation.from_matrix(TOOL_DOWN)
    found = []
    for reading in possible(every):
        off = np.linalg.norm(reading.position(first) - home[:3], axis=1)
        turned = (reading.orientation(first) * usual.inv()).magnitude()
        # By how much starts differ of themselves counts for nothing at first.
        place, turn = float(np.median(off)), float(np.median(turned))
        misfit = max(place - _FAR, 0.0) / _FAR + max(turn - _TURNED, 0.0) / _TURNED
        found.append((misfit, len(reading.changes()), place + turn, reading))
    found.sort(key=lambda one: one[:3])
    misfit, changes, away, best = found[0]
    if misfit > _STRANGE:
        raise DataError(
            f"the tool starts far from where the task's episodes start (by {away:.2g} "
            "in metres and radians, however its pose is read); give a log of this "
            "task, with the tool's position, rotation and gripper in observation.state."
        )
    rivals = [
        one[-1]
        for one in found[1:]
        if one[0] <= misfit and one[1] <= changes and one[2] < away + _CLOSE
    ]
    here = best.orientation(every)
    return [best] + [r for r in rivals if _apart(r.orientation(every), here) > _SAME]


def _apart(a: Rotation, b: Rotation) -> float:
    return float((a * b.inv()).magnitude().max())


def opening(columns: Array) -> Array | None:
    """Return the distance between the fingers, (T,), [m]; None where it is not told."""
    rest = columns[:, 7:] if is_quaternion(columns) else columns[:, 6:]
    if rest.shape[1] == 0:
        return None
    return np.asarray(rest[:, 0] if rest.shape[1] == 1 else rest[:, 0] - rest[:, 1])


def as_simulated(
    recording: Recording, names: Sequence[str], reading: StateReading
) -> Recording:
    """Return a recording with the tool's pose as the simulator writes it."""
    columns = columns_of(recording, names)
    down = Rotation.from_matrix(TOOL_DOWN)
    turn = (reading.orientation(columns) * down.inv()).as_rotvec()
    pose = np.concatenate([reading.position(columns), turn], axis=1)
    extra = {k: v for k, v in recording.extra.items() if k not in names}
    extra |= {name: pose[:, i] for i, name in enumerate(STATE_NAMES[:6])}
    wide = opening(columns)
    if wide is not None:
        extra[STATE_NAMES[6]] = wide
    return replace(recording, extra=extra)
