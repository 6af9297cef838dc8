"""Scenes whose labels are the simulator's own, whatever drew and stepped them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from rlco.data.labelled_scenes import labelled_scenes
from rlco.envs import make_env
from rlco.errors import ConfigError, UnknownNameError
from rlco.keys import ENVIRONMENT_STATE, IMAGE, INSTRUCTION_ID, STATE
from rlco.physics.spec.domain import make_domain
from rlco.physics.spec.sensors import Sensors
from rlco.physics.tasks.push_cube import TASK

SIZE = (64, 64)


def test_the_first_scene_is_the_start_of_an_environment() -> None:
    rows = labelled_scenes(
        TASK, 4, seed=3, image_size=SIZE, look=None, every=1, num_envs=1
    )
    env = make_env("push_cube", num_envs=1, seed=3, image_size=SIZE, renderer="raster")
    start = env.reset()
    assert torch.equal(rows[IMAGE][0], start[IMAGE][0])
    assert int(rows[INSTRUCTION_ID][0]) == int(start[INSTRUCTION_ID][0])
    torch.testing.assert_close(rows[STATE][0], start[STATE][0])
    # Without the millimetre of noise that a camera's report has.
    env.close()
    initial = env.initial_state(0)
    both = np.concatenate([initial.object_pose[:, :3], initial.goal_position])
    true = torch.from_numpy((both - TASK.robot.base)[:, :2].ravel()).float()
    torch.testing.assert_close(rows[ENVIRONMENT_STATE][0], true, atol=1e-4, rtol=0)


def test_scenes_depend_neither_on_how_many_follow_nor_on_what_is_stepped_beside() -> (
    None
):
    many = labelled_scenes(TASK, 40, seed=5, image_size=SIZE, num_envs=3, threads=2)
    few = labelled_scenes(TASK, 20, seed=5, image_size=SIZE, num_envs=2, threads=1)
    assert torch.equal(many[:20][IMAGE], few[IMAGE])
    assert torch.equal(many[:20][ENVIRONMENT_STATE], few[ENVIRONMENT_STATE])
    other = labelled_scenes(TASK, 20, seed=6, image_size=SIZE, num_envs=2)
    assert not torch.equal(other[ENVIRONMENT_STATE], few[ENVIRONMENT_STATE])


def test_looks_follow_the_seed() -> None:
    one, other = (
        labelled_scenes(TASK, 1, seed=s, image_size=SIZE, num_envs=1)[IMAGE].int()
        for s in (5, 6)
    )
    # In the same look, only the arm and the cubes are elsewhere: 13 % of the pixels.
    assert ((one - other).abs().amax(dim=1) > 5).float().mean() > 0.9


def test_labels_know_no_errors_of_sensors() -> None:
    sim = make_domain("sim")
    wrong = Sensors(tool_offset=0.05, gripper_offset=0.01)
    given = {"seed": 0, "image_size": SIZE, "num_envs": 1, "look": None}
    true = labelled_scenes(TASK, 6, domain=sim, **given)
    reported = labelled_scenes(TASK, 6, domain=replace(sim, sensors=wrong), **given)
    assert torch.equal(true[STATE], reported[STATE])


def test_a_second_camera_has_an_image_of_the_same_moment() -> None:
    both = labelled_scenes(
        TASK,
        6,
        seed=0,
        image_size=SIZE,
        num_envs=2,
        cameras=["agentview", "robot0_eye_in_hand"],
    )
    one = labelled_scenes(TASK, 6, seed=0, image_size=SIZE, num_envs=2)
    assert torch.equal(both[*IMAGE, "agentview"], one[IMAGE])
    assert both[*IMAGE, "robot0_eye_in_hand"].shape == (6, 3, *SIZE)


@pytest.mark.parametrize(
    ("wrong", "error", "words"),
    [
        ({"count": 0}, ConfigError, "count=0"),
        ({"every": 0}, ConfigError, "every=0"),
        ({"cameras": ["side"]}, UnknownNameError, "side"),
        ({"look": "dusk"}, UnknownNameError, "dusk"),
    ],
)
def test_what_cannot_be_drawn_is_refused(
    wrong: dict[str, object], error: type[Exception], words: str
) -> None:
    given = {"count": 3, "seed": 0, "image_size": SIZE, **wrong}
    with pytest.raises(error, match=words):
        labelled_scenes(TASK, **given)
