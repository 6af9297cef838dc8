"""One OpenGL context a process: cameras side by side, other renderers, leaks."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import mujoco
import numpy as np
import pytest
from camera_cases import (
    NEEDS_GL,
    SIZE,
    image_env,
    own_frame,
    scene,
    tabletop,
)

from rlco.envs import make_robosuite
from rlco.errors import RlcoError
from rlco.physics.rendering.camera import Camera

pytestmark = [NEEDS_GL, pytest.mark.slow]


def test_cameras_of_several_models_and_sizes_do_not_mix() -> None:
    other = make_robosuite("push_cube", seed=8, image_size=(48, 48))
    scenes = [(*scene(tabletop()), SIZE), (*scene(other), (48, 48))]
    alone = []
    for model, data, size in scenes:
        camera = Camera(model, size, quality="robosuite")
        alone.append(camera.frame(data))
        camera.close()
    cameras = [Camera(model, size, quality="robosuite") for model, _, size in scenes]
    for _ in range(2):
        own_frame(other)  # leaves robosuite's own context current
        for camera, (_, data, _), frame in zip(cameras, scenes, alone, strict=True):
            np.testing.assert_array_equal(camera.frame(data), frame)
    cameras[0].close()
    np.testing.assert_array_equal(cameras[1].frame(scenes[1][1]), alone[1])
    cameras[1].close()


def resident() -> float:
    """Return the process's memory [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.parametrize("closed", [True, False])
def test_cameras_one_after_the_other_leak_nothing(closed: bool) -> None:
    gc.collect()
    # Nothing to draw, on a large buffer: quickly made, and large enough to be missed.
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><camera name='agentview'/></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)

    def cycle() -> None:
        camera = Camera(model, (1024, 1024))
        camera.frame(data)
        if closed:
            camera.close()

    for _ in range(3):
        cycle()
    gc.collect()
    before = resident()
    for _ in range(12):
        cycle()
    gc.collect()
    # One camera takes 8 MB and more.
    assert resident() - before < 24


def test_an_environment_closes_its_camera() -> None:
    env = image_env()
    env.reset()
    env.close()
    with pytest.raises(RlcoError, match="this camera is closed"):
        env.reset()


def test_a_camera_can_be_used_in_another_thread() -> None:
    model, data = scene(tabletop())
    camera = Camera(model, SIZE)
    here = camera.frame(data)
    with ThreadPoolExecutor(1) as pool:
        there = pool.submit(camera.frame, data).result()
        pool.submit(camera.close).result()
    np.testing.assert_array_equal(here, there)


def test_robosuites_own_renderer_is_left_alone() -> None:
    env = make_robosuite("push_cube", seed=4, image_size=SIZE)
    before = env.start(env.initial)["agentview_image"]
    model, data = scene(tabletop())
    camera = Camera(model, SIZE)
    mine = camera.frame(data)
    np.testing.assert_array_equal(env.start(env.initial)["agentview_image"], before)
    del env
    gc.collect()  # robosuite frees its context's objects in whichever is current
    np.testing.assert_array_equal(camera.frame(data), mine)
    camera.close()


def test_a_process_that_ends_with_an_open_camera_says_nothing() -> None:
    script = (
        "import mujoco\n"
        "from rlco.physics.rendering.camera import Camera\n"
        "xml = \"<mujoco><worldbody><camera name='agentview'/></worldbody></mujoco>\"\n"
        "camera = Camera(mujoco.MjModel.from_xml_string(xml), (8, 8))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
