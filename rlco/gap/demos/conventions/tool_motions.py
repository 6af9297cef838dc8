"""Motions of a recording's tool, aligned with its actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from rlco.gap.demos.conventions.actions import Motion
from rlco.gap.demos.conventions.states import StateConvention, as_rotation, columns_of
from rlco.gap.logs.log import Recording
from rlco.physics.spec.robot import PANDA, POSITION, ROTATION


def motions_of(
    recording: Recording, columns: Sequence[str], state: StateConvention
) -> tuple[Motion, Motion]:
    """Return the translations and rotations of a recording.

    Args:
        recording: With `command` (T, A).
        columns: Names of the columns with the robot's state.
        state: Convention of the state, and of targets.
    """
    measured, command = (
        columns_of(recording, columns),
        np.asarray(recording.command, float),
    )
    down = Rotation.from_matrix(PANDA.down)
    position, turn = state.position(measured), state.orientation(measured)
    kind = "euler" if state.rotation == "euler" else "vector"
    target = as_rotation(command[:, ROTATION], kind, state.degrees)
    if state.zero == "axes":
        target = target * down.inv()
    axes, vector = turn.as_matrix(), (turn * down.inv()).as_rotvec()
    moves, turns = command[:, POSITION], command[:, ROTATION]
    return (
        Motion(moves, state.position(moves), position, axes),
        Motion(turns, target.as_rotvec(), vector, axes, angular=True),
    )


def shifted(motion: Motion, lead: int) -> Motion:
    """Return a motion with its actions shifted by `lead` rows and both ends cut."""
    rows = len(motion.commanded) - lead
    return replace(
        motion,
        commanded=motion.commanded[lead:],
        target=motion.target[lead:],
        position=motion.position[:rows],
        turn=motion.turn[:rows],
    )
