"""How often a task's scripted expert succeeds, and how fast."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rlco.physics.native.stepper import NativeStepper
from rlco.physics.spec.domain import GivenDomain, make_domain
from rlco.physics.spec.robot import POSITION
from rlco.physics.spec.task import Array, Task
from rlco.physics.tasks.check_task import check_task

COPIES = 50  # episodes that are played at once


@dataclass(frozen=True)
class ExpertSuccess:
    """What the expert reached in M episodes.

    Attributes:
        solved: Whether the task was solved at the end, shape (M,).
        steps: Control steps until it was solved for good, NaN where it was not, (M,).
    """

    solved: NDArray[np.bool_]
    steps: Array


def expert_success(
    task: Task,
    domain: GivenDomain,
    *,
    episodes: int = 200,
    seed: int = 0,
    noise: float = 0.0,
    variation: str | None = None,
) -> ExpertSuccess:
    """Let the expert play, from the true state.

    Args:
        task: The task.
        domain: Where: a domain, its name or file.
        episodes: M, the first episodes of the seed.
        seed: Determines initial states and noise.
        noise: Standard deviation of the noise on commanded translations, relative to
            the action's range; demonstrations are recorded with 0.1.
        variation: An unseen variation of the scene.

    Raises:
        ConfigError: The parts of a task of yours do not fit each other.

    Example:
        >>> from rlco.physics.tasks.push_cube import TASK
        >>> played = expert_success(TASK, "sim", episodes=2)
        >>> played.solved.tolist(), bool((played.steps < TASK.horizon).all())
        ([True, True], True)
    """
    count = min(COPIES, episodes)
    stepper = NativeStepper(
        check_task(task), make_domain(domain), num_envs=count, variation=variation
    )
    played = []
    for first in range(0, episodes, count):
        rngs = [np.random.default_rng([seed, first + i]) for i in range(count)]
        state = stepper.reset([task.initial_state(rng, variation) for rng in rngs])
        solved = []
        for _ in range(task.horizon):
            action = task.expert(state)
            jitter = np.stack([rng.standard_normal(3) for rng in rngs])
            action[:, POSITION] += noise * jitter
            state = stepper.step(np.clip(action, -1.0, 1.0)[:, None]).at(np.s_[:, 1])
            solved.append(task.success(state))
        played.append(np.stack(solved, axis=1))
    success = np.concatenate(played)[:episodes]
    # Steps after the last unsolved one: solved for good from there on.
    trailing = np.cumprod(success[:, ::-1], axis=1).sum(axis=1)
    steps = np.where(success[:, -1], task.horizon - trailing + 1.0, np.nan)
    return ExpertSuccess(success[:, -1], steps)
