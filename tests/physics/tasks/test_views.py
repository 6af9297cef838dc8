"""Frames in a look: by both renderers, in any thread, and of their own world."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from camera_cases import NEEDS_GL, Truth
from numpy.typing import NDArray

from rlco.envs import TabletopEnv, make_env, make_robosuite
from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.rendering.exposure import GAMMA
from rlco.physics.rendering.raster import RasterCamera
from rlco.physics.spec.domain import SIM, with_look
from rlco.physics.spec.look import Light, Look, Surface, View
from rlco.physics.spec.looks import LOOKS
from rlco.physics.tasks.gymnasium_env import TaskEnv
from rlco.physics.tasks.push_cube import TASK
from rlco.physics.tasks.views import Views

SIZE = (64, 64)
CAMERAS = ("agentview", "robot0_eye_in_hand")
BOTH: Any = {"renderer": "raster", "cameras": CAMERAS}


def env_in(look: Any, **options: Any) -> TabletopEnv:
    given = {"image_size": SIZE, "chunk": 4, "seed": 5, "threads": 1, **options}
    return make_env("push_cube", look=look, **given)


def frames_of(env: TabletopEnv, decisions: int = 2) -> NDArray[np.uint8]:
    """Return the frames of a rollout, (N, T, cameras, 3, h, w)."""
    torch.manual_seed(5)
    images = env.rollout(decisions)["next", "observation", "image"]
    if isinstance(images, torch.Tensor):
        return images[:, :, None].numpy()
    return torch.stack([images[name] for name in CAMERAS], 2).numpy()


def test_one_thread_and_two_draw_the_same_bytes_of_random_looks() -> None:
    one, two = (
        frames_of(env_in("random", num_envs=5, threads=threads, **BOTH))
        for threads in (1, 2)
    )
    np.testing.assert_array_equal(one, two)
    first = {frames[0, 0].tobytes() for frames in one}
    assert len(first) == 5  # each world has a look of its own


def test_a_third_camera_has_a_noise_of_its_own() -> None:
    cameras = (*CAMERAS, "frontview")
    noisy, clean = (
        env_in(look, renderer="raster", cameras=cameras).reset()["observation", "image"]
        for look in (Look(noise=0.02), Look())
    )
    noise = [(noisy[name].float() - clean[name].float()).flatten() for name in cameras]
    apart = torch.corrcoef(torch.stack(noise)) - torch.eye(3)
    # Of 12,288 independent numbers: a correlation deviates by 0.009.
    assert apart.abs().max() < 0.05
    # Two hundredths of white, less where white or black cuts it off.
    assert all(2.0 < one.std() < 5.5 for one in noise)


def test_a_frame_never_shows_another_worlds_look() -> None:
    # Episodes of a batch, of which single worlds are begun anew, against the same
    # episodes alone.
    batch = env_in("random", num_envs=3, **BOTH)
    state = batch.reset()
    again = torch.tensor([[False], [True], [False]])
    torch.manual_seed(0)
    action = batch.action_spec.rand()
    state = batch.step(state.set("action", action))["next"]
    state = batch.reset(state.set("_reset", again))
    alone = env_in("random", num_envs=1, **BOTH)
    for world, episode in ((0, 0), (1, 4), (2, 2)):
        alone.start_at(episode)
        one = alone.reset()
        if world != 1:
            one = alone.step(one.set("action", action[world : world + 1]))["next"]
        for name in CAMERAS:
            key = "observation", "image", name
            np.testing.assert_array_equal(state[key][world], one[key][0])


def test_both_backends_draw_the_same_random_looks() -> None:
    starts = [
        env_in("random", num_envs=2, **options, **BOTH)
        for options in ({}, {"backend": "robosuite", "threads": None})
    ]
    for _ in range(2):  # also the second episode, after the first one's look
        one, other = (env.reset()["observation", "image"] for env in starts)
        for name in CAMERAS:
            np.testing.assert_array_equal(one[name], other[name])


def test_a_look_changes_images_and_nothing_else() -> None:
    ends = []
    for look in (None, "stand_in", "random"):
        env = (
            make_env(
                "push_cube", num_envs=2, chunk=4, seed=4, look=look, image_size=(16, 16)
            )
            if look
            else make_env("push_cube", num_envs=2, chunk=4, seed=4)
        )
        torch.manual_seed(4)
        ends.append(env.rollout(3)["next", "observation", "environment_state"])
        env.close()
    assert torch.equal(ends[0], ends[1])
    assert torch.equal(ends[0], ends[2])


def test_noise_is_new_in_each_frame_episode_and_camera() -> None:
    one, look = np.zeros(1, np.int64), Look(noise=0.05)
    stage = NativeStepper(TASK, SIM, num_envs=1, threads=1)
    stage.reset([TASK.sample(np.random.default_rng(0), None)])
    noisy, plain = (
        Views(stage, look, SIZE, cameras=CAMERAS, renderer="raster")
        for look in (look, Look())
    )
    plain.draw(one, one)

    def noise(seed: int, episode: int, elapsed: int) -> NDArray[np.float64]:
        """Return what is added to the same two images."""
        noisy.start(one, seed, [episode])
        noisy.draw(one, np.array([elapsed]))
        pairs = ((noisy.images[name], plain.images[name]) for name in CAMERAS)
        return np.stack([a.astype(float) - b for a, b in pairs])

    first = noise(1, 2, 3)
    np.testing.assert_array_equal(first, noise(1, 2, 3))
    others = noise(9, 2, 3), noise(1, 9, 3), noise(1, 2, 9), first[::-1]
    for other in others:
        # 2.5e4 values: the correlation of independent ones has a deviation of 0.006.
        assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 0.05


def test_the_domains_own_look_is_the_default() -> None:
    own, given, plain = (
        env_in(look, domain="stand_in", renderer="raster").reset()
        for look in (None, "stand_in", "sim")
    )
    image = "observation", "image"
    assert torch.equal(own[image], given[image])
    assert (own[image] != plain[image]).float().mean() > 0.5


def test_an_object_by_its_name_has_the_colour_that_it_is_given() -> None:
    look = Look(
        surfaces={
            "red_cube": Surface(colour=(0.0, 0.0, 0.0)),
            "objects": Surface(saturation=0.0),
        }
    )
    env = make_robosuite("push_cube", domain=with_look(SIM, look), seed=3)
    model, data = env.sim.model._model, env.sim.data._data
    channels = RasterCamera(model, SIZE).channels(data)
    for name, black in (("red_cube", True), ("green_cube", False)):
        (geom,) = (
            g for g in range(model.ngeom) if model.geom(g).name == f"{name}_g0_vis"
        )
        colours = channels.image[:, channels.geom == geom].astype(int)
        assert colours.size
        assert (model.geom_rgba[geom, :3] == 0.0).all() == black
        if black:  # but for what the light mirrors
            assert (colours.max(axis=0) - colours.min(axis=0)).max() == 0
        assert np.abs(colours - colours[0]).max() <= 1  # no colour is left


def test_a_gymnasium_environment_shows_the_same_frames() -> None:
    one = TaskEnv(
        "push_cube",
        domain="stand_in",
        look="random",
        obs_type="pixels_agent_pos",
        image_size=SIZE,
        **BOTH,
    )
    other = env_in("random", domain="stand_in", chunk=1, **BOTH)
    seen, _ = one.reset(seed=5)
    state = other.reset()
    action = np.full(7, 0.3, np.float32)
    for _ in range(2):
        assert one.observation_space.contains(seen)
        for name in CAMERAS:
            image = state["observation", "image", name][0].permute(1, 2, 0)
            np.testing.assert_array_equal(seen["pixels"][name], image)
        seen = one.step(action)[0]
        state = other.step(state.set("action", torch.tensor(action).view(1, 1, 7)))
        state = state["next"]


# -- Against MuJoCo's own renderer --------------------------------------------------


@NEEDS_GL
@pytest.mark.thorough
@pytest.mark.parametrize("name", ["stand_in", "locked", "random"])
def test_both_renderers_draw_a_look_alike(name: str) -> None:
    look = LOOKS[name]
    if not isinstance(look, Look):
        look = look.draw(np.random.default_rng(3))
    gl, own = (env_in(look, renderer=r, cameras=CAMERAS) for r in ("opengl", "raster"))
    one, other = frames_of(gl).astype(float), frames_of(own).astype(float)
    model, data = own.stepper.model, own.stepper.data[0]
    truth = Truth(model, SIZE)
    agrees = truth.agrees(data, RasterCamera(model, SIZE).channels(data))
    truth.close()
    assert agrees.mean() >= 0.98
    # The pixels that may show something else (2 %) differ by white at most, all others
    # by what 1 % of white is; the sensor multiplies both by its largest gain.
    gain = max(2.0**look.exposure * max(*look.white_balance, 1.0), 1.0) ** (1 / GAMMA)
    bound = gain * (0.02 + 0.01) * 255.0
    assert np.abs(one - other).mean(axis=(0, 1, 3, 4, 5)).max() < bound
    assert np.abs((one - other).mean(axis=(0, 1, 4, 5))).max() < bound / 2
    gl.close()


@NEEDS_GL
def test_a_sensor_that_is_shifted_and_cropped_sees_the_same_in_both() -> None:
    view = View(crop=0.8, sensor_shift=(0.1, -0.06), shift=(0.02, 0.03, 0.01))
    look = Look(cameras={"agentview": replace(view, turn=(0.02, 0.05, 0.1))})
    env = make_robosuite("push_cube", domain=with_look(SIM, look), seed=3)
    model, data = env.sim.model._model, env.sim.data._data
    truth = Truth(model, SIZE)
    agrees = truth.agrees(data, RasterCamera(model, SIZE).channels(data))
    truth.close()
    assert agrees.mean() >= 0.98


def test_a_shifted_sensor_moves_the_image_by_whole_pixels() -> None:
    shifted = Look(cameras={"agentview": View(sensor_shift=(8 / 64, -4 / 64))})
    plain, moved = (
        env_in(look, renderer="raster").reset()["observation", "image"][0]
        for look in (Look(), shifted)
    )
    # What is seen at (row, column) is seen 8 columns to the right and 4 rows above.
    same = moved[:, :-4, 8:] == plain[:, 4:, :-8]
    assert same.float().mean() > 0.99


LARGE = 160  # pixels


def by_hand(model: Any, data: Any, view: View) -> Any:
    """Return row and column of the red cube's centre, by a view of agentview."""
    number = model.camera("agentview").id
    axes, at = data.cam_xmat[number].reshape(3, 3), data.cam_xpos[number]
    turn = np.eye(3)
    for axis, angle in zip(np.eye(3), view.turn, strict=True):
        x, y, z = axis
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        # Rodrigues' formula.
        turn = turn @ (
            np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        )
    at = at + axes @ view.shift
    x, y, z = (axes @ turn).T @ (data.body("red_cube_main").xpos - at)
    angle = np.deg2rad(view.field_of_view or model.cam_fovy[number])
    focal = 0.5 / np.tan(angle / 2) / view.crop
    right, down = view.sensor_shift
    return LARGE * np.array([0.5 + down + focal * y / z, 0.5 + right - focal * x / z])


@pytest.mark.parametrize(
    "view",
    [
        View(shift=(0.05, -0.03, 0.08)),
        View(turn=(0.05, -0.08, 0.3)),
        View(field_of_view=60.0),
        View(crop=0.7),
        View(sensor_shift=(0.15, -0.1)),
    ],
)
def test_a_view_shows_an_object_where_a_pinhole_camera_does(view: View) -> None:
    plain, moved = (
        make_robosuite("push_cube", domain=with_look(SIM, look), seed=3)
        for look in (Look(), Look(cameras={"agentview": view}))
    )
    model, data = plain.sim.model._model, plain.sim.data._data

    def found(env: Any) -> NDArray[np.float64]:
        """Return the middle of the red cube's pixels."""
        model, data = env.sim.model._model, env.sim.data._data
        channels = RasterCamera(model, (LARGE, LARGE)).channels(data)
        body = model.geom_bodyid == model.body("red_cube_main").id
        shown = np.argwhere(np.append(body, False)[channels.geom])
        middle: NDArray[np.float64] = shown.mean(axis=0)
        return middle

    expected = by_hand(model, data, view) - by_hand(model, data, View())
    assert np.abs(expected).max() > 4.0
    # The middle of what is seen of a cube is not quite its centre's image.
    np.testing.assert_allclose(found(moved) - found(plain), expected, atol=1.0)


def test_a_scene_has_the_surfaces_and_the_lights_of_its_look() -> None:
    look = Look(
        surfaces={"table": Surface("dark-wood", gloss=0.25), "floor": Surface("none")},
        lights=(Light(position=(0.1, 0.2, 1.5), direction=(0.0, 3.0, -4.0)),),
        headlight=Light(ambient=(0.1, 0.2, 0.3), specular=(0.4, 0.5, 0.6)),
    )
    env = make_robosuite("push_cube", domain=with_look(SIM, look), seed=3)
    model = env.sim.model._model
    role = mujoco.mjtTextureRole.mjTEXROLE_RGB
    table, floor = model.material("table_ceramic"), model.material("floorplane")
    assert model.texture(table.texid[role]).name == "look_cube_dark-wood"
    assert floor.texid[role] == -1
    assert table.specular == 0.25
    assert model.light_active[0]
    assert model.light_type[0] == mujoco.mjtLightType.mjLIGHT_POINT
    np.testing.assert_allclose(model.light_pos[0], (0.1, 0.2, 1.5))
    np.testing.assert_allclose(model.light_dir[0], (0.0, 0.6, -0.8))
    head = model.vis.headlight
    np.testing.assert_allclose(head.ambient, (0.1, 0.2, 0.3), rtol=1e-6)
    np.testing.assert_allclose(head.specular, (0.4, 0.5, 0.6), rtol=1e-6)
    dark = make_robosuite("push_cube", domain=with_look(SIM, Look(lights=())), seed=3)
    assert not dark.sim.model._model.light_active.any()


# -- What is refused ----------------------------------------------------------------


def test_what_a_scene_does_not_have_is_refused_before_it_is_built() -> None:
    for look, said in (
        (Look(surfaces={"table": Surface("light-woood")}), "texture 'light-woood'"),
        (Look(surfaces={"red_cub": Surface()}), "part of a look 'red_cub'.*'red_cube'"),
        (Look(cameras={"agentvew": View()}), "camera 'agentvew'.*'agentview'"),
        ("dusk", "look 'dusk'"),
    ):
        with pytest.raises(UnknownNameError, match=f"unknown {said}"):
            env_in(look)


def test_looks_and_cameras_without_images_are_refused() -> None:
    with pytest.raises(RlcoError, match="look= is of no use without images"):
        make_env("push_cube", look="random")
    with pytest.raises(RlcoError, match=r"cameras=.* are of no use without images"):
        make_env("push_cube", cameras=CAMERAS)
    with pytest.raises(RlcoError, match="renderer='raster' is of no use without"):
        TaskEnv("push_cube", renderer="raster")
    for cameras in (("agentview", "agentview"), (), "agentview"):
        with pytest.raises(RlcoError, match="give a list of names of cameras"):
            env_in(None, cameras=cameras)
    with pytest.raises(UnknownNameError, match="unknown camera 'wrist'"):
        env_in(None, cameras=("agentview", "wrist"))
