"""What was measured: recordings of one robot, cleaned, in SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Recording:
    """One recording, or episode: T rows at rising times.

    Attributes:
        name: For reports: a file's name, or ``episode 3``.
        time: Seconds, rising, not necessarily even, (T,) [s].
        position: Joint positions read by the encoders, (T, joints) [rad or m].
        velocity: Joint velocities where they were logged, (T, joints) [rad/s or m/s].
        command: Commands at each time, each held until the next, (T, actuators).
        torque: Measured joint torques, (T, joints) [N m or N].
        pose: A free body's place and quaternion (w, x, y, z), (T, 7) [m].
        extra: Further channels by name, such as ``volts``, (T,).
        facts: Numbers that hold for the whole recording, such as a bench's ``mass``
            or the servo's ``kp``, as its file has them.
        device: What was recorded, as its file names it, such as ``xl330``; empty where
            it does not.
        cut_from: Name of the recording that this is a part of; empty where it is whole.
        unread: Times [s], rising, and commands that are no row's, (L,) and (L,
            actuators): before the first row, which still act on a part where commands
            are late, and between rows, where the measurement was lost.
        guessed: Standard deviation of each of these commands, zero where it is known,
            (L, actuators); None where all are.
        jitter: Standard deviation of what is not known of each row's time [s].
    """

    name: str
    time: Array
    position: Array | None = None
    velocity: Array | None = None
    command: Array | None = None
    torque: Array | None = None
    pose: Array | None = None
    extra: Mapping[str, Array] = field(default_factory=dict)
    facts: Mapping[str, float] = field(default_factory=dict)
    device: str = ""
    cut_from: str = ""
    unread: tuple[Array, Array] | None = None
    guessed: Array | None = None
    jitter: float = 0.0

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.time)

    @property
    def seconds(self) -> float:
        """From the first row to the last [s]."""
        return float(self.time[-1] - self.time[0])

    def take(self, rows: slice | NDArray[np.int64] | NDArray[np.bool_]) -> Recording:
        """Return the recording with some of its rows, of all its channels."""

        def kept(channel: Array | None) -> Array | None:
            return None if channel is None else channel[rows]

        return replace(
            self,
            time=self.time[rows],
            position=kept(self.position),
            velocity=kept(self.velocity),
            command=kept(self.command),
            torque=kept(self.torque),
            pose=kept(self.pose),
            extra={name: channel[rows] for name, channel in self.extra.items()},
        )


@dataclass(frozen=True)
class Log:
    """All recordings of one robot, with the names of their columns.

    Attributes:
        recordings: At least one.
        joints: Names of the model's joints, in the order of the columns.
        actuators: Names of the model's actuators, in the order of the columns.
        body: The free body whose pose was logged.
        notes: What was noticed and corrected while reading, one sentence each.
        unused: Headers of the columns that no comparison reads.
    """

    recordings: tuple[Recording, ...]
    joints: tuple[str, ...] = ()
    actuators: tuple[str, ...] = ()
    body: str | None = None
    notes: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()

    @property
    def seconds(self) -> float:
        """All recordings together [s]."""
        return sum(recording.seconds for recording in self.recordings)
