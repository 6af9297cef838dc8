"""The task that the documentation writes is one that works."""

from __future__ import annotations

import numpy as np
import pytest
from expert_cases import solved
from pages import run_python
from reach import TASK

from rlco import keys
from rlco.envs import make_env
from rlco.errors import UnknownNameError
from rlco.physics.spec.domain import SIM, STAND_IN, Domain


@pytest.mark.slow
@pytest.mark.parametrize("domain", [SIM, STAND_IN], ids=lambda d: d.name)
def test_its_expert_solves_episodes(domain: Domain) -> None:
    assert solved(TASK, domain, 40).mean() >= 0.95


def test_it_is_an_environment_that_shows_the_mark() -> None:
    env = make_env(TASK, num_envs=2)
    rollout = env.rollout(2)
    marks = env.stepper.scene_state().goal_position[:, 0, :2]
    seen = rollout["next", keys.ENVIRONMENT_STATE].numpy()
    assert seen.shape == (2, 2, 2)  # environments, steps, x and y
    # Seen from the robot's base, but as far apart, to within the camera's noise.
    apart = seen[0] - seen[1]
    assert np.abs(apart - (marks[0] - marks[1])).max() < 10 * SIM.sensors.object_noise
    assert np.abs(marks[0] - marks[1]).max() > 20 * SIM.sensors.object_noise
    assert rollout[keys.INSTRUCTION][0][0] == "reach for the mark"


def test_a_variation_that_it_lacks_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="unknown variation 'camera'"):
        make_env(TASK, variation="camera")


@pytest.mark.slow
def test_the_page_runs_as_copied() -> None:
    made = run_python("own_task.md")
    assert made["rollout"].batch_size == (2, 3)
    assert made["demonstration"].success
