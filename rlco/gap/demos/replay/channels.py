"""Channels of a task's log: the tool, the gripper, objects, and joints if logged.

A column has the name that rlco's recordings give it, such as ``tool.x`` or
``red_cube.y``. Values are in the robot's base frame, as the domain's sensors and camera
report them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.spatial.transform import Rotation

from rlco.errors import DataError
from rlco.gap.logs.log import Array, Log, Recording
from rlco.physics.spec.domain import Domain
from rlco.physics.spec.names import STATE_NAMES
from rlco.physics.spec.observation import noise_size, observe
from rlco.physics.spec.robot import PANDA, POSE, ROTATION
from rlco.physics.spec.task import SceneState, Task

ARM_JOINTS = PANDA.joints


def known_names(task: Task) -> tuple[str, ...]:
    """Return the names of everything that can be compared, the tool first.

    Example:
        >>> from rlco.physics.tasks.push_cube import TASK
        >>> known_names(TASK)[:3], known_names(TASK)[-1]
        (('tool.x', 'tool.y', 'tool.z'), 'blue_cube.yaw')
    """
    yaws = tuple(f"{name}.yaw" for name in task.objects)
    return (*STATE_NAMES, *task.environment_state_names, *ARM_JOINTS, *yaws)


def unit_of(name: str) -> str:
    """Return a column's unit.

    Example:
        >>> unit_of("tool.rx"), unit_of("red_cube.x"), unit_of("joint3")
        ('rad', 'm', 'rad')
    """
    angle = name in STATE_NAMES[ROTATION] or name in ARM_JOINTS or name.endswith(".yaw")
    return "rad" if angle else "m"


def report(task: Task, domain: Domain, state: SceneState) -> Array:
    """Return the report of noise-free sensors, (..., known names)."""
    quiet = np.zeros((*state.tool_position.shape[:-1], noise_size(task)))
    robot, environment = observe(task, domain, state, quiet)
    count = len(task.objects)
    w, x, y, z = np.moveaxis(state.object_quaternion[..., :count, :], -1, 0)
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    # What the camera reports is rotated by the camera's own error.
    yaw = yaw + domain.sensors.camera_yaw
    return np.concatenate([robot, environment, state.joint_position, yaw], axis=-1)


@dataclass(frozen=True)
class Channels:
    """The columns of a log that are compared.

    Attributes:
        names: Their names.
        columns: Their indices among the `known_names`, (channels,).
    """

    names: tuple[str, ...]
    columns: tuple[int, ...]

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each channel."""
        return tuple(unit_of(name) for name in self.names)

    def difference(self, measured: Array, simulated: Array) -> Array:
        """Return measured minus simulated, (..., channels).

        The tool's rotation is compared by the rotation vector from the simulated to the
        measured orientation; angles of objects are compared modulo a full turn.
        """
        out: Array = measured - simulated
        turn = [i for i, name in enumerate(self.names) if name in STATE_NAMES[ROTATION]]
        if len(turn) == 3:
            flat = [
                Rotation.from_rotvec(a[..., turn].reshape(-1, 3))
                for a in (measured, simulated)
            ]
            apart = (flat[0] * flat[1].inv()).as_rotvec()
            out[..., turn] = apart.reshape(out[..., turn].shape)
        yaws = [i for i, name in enumerate(self.names) if name.endswith(".yaw")]
        out[..., yaws] = (out[..., yaws] + np.pi) % (2 * np.pi) - np.pi
        return out


def channels_of(task: Task, log: Log) -> Channels:
    """Return the logged columns that a simulation can be compared with.

    Columns of fixed things (marks, a cabinet) only locate the episode, and are left
    out.

    Raises:
        DataError: If a recording lacks the tool's pose.
    """
    lacking = [name for name in STATE_NAMES[POSE] if not has_column(log, name)]
    if lacking:
        raise DataError(
            f"the log has no column {', '.join(lacking)}; name the columns of the "
            f"tool's pose {', '.join(STATE_NAMES[POSE])}, or let check_conventions "
            "infer them."
        )
    names, columns = [], []
    for column, name in enumerate(known_names(task)):
        still = name in task.environment_state_names and not moves(log, name)
        if has_column(log, name) and not still:
            names.append(name)
            columns.append(column)
    return Channels(tuple(names), tuple(columns))


def has_column(log: Log, name: str) -> bool:
    """Return whether every recording has a column."""
    return all(_column(log, r, name) is not None for r in log.recordings)


def measured(log: Log, recording: int, names: Sequence[str]) -> Array:
    """Return columns of one recording, (T, names)."""
    found = log.recordings[recording]
    columns = [_column(log, found, name) for name in names]
    return np.stack([np.asarray(c, dtype=float) for c in columns], axis=1)


def moves(log: Log, name: str) -> bool:
    """Return whether a column changes by more than its noise in some recording.

    Example:
        >>> column = np.r_[np.zeros(9), 0.1 * np.ones(9), np.zeros(9)]
        >>> moves(Log((Recording("one", np.arange(27.0), extra={"z": column}),)), "z")
        True
    """
    for recording in log.recordings:
        values = _column(log, recording, name)
        if values is None or len(values) < 5:
            continue
        noise = np.median(np.abs(np.diff(values))) / 0.6745 / np.sqrt(2.0)
        middles = np.median(sliding_window_view(values, 5), axis=1)
        if np.ptp(middles) > 7.0 * noise + 1e-4:
            return True
    return False


def _column(log: Log, recording: Recording, name: str) -> Array | None:
    if name in ARM_JOINTS and recording.position is not None:
        ends = [i for i, joint in enumerate(log.joints) if joint.endswith(name)]
        return recording.position[:, ends[0]] if len(ends) == 1 else None
    found = recording.extra.get(name)
    return None if found is None else np.asarray(found, dtype=float)
