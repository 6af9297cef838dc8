"""Frames: robosuite's own pixels, the same view faster, and nothing but images."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from camera_cases import (
    NEEDS_GL,
    QUALITIES,
    SIZE,
    TURNED,
    image_env,
    own_frame,
    scene,
    tabletop,
)
from numpy.typing import NDArray

from rlco.envs import make_env, make_robosuite
from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.rendering.camera import Camera, Quality, move_camera
from rlco.physics.spec.domain import SIM, Domain
from rlco.physics.spec.names import TASK_NAMES

pytestmark = [NEEDS_GL, pytest.mark.slow]


# -- Quality robosuite ------------------------------------------------------------


@pytest.mark.parametrize(
    "domain",
    [pytest.param(SIM, marks=pytest.mark.thorough), TURNED],
    ids=lambda d: d.name,
)
def test_robosuite_quality_equals_robosuites_own_observation(domain: Domain) -> None:
    env = make_robosuite("push_cube", domain=domain, seed=5, image_size=SIZE)
    model, data = scene(env)
    camera = Camera(model, SIZE, quality="robosuite")
    first = own_frame(env)
    np.testing.assert_array_equal(camera.frame(data), first)
    rng = np.random.default_rng(0)
    for _ in range(3):
        own = own_frame(env, rng.uniform(-1.0, 1.0, 7))
        np.testing.assert_array_equal(camera.frame(data), own)
    camera.close()


@pytest.mark.thorough
@pytest.mark.parametrize("task", TASK_NAMES)
def test_robosuite_quality_equals_robosuites_own_in_every_task(task: str) -> None:
    env = make_robosuite(task, seed=6, image_size=SIZE)
    model, data = scene(env)
    camera = Camera(model, SIZE, quality="robosuite")
    np.testing.assert_array_equal(camera.frame(data), own_frame(env))
    camera.close()


@pytest.mark.parametrize("backend", ["native", "robosuite"])
def test_both_backends_give_robosuites_own_pixels(backend: Any) -> None:
    env = make_env(
        "push_cube", backend=backend, image_size=SIZE, image_quality="robosuite"
    )
    first = env.reset()
    reference = make_robosuite("push_cube", image_size=SIZE)
    reference.initial = env.initial_state(0)
    seen = [first["observation", "image"][0].numpy()]
    own = [own_frame(reference)]
    action = np.array([0.2, -0.4, 0.6, 0.0, 0.0, 0.3, 1.0])
    for _ in range(2):
        step = env.step(first.set("action", torch.tensor(action)[None, None].float()))
        seen.append(step["next", "observation", "image"][0].numpy())
        # The environment's actions are float32.
        own.append(own_frame(reference, action.astype(np.float32).astype(float)))
    np.testing.assert_array_equal(np.stack(seen), np.stack(own))
    env.close()


@pytest.mark.thorough
def test_another_robosuite_task_is_drawn_alike() -> None:
    import robosuite

    env = robosuite.make(
        "Lift",
        robots="Panda",
        has_renderer=False,
        camera_heights=SIZE[0],
        camera_widths=SIZE[1],
    )
    env.reset()
    own = own_frame(env, np.full(env.action_dim, 0.3))
    model, data = scene(env)
    camera = Camera(model, SIZE, quality="robosuite")
    np.testing.assert_array_equal(camera.frame(data), own)
    camera.close()


# -- Worlds that differ ------------------------------------------------------------


@QUALITIES
def test_a_copys_own_colours_show_in_its_own_pictures(quality: Quality) -> None:
    options: dict[str, Any] = {"num_envs": 2, "image_quality": quality}
    plain = image_env(**options).reset()["observation", "image"]
    env = image_env(**options)
    red = np.tile([1.0, 0.0, 0.0, 1.0], (env.stepper.model.ngeom, 1))
    env.stepper.randomise([0], {"geom_rgba": red})
    seen = env.reset()["observation", "image"]
    assert torch.equal(seen[1], plain[1])
    before, after = (image[0].float() for image in (plain, seen))
    share = [image[0].sum() / image.sum() for image in (before, after)]
    assert share[1] > share[0] + 0.1
    env.stepper.worlds.restore_models(np.array([0]))
    env.start_at(0)
    assert torch.equal(env.reset()["observation", "image"], plain)
    env.close()


def test_a_copys_own_camera_stands_where_it_is_told() -> None:
    env = image_env(num_envs=2)
    plain = env.reset()["observation", "image"]
    model = env.stepper.model
    env.stepper.randomise([1], {"cam_pos": np.add(model.cam_pos, (0.0, 0.3, 0.0))})
    env.start_at(0)
    seen = env.reset()["observation", "image"]
    assert torch.equal(seen[0], plain[0])
    assert (seen[1] != plain[1]).any(dim=0).float().mean() > 0.2
    env.close()


# -- Only what a decision needs, and nothing but images -------------------------


@QUALITIES
def test_images_change_no_motion(quality: Quality) -> None:
    final = []
    for options in ({}, {"image_size": (16, 16), "image_quality": quality}):
        env = make_env("push_cube", chunk=4, num_envs=2, horizon=12, **options)
        torch.manual_seed(0)
        env.rollout(3)
        for data in env.stepper.data:
            kind = mujoco.mjtState.mjSTATE_INTEGRATION
            state = np.empty(mujoco.mj_stateSize(env.stepper.model, kind))
            mujoco.mj_getState(env.stepper.model, data, state, kind)
            final.append(state)
        env.close()
    np.testing.assert_array_equal(final[:2], final[2:])


def test_a_frame_leaves_model_and_state_as_they_were() -> None:
    model, data = scene(tabletop())
    camera = Camera(model, SIZE)
    fields = ("cam_xpos", "cam_xmat", "geom_xpos", "geom_xmat", "qpos", "qacc")
    before = [getattr(data, name).copy() for name in fields]
    groups, meshes = model.geom_group.copy(), model.mesh_facenum.copy()
    samples = int(model.vis.quality.offsamples)
    camera.frame(data, yaw=0.3, shift=(0.1, 0.0))
    for name, value in zip(fields, before, strict=True):
        np.testing.assert_array_equal(getattr(data, name), value)
    np.testing.assert_array_equal(model.geom_group, groups)
    np.testing.assert_array_equal(model.mesh_facenum, meshes)
    assert model.vis.quality.offsamples == samples
    camera.close()


def test_one_frame_a_decision_and_none_for_who_stands_still(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drawn: list[Any] = []
    frame = Camera.frame

    def counted(self: Camera, data: Any, **move: Any) -> NDArray[np.uint8]:
        drawn.append(data)
        return frame(self, data, **move)

    monkeypatch.setattr(Camera, "frame", counted)
    env = image_env(num_envs=3, horizon=8)
    last = env.rollout(2)["next"][:, -1]
    # At the start, and after each of two decisions of 4 control steps.
    assert len(drawn) == 3 * (1 + 2)
    drawn.clear()
    last["_reset"] = torch.tensor([[False], [True], [False]])
    shown = last["observation", "image"].clone()
    again = env.reset(last)["observation", "image"]
    assert drawn == [env.stepper.data[1]]
    assert torch.equal(again[[0, 2]], shown[[0, 2]])
    assert not torch.equal(again[1], shown[1])
    env.close()


def test_images_returned_earlier_stay_as_they_were() -> None:
    env = image_env()
    first = env.reset()
    image = first["observation", "image"]
    before = image.clone()
    env.step(first.set("action", torch.ones(1, 4, 7)))
    assert torch.equal(image, before)
    env.close()


# -- Errors -----------------------------------------------------------------------


def test_unknown_names_are_refused() -> None:
    model, _ = scene(tabletop())
    message = "unknown image quality 'fats' .*did you mean 'fast'.*fast, robosuite"
    with pytest.raises(UnknownNameError, match=message):
        Camera(model, SIZE, quality="fats")
    with pytest.raises(RlcoError, match=message):
        make_env("push_cube", image_quality="fats")
    with pytest.raises(UnknownNameError, match="did you mean 'agentview'"):
        Camera(model, SIZE, "agentvew")
    with pytest.raises(UnknownNameError, match="did you mean 'agentview'"):
        move_camera(model, 0.1, (0.0, 0.0), "agentvew")
