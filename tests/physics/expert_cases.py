"""What the tests of every task share: how often, and how smoothly, an expert acts."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from rlco.physics.native.stepper import NativeStepper
from rlco.physics.spec.domain import LOCKED, SIM, STAND_IN, Domain
from rlco.physics.spec.task import SceneState, Task

DOMAINS = [
    STAND_IN,  # the hardest that demonstrations are from
    *(pytest.param(one, marks=pytest.mark.thorough) for one in (SIM, LOCKED)),
]


def solved(
    task: Task,
    domain: Domain,
    episodes: int,
    *,
    variation: str | None = None,
    noise: float = 0.0,
    steps: int | None = None,
) -> NDArray[np.bool_]:
    """Play the expert; return whether each episode is solved after so many steps."""
    stepper = NativeStepper(task, domain, num_envs=episodes, variation=variation)
    rngs = [np.random.default_rng([40, i]) for i in range(episodes)]
    state = stepper.reset([task.sample(rng, variation) for rng in rngs])
    assert not task.success(state).any()
    for _ in range(steps or task.horizon):
        action = task.expert(state)
        for row, rng in zip(action, rngs, strict=True):
            row[:3] += noise * rng.standard_normal(3)
        state = stepper.step(action[:, None]).at(np.s_[:, 1])
    return task.success(state)


def expert_slopes(task: Task, state: SceneState, seed: int) -> NDArray[np.float64]:
    """Return how much each number of the action changes a metre of the tool's way."""
    step = 1e-6 * np.random.default_rng(seed).standard_normal(3)
    moved = SceneState(**{**vars(state), "tool_position": state.tool_position + step})
    change = np.abs(task.expert(moved) - task.expert(state))
    slopes: NDArray[np.float64] = change / np.linalg.norm(step)
    return slopes
