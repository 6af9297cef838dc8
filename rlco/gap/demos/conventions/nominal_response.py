"""Response of the simulated tool to its commands."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from rlco.gap.demos.conventions.action_units import MOVES, TURNS
from rlco.gap.demos.conventions.actions import ActionConvention, Motion, Score, score
from rlco.gap.demos.replay.channels import report
from rlco.gap.demos.replay.rollouts import Job, Rollouts
from rlco.gap.demos.replay.start_prior import Starts
from rlco.gap.logs.log import Array
from rlco.physics.spec.robot import GRIPPER, POSE, POSITION, ROTATION

_EPISODES, _STEPS = 4, 40
_KEEP = 0.7  # correlation of successive commands


def nominal_responses(
    rollouts: Rollouts,
) -> tuple[tuple[Score, Score], Array]:
    """Move the tool at random from the initial states of the task's episodes.

    Args:
        rollouts: Simulations of the task.

    Returns:
        The tool's response to metres and to radians, and its usual initial pose in the
        convention of rlco's data sets, (6,).
    """
    plants, rng = rollouts.plants, np.random.default_rng(0)
    down = plants.task.robot.down
    starts = Starts(plants)
    size = len(plants.task.action_names)
    steps = 0.3 * rng.standard_normal((_EPISODES, _STEPS, size))
    for row in range(1, _STEPS):
        steps[:, row] += _KEEP * steps[:, row - 1]
    # Up at first, away from objects on the table.
    steps[:, :10, 2] += 0.5
    steps[..., GRIPPER] = 0.0
    actions = np.clip(steps, -1.0, 1.0)
    start = starts.start(starts.mean)
    found = rollouts.run([Job(plants.nominal, start, rows) for rows in actions])
    moves: list[Motion] = []
    turns: list[Motion] = []
    for rows, features in zip(actions, found, strict=True):
        if features is None:
            raise RuntimeError("the task's own simulation diverged")
        reported = report(plants.task, plants.domain, rollouts.scene(features))
        axes = Rotation.from_rotvec(reported[:, ROTATION]).as_matrix() @ down
        # Row t observes the result of the previous action.
        commanded = np.roll(rows, -1, axis=0)
        for part, full, motions in (
            (POSITION, MOVES["parts of 5 cm"], moves),
            (ROTATION, TURNS["parts of 0.5 rad"], turns),
        ):
            move = full * commanded[:-1, part]
            position = reported[:-1, part]
            motions.append(Motion(move, move, position, axes[:-1], motions is turns))
    own = ActionConvention()
    home = starts.reported(starts.mean[None])[0, POSE]
    return (score(moves, own), score(turns, own)), home
