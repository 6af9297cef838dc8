"""How far a simulated tool goes for what it is asked."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from rlco.gap.action_readings import ActionReading, Motion, Score, score
from rlco.gap.action_units import MOVES, TURNS
from rlco.gap.log import Array
from rlco.gap.task_channels import report
from rlco.gap.task_prior import Starts
from rlco.gap.task_rollouts import Job, Rollouts
from rlco.physics.observation import TOOL_DOWN

_EPISODES, _STEPS = 4, 40
_KEEP = 0.7  # part of a command that the next one keeps


def nominal_answers(
    rollouts: Rollouts,
) -> tuple[tuple[Score, Score], Array]:
    """Move the tool at random from where the task's episodes start.

    Args:
        rollouts: Simulations of the task.

    Returns:
        How the tool answers to metres and to radians, and its usual start, as our data
        sets tell it, (6,).
    """
    plants, rng = rollouts.plants, np.random.default_rng(0)
    starts = Starts(plants)
    steps = 0.3 * rng.standard_normal((_EPISODES, _STEPS, 7))
    for row in range(1, _STEPS):
        steps[:, row] += _KEEP * steps[:, row - 1]
    # Up at first, away from what stands on the table.
    steps[:, :10, 2] += 0.5
    steps[..., 6] = 0.0
    actions = np.clip(steps, -1.0, 1.0)
    start = starts.start(starts.mean)
    found = rollouts.run([Job(plants.nominal, start, rows) for rows in actions])
    moves: list[Motion] = []
    turns: list[Motion] = []
    for rows, features in zip(actions, found, strict=True):
        if features is None:
            raise RuntimeError("the task's own simulation diverged")
        told = report(plants.task, plants.domain, rollouts.scene(features))
        axes = Rotation.from_rotvec(told[:, 3:6]).as_matrix() @ TOOL_DOWN
        # Row t tells what the action before it led to.
        asked = np.roll(rows, -1, axis=0)
        for part, full, motions in (
            (slice(0, 3), MOVES["parts of 5 cm"], moves),
            (slice(3, 6), TURNS["parts of 0.5 rad"], turns),
        ):
            move = full * asked[:-1, part]
            place = told[:-1, part]
            motions.append(Motion(move, move, place, axes[:-1], motions is turns))
    own = ActionReading()
    home = starts.reported(starts.mean[None])[0, :6]
    return (score(moves, own), score(turns, own)), home
