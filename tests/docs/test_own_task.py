"""The task that the documentation writes is one that works."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from expert_cases import solved
from pages import run_python
from reach import TASK
from tray import TASK as TRAY

from rlco import keys
from rlco.envs import make_env
from rlco.errors import UnknownNameError
from rlco.physics.spec.domain import SIM, STAND_IN, Domain
from rlco.physics.spec.task import Task


@pytest.mark.slow
@pytest.mark.parametrize("task", [TASK, TRAY], ids=lambda t: t.name)
@pytest.mark.parametrize("domain", [STAND_IN], ids=lambda d: d.name)
def test_its_expert_solves_episodes(task: Task, domain: Domain) -> None:
    assert solved(task, domain, 20).mean() >= 0.95


def test_the_tray_is_solved_where_the_cube_lies_in_it_and_is_let_go() -> None:
    env = make_env(TRAY, num_envs=1)
    env.reset()
    state = env.stepper.scene_state()
    tray = state.goal_position[0, 0]
    cases = [  # of the cube from the tray's middle [m], opening [m], solved
        ((0.05, 0.0, 0.024), 0.08, True),
        ((0.06, 0.0, 0.024), 0.08, False),  # on the wall
        ((0.0, 0.0, 0.06), 0.08, False),  # above it
        ((0.0, 0.0, 0.024), 0.04, False),  # still held
    ]
    for place, opening, expected in cases:
        moved = replace(
            state,
            object_position=(tray + np.array(place))[None, None],
            gripper_opening=np.array([opening]),
        )
        assert TRAY.success(moved).tolist() == [expected], place


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
