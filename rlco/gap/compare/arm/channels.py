"""What an arm's log has a column for: the joints that are compared, their commands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from rlco.gap.compare.problem import Integers, Layout
from rlco.gap.compare.segments import Segment
from rlco.gap.logs.log import Array, Log, Recording
from rlco.physics.effects.targets import actuator_of, command_at, dof_of
from rlco.physics.effects.transmission import COMPLIANCE_SUFFIX


def layout_of(model: mujoco.MjModel, log: Log, segments: Sequence[Segment]) -> Layout:
    """Return what each residual of some segments is of.

    Args:
        model: The robot.
        log: Its joints, whose positions are compared.
        segments: In each, every joint of every row that is compared.
    """
    joints = len(log.joints)
    recording, time = [], []
    for segment in segments:
        rows = np.arange(segment.begin, segment.last + 1)
        times = log.recordings[segment.recording].time[rows]
        recording.append(np.full(len(rows) * joints, segment.recording))
        time.append(np.repeat(times, joints))
    total = sum(len(part) for part in time)
    slides = mujoco.mjtJoint.mjJNT_SLIDE
    units = tuple(
        "m" if model.joint(name).type[0] == slides else "rad" for name in log.joints
    )
    channel = np.tile(np.arange(joints), total // joints)
    return Layout(
        np.concatenate(recording),
        np.concatenate(time),
        channel,
        tuple(log.joints),
        units,
    )


def joint_commands(
    model: mujoco.MjModel, log: Log, recording: Recording, columns: Sequence[int]
) -> Array:
    """Return the command of each joint in each row; where it has none, its position.

    That of a servo is where its joint shall be.

    Args:
        model: The robot.
        log: Its joints.
        recording: (T, joints) is returned of it.
        columns: Actuator of each of the recording's commands.
    """
    commands = np.array(recording.position, dtype=float)
    sent = np.array(recording.command, dtype=float)
    for column, name in enumerate(log.joints):
        actuator = actuator_of(model, name)
        if actuator in columns:
            unit = command_at(model, actuator) or 1.0
            commands[:, column] = sent[:, list(columns).index(actuator)] / unit
    return commands


def addresses(
    model: mujoco.MjModel, joints: tuple[str, ...]
) -> tuple[Integers, tuple[Any, Any]]:
    """Return where joints are in a state.

    Returns:
        Column and address of all that a joint's encoder reads, (places, 2), and the
        addresses of the joints' own positions and velocities.
    """
    read = []
    for column, name in enumerate(joints):
        read.append((column, int(model.joint(name).qposadr[0])))
        link = mujoco.mj_name2id(
            model, mujoco.mjtObj.mjOBJ_JOINT, name + COMPLIANCE_SUFFIX
        )
        if link >= 0:
            read.append((column, int(model.jnt_qposadr[link])))
    positions = [int(model.joint(name).qposadr[0]) for name in joints]
    velocities = [dof_of(model, name) for name in joints]
    return np.array(read), (positions, velocities)


def joint_names(model: mujoco.MjModel) -> set[str]:
    """Return the names of all joints of a model."""
    return {model.joint(i).name for i in range(model.njnt)}
