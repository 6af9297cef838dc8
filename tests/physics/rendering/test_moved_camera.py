"""Cameras that stand elsewhere: what their images show, and where."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from camera_cases import (
    NEEDS_GL,
    QUALITIES,
    SHIFT,
    SIZE,
    TURNED,
    YAW,
    coloured,
    scene,
    tabletop,
)
from numpy.typing import NDArray

from rlco.envs import make_env, make_robosuite
from rlco.physics.rendering.camera import Camera, Quality, move_camera
from rlco.physics.spec.domain import SIM
from rlco.physics.spec.robot import PANDA

pytestmark = NEEDS_GL


def pixel(model: mujoco.MjModel, data: Any, point: Any) -> NDArray[np.float64]:
    """Return row and column at which agentview sees a point of the world."""
    number = model.camera("agentview").id
    x, y, z = data.cam_xmat[number].reshape(3, 3).T @ (point - data.cam_xpos[number])
    scale = SIZE[0] / 2 / np.tan(np.deg2rad(model.cam_fovy[number]) / 2)
    return np.array([SIZE[0] / 2 + scale * y / z, SIZE[1] / 2 - scale * x / z]) - 0.5


@pytest.mark.slow
@QUALITIES
def test_pictures_show_objects_where_the_domain_reports_them(quality: Quality) -> None:
    env = make_env(
        "push_cube", domain=TURNED, image_size=SIZE, image_quality=quality, seed=2
    )
    start = env.reset()
    image = start["observation", "image"][0].numpy()
    reported = start["observation", "environment_state"][0, 6:].reshape(3, 2)
    straight = make_robosuite("push_cube", domain=SIM)
    model, data = scene(straight)
    for channel, place in enumerate(reported.double().numpy()):
        point = np.array([*(place + PANDA.base[:2]), 0.802])
        expected = pixel(model, data, point)
        # The mark is the lower of the two things of its colour.
        where = np.argwhere(coloured(image, channel))
        near = where[np.abs(where - expected).max(axis=1) < 8]
        assert len(near) > 20
        assert np.abs(near.mean(axis=0) - expected).max() < 1.0
    env.close()


def test_a_move_for_one_frame_equals_a_model_with_a_moved_camera() -> None:
    model, data = scene(tabletop())
    camera = Camera(model, SIZE)
    still, moved = camera.frame(data), camera.frame(data, yaw=YAW, shift=SHIFT)
    camera.close()
    other = make_robosuite("push_cube", domain=TURNED, seed=3)
    camera = Camera(scene(other)[0], SIZE)
    built = camera.frame(scene(other)[1])
    camera.close()
    # A rounding of the camera's pose may move the edge of a triangle by a pixel.
    assert (moved != built).any(axis=0).mean() < 0.002
    assert (moved != still).any(axis=0).mean() > 0.1


def test_a_move_worked_out_by_hand() -> None:
    # What is seen turns by a quarter, then shifts by (0.1, 0). So the camera, at
    # (1, 0, 2), shifts to (0.9, 0) and turns back by a quarter: (0, -0.9).
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><camera name='agentview' pos='1 0 2'/></worldbody></mujoco>"
    )
    move_camera(model, 0.0, (0.0, 0.0))
    np.testing.assert_array_equal(model.cam_quat[0], [1.0, 0.0, 0.0, 0.0])
    move_camera(model, np.pi / 2, (0.1, 0.0))
    np.testing.assert_allclose(model.cam_pos[0], [0.0, -0.9, 2.0], atol=1e-12)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(model.cam_quat[0], [half, 0, 0, -half], atol=1e-12)
