"""Conventions of the tool's pose: frames, units, rotations, quaternion orders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from rlco.errors import DataError, counted
from rlco.gap.demos.replay.channels import ARM_JOINTS, known_names
from rlco.gap.logs.log import Array, Log, Recording
from rlco.physics.spec.names import STATE_NAMES
from rlco.physics.spec.robot import GRIPPER, PANDA, POSE
from rlco.physics.spec.task import Task

_UNIT = 1e-2  # tolerance of a quaternion's length
_FAR, _TURNED = 0.15, 0.3  # tolerances of an episode's initial pose [m], [rad]
_STRANGE = 1.0  # normalized distance beyond which a pose cannot start the task
_CLOSE = 0.02  # difference of this distance up to which conventions are tied
_SAME = 0.05  # orientations that differ by less replay alike [rad]
UNITS = {"metres": 1.0, "centimetres": 0.01, "millimetres": 0.001}


@dataclass(frozen=True)
class StateConvention:
    """A convention of the tool's pose.

    Attributes:
        frame: Frame of positions: ``base`` or ``world``.
        unit: One of `UNITS`.
        rotation: ``vector`` (axis times angle), ``euler`` (about fixed x, y, z),
            ``wxyz`` or ``xyzw`` (quaternions).
        zero: Orientation of the identity: ``down``, the hand straight down, or
            ``axes``, the tool's axes along the base's.
        degrees: Whether angles are in degrees.
    """

    frame: str = "base"
    unit: str = "metres"
    rotation: str = "vector"
    zero: str = "down"
    degrees: bool = False

    def position(self, columns: Array) -> Array:
        """Return the tool's position in the base frame, (T, 3), [m]."""
        place = columns[:, :3] * UNITS[self.unit]
        return place - PANDA.base if self.frame == "world" else place

    def orientation(self, columns: Array) -> Rotation:
        """Return the tool's orientation in the base frame, T rotations."""
        turn = as_rotation(columns[:, 3:], self.rotation, self.degrees)
        return turn * Rotation.from_matrix(PANDA.down) if self.zero == "down" else turn

    def changes(self) -> list[str]:
        """Return differences from the simulator, one phrase each."""
        differences = {
            "base": "",
            "world": "positions are in the world frame, not the base's",
            "metres": "",
            "centimetres": "positions are in centimetres",
            "millimetres": "positions are in millimetres",
            "vector": "",
            "euler": "rotations are Euler angles",
            "wxyz": "rotations are quaternions (w, x, y, z)",
            "xyzw": "rotations are quaternions (x, y, z, w)",
            "down": "",
            "axes": "rotations are relative to the base's axes, not to the hand's pose "
            "straight down",
        }
        phrases = [
            differences[w] for w in (self.frame, self.unit, self.rotation, self.zero)
        ]
        phrases.append("rotations are in degrees" if self.degrees else "")
        return [word for word in phrases if word]


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
        DataError: If there are not six to nine of them.
    """
    extra = log.recordings[0].extra
    if all(name in extra for name in STATE_NAMES[POSE]):
        return tuple(name for name in STATE_NAMES if name in extra)
    others = set(known_names(task)) - set(STATE_NAMES)
    names = tuple(
        name for name in extra if name not in others and not name.endswith(ARM_JOINTS)
    )
    if not 6 <= len(names) <= 9:
        raise DataError(
            f"the robot's state has {counted(len(names), 'column')} "
            f"({', '.join(names)}); it should hold the tool's position, its "
            "rotation (three numbers, or a quaternion) and the gripper."
        )
    return names


def columns_of(recording: Recording, names: Sequence[str]) -> Array:
    """Return columns of a recording, (T, names)."""
    return np.stack([np.asarray(recording.extra[n], dtype=float) for n in names], 1)


def is_quaternion(columns: Array) -> bool:
    """Return whether the components after the position always have length one."""
    if columns.shape[1] < 7:
        return False
    length = np.linalg.norm(columns[:, 3:7], axis=1)
    return bool((np.abs(length - 1.0) < _UNIT).all())


def possible(columns: Array) -> list[StateConvention]:
    """Return the conventions that the columns allow, the simulator's own first."""
    kinds = ("wxyz", "xyzw") if is_quaternion(columns) else ("vector", "euler")
    # No hand stays within half a degree.
    large = kinds[0] == "vector" and bool(np.abs(columns[:, 3:6]).max() > 0.5)
    turns = (False, True) if large else (False,)
    return [
        StateConvention(frame, unit, kind, zero, degrees)
        for kind, zero, degrees, unit, frame in product(
            kinds, ("down", "axes"), turns, UNITS, ("base", "world")
        )
    ]


def read_state(measured: Sequence[Array], home: Array) -> list[StateConvention]:
    """Infer the convention of the tool's pose from the initial states of episodes.

    Args:
        measured: State columns of each recording, (T, columns).
        home: The tool's usual initial pose in the convention of rlco's data sets, (6,).

    Returns:
        The likeliest convention, and others that are as likely and differ in this log.

    Raises:
        DataError: If no convention puts the tool near its usual initial pose.
    """
    every, first = (
        np.concatenate(list(measured)),
        np.stack([rows[0] for rows in measured]),
    )
    usual = Rotation.from_rotvec(home[3:]) * Rotation.from_matrix(PANDA.down)
    found = []
    for convention in possible(every):
        off = np.linalg.norm(convention.position(first) - home[:3], axis=1)
        turned = (convention.orientation(first) * usual.inv()).magnitude()
        # The scatter of initial states is ignored at first.
        place, turn = float(np.median(off)), float(np.median(turned))
        misfit = max(place - _FAR, 0.0) / _FAR + max(turn - _TURNED, 0.0) / _TURNED
        found.append((misfit, len(convention.changes()), place + turn, convention))
    found.sort(key=lambda one: one[:3])
    misfit, changes, away, best = found[0]
    if misfit > _STRANGE:
        raise DataError(
            "the tool starts far from the initial poses of the task (by "
            f"{away:.2g} in metres and radians, under any convention); give a log of "
            "this task, with the tool's position, rotation and gripper in "
            "observation.state."
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
    """Return the gripper's opening, (T,), [m]; None where it is not logged."""
    rest = columns[:, 7:] if is_quaternion(columns) else columns[:, 6:]
    if rest.shape[1] == 0:
        return None
    return np.asarray(rest[:, 0] if rest.shape[1] == 1 else rest[:, 0] - rest[:, 1])


def as_simulated(
    recording: Recording, names: Sequence[str], convention: StateConvention
) -> Recording:
    """Return a recording with the tool's pose in the simulator's convention."""
    columns = columns_of(recording, names)
    down = Rotation.from_matrix(PANDA.down)
    turn = (convention.orientation(columns) * down.inv()).as_rotvec()
    pose = np.concatenate([convention.position(columns), turn], axis=1)
    extra = {k: v for k, v in recording.extra.items() if k not in names}
    extra |= {name: pose[:, i] for i, name in enumerate(STATE_NAMES[POSE])}
    wide = opening(columns)
    if wide is not None:
        extra[STATE_NAMES[GRIPPER]] = wide
    return replace(recording, extra=extra)
