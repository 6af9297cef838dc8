"""How a recording's tool moved, beside what its actions asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from rlco.gap.action_readings import Motion
from rlco.gap.log import Recording
from rlco.gap.state_readings import StateReading, as_rotation, columns_of
from rlco.physics.observation import TOOL_DOWN


def motions_of(
    recording: Recording, columns: Sequence[str], state: StateReading
) -> tuple[Motion, Motion]:
    """Return a recording's translations and its turns.

    Args:
        recording: With `command` (T, 7).
        columns: Names of those with the robot's state.
        state: How they are written, and targets with them.
    """
    told, command = columns_of(recording, columns), np.asarray(recording.command, float)
    down = Rotation.from_matrix(TOOL_DOWN)
    place, turn = state.position(told), state.orientation(told)
    kind = "euler" if state.rotation == "euler" else "vector"
    target = as_rotation(command[:, 3:6], kind, state.degrees)
    if state.zero == "axes":
        target = target * down.inv()
    axes, vector = turn.as_matrix(), (turn * down.inv()).as_rotvec()
    moves, turns = command[:, :3], command[:, 3:6]
    return (
        Motion(moves, state.position(moves), place, axes),
        Motion(turns, target.as_rotvec(), vector, axes, angular=True),
    )


def shifted(motion: Motion, lead: int) -> Motion:
    """Return a motion whose actions are taken `lead` rows later; both ends are cut."""
    rows = len(motion.asked) - lead
    return replace(
        motion,
        asked=motion.asked[lead:],
        target=motion.target[lead:],
        place=motion.place[:rows],
        turn=motion.turn[:rows],
    )
