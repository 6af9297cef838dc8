"""rlco's own renderer: the same scene as MuJoCo's, in any thread, of its own world."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from camera_cases import NEEDS_GL, SHIFT, YAW, Truth

from rlco.envs import TabletopEnv, make_env
from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.rendering.camera import move_camera
from rlco.physics.rendering.raster import Channels, RasterCamera
from rlco.physics.spec.names import TASK_NAMES

SIZE = (64, 64)
# SHA-256 of a frame's bytes, first 16 digits. Only elementary operations, which every
# processor rounds alike, make a frame of a state; the state itself comes from MuJoCo,
# whose mathematical functions may round otherwise on another processor. Where a hash
# differs there and the agreement with MuJoCo's renderer holds, that is why.
HASHES = {
    "agentview": "96ccf3a521def327",
    "frontview": "a85708fd4d41ff6d",
    "sideview": "28caf71fc859afab",
    "birdview": "0a5dd410e6366ea4",
    "robot0_robotview": "5e6da762a75c18f3",
    "robot0_eye_in_hand": "599e69261650505f",
}


def compiled(body: str, **cameras: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return a scene, seen from 2 m above its origin by ``agentview``."""
    views = "".join(f"<camera name='{n}' {xml}/>" for n, xml in cameras.items())
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><visual><headlight ambient='.1 .1 .1' diffuse='.4 .4 .4' "
        "specular='0 0 0'/><map znear='0.001'/></visual><statistic extent='10'/>"
        f"<worldbody><camera name='agentview' pos='0 0 2'/>{views}{body}"
        "</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def geom(xml: str) -> str:
    return f"<geom group='1' {xml}/>"


def drawn(body: str, size: tuple[int, int] = (33, 33)) -> Channels:
    model, data = compiled(body)
    return RasterCamera(model, size).channels(data)


def played(task: str, episodes: int, decisions: int, seed: int) -> TabletopEnv:
    """Return environments in the middle of episodes of random actions."""
    env = make_env(task, num_envs=episodes, chunk=4, seed=seed, threads=1)
    torch.manual_seed(seed)
    state = env.reset()
    for _ in range(decisions):
        state = env.step_mdp(env.rand_step(state))
    return env


@pytest.mark.parametrize(
    ("shape", "depth"),
    [
        ("type='sphere' size='.5'", 1.5),
        ("type='ellipsoid' size='.3 .4 .25'", 1.75),
        ("type='box' size='.4 .3 .2'", 1.8),
        ("type='cylinder' size='.3 .6'", 1.4),
        ("type='capsule' size='.2 .3'", 1.5),
        ("type='plane' size='1 1 .1'", 2.0),
        ("type='plane' size='0 0 .1'", 2.0),
    ],
)
def test_the_middle_shows_the_geom_at_its_distance(shape: str, depth: float) -> None:
    channels = drawn(geom(shape))
    assert channels.geom[16, 16] == 0
    assert channels.depth[16, 16] == pytest.approx(depth, abs=1e-5)


def test_a_face_has_the_colour_of_its_light() -> None:
    # Straight in front of the headlight: 0.1 of ambient and 0.4 of diffuse light.
    image = drawn(geom("type='box' size='.4 .4 .2' rgba='1 .5 .2 1'")).image
    assert image[:, 16, 16].tolist() == [128, 64, 26]
    assert image[:, 0, 0].tolist() == [0, 0, 0]  # no sky


@pytest.mark.parametrize("exponent", [0.0, 3.0, 2.5])
def test_a_spotlight_lights_its_cone_alone(exponent: float) -> None:
    # From 1 m above a floor, which is seen from 2 m.
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><visual><headlight active='0'/></visual><worldbody>"
        "<camera name='agentview' pos='0 0 2' fovy='60'/>"
        "<light type='spot' pos='0 0 1' dir='0 0 -1' cutoff='30' diffuse='.8 .8 .8' "
        f"ambient='.1 .1 .1' specular='0 0 0' exponent='{exponent}'/>"
        + geom("type='plane' size='3 3 1' rgba='1 1 1 1'")
        + "</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    image = RasterCamera(model, (33, 33)).frame(data)
    across = (np.arange(33) - 16) / (16.5 / np.tan(np.pi / 6))
    cosine = 1 / np.sqrt(1 + (2 * np.hypot(*np.meshgrid(across, across))) ** 2)
    whole = int(exponent)
    power = cosine**whole * (1 + (exponent - whole) * (cosine - 1))
    light = power * (0.1 + 0.8 * cosine)  # both fall off; nothing beyond 30 degrees
    expected = np.where(cosine < np.cos(np.pi / 6), 0.0, 255 * light)
    assert (expected == 0).any()
    np.testing.assert_allclose(image, np.broadcast_to(expected, image.shape), atol=0.51)


def test_light_without_a_finite_exponent_is_drawn() -> None:
    shiny = "<light pos='0 0 3' exponent='1'/>" + geom(
        "type='box' size='.4 .4 .2' material='m'"
    )
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><asset><material name='m' rgba='1 1 1 1'/></asset><worldbody>"
        f"<camera name='agentview' pos='0 0 2'/>{shiny}</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    model.mat_shininess[:] = model.light_exponent[:] = 1e30
    finite = RasterCamera(model, (9, 9)).frame(data)
    model.mat_shininess[:] = model.light_exponent[:] = np.inf
    np.testing.assert_array_equal(RasterCamera(model, (9, 9)).frame(data), finite)


def test_a_transparent_geom_is_blended_twice_and_has_no_depth() -> None:
    box = geom("type='box' size='.4 .4 .2' rgba='0 0 0 1'")
    glass = geom("type='box' size='.2 .2 .1' pos='0 0 .5' rgba='1 1 1 .5'")
    channels = drawn(glass + box)
    # Half of the light, 0.5 of white, blended at 1 - (1 - 0.5)^2.
    assert channels.image[:, 16, 16].tolist() == [96, 96, 96]
    assert channels.geom[16, 16] == 0
    assert channels.depth[16, 16] == pytest.approx(1.8, abs=1e-5)


@pytest.mark.parametrize(("group", "seen"), [(0, -1), (1, 0), (2, 0), (3, -1), (5, -1)])
def test_groups_show_that_mujoco_shows(group: int, seen: int) -> None:
    # But for group 0, robosuite's collision geoms; many models have theirs in group 3.
    channels = drawn(f"<geom group='{group}' type='box' size='.4 .3 .2'/>")
    assert channels.geom[16, 16] == seen


def test_no_gap_is_left_between_triangles() -> None:
    # A mesh of many triangles before a camera: no pixel shows what is behind.
    wall = geom("type='plane' size='9 9 1' pos='0 0 -5' rgba='1 0 0 1'")
    ball = geom("type='sphere' size='1.9' rgba='0 1 0 1'")
    assert (drawn(wall + ball, (128, 128)).geom == 1).all()


def test_a_floor_is_cut_where_it_passes_behind_the_camera() -> None:
    low = "pos='0 0 .2' xyaxes='0 -1 0 0 0 1'"  # looks along x, 0.2 m above the floor
    model, data = compiled(geom("type='plane' size='0 0 1'"), low=low)
    channels = RasterCamera(model, (32, 32), "low").channels(data)
    assert (channels.geom[16:] == 0).all()
    assert (channels.geom[:15] == -1).all()
    # The lowest row of centres looks down by 15.5 / 16 of the half view's tangent.
    slope = 15.5 / 16 * np.tan(np.deg2rad(22.5))
    np.testing.assert_allclose(channels.depth[31], 0.2 / slope, rtol=1e-4)


def test_a_moved_camera_sees_what_a_model_with_that_camera_shows() -> None:
    env = played("push_cube", 1, 1, seed=3)
    model, data = env.stepper.model, env.stepper.data[0]
    frame = RasterCamera(model, SIZE).frame(data, yaw=YAW, shift=SHIFT)
    move_camera(model, YAW, SHIFT)
    mujoco.mj_camlight(model, data)
    np.testing.assert_array_equal(RasterCamera(model, SIZE).frame(data), frame)


def test_one_thread_and_two_draw_the_same_bytes() -> None:
    frames = []
    for threads in (1, 2):
        env = make_env(
            "push_cube",
            num_envs=6,
            chunk=4,
            image_size=SIZE,
            renderer="raster",
            seed=5,
            threads=threads,
        )
        torch.manual_seed(5)
        frames.append(env.rollout(3)["next", "observation", "image"].numpy())
    np.testing.assert_array_equal(*frames)


def test_a_frame_never_shows_another_worlds_state() -> None:
    env = played("pick_and_place", 5, 2, seed=7)
    stepper, rng = env.stepper, np.random.default_rng(0)
    camera = RasterCamera(stepper.model, SIZE, num_envs=5)
    sources = camera.sources(stepper.model_addresses, stepper.data)
    images = np.zeros((5, 3, *SIZE), np.uint8)
    for turn in range(6):
        # A table of its own colour, light and camera: none of them moves in between.
        one = np.array([turn % 5])
        stepper.randomise(
            one,
            {
                "mat_rgba": rng.uniform(0.2, 1.0, stepper.model.mat_rgba.shape),
                "light_diffuse": rng.uniform(0, 1, stepper.model.light_diffuse.shape),
                "mat_texid": rng.permutation(stepper.model.mat_texid),
                "cam_fovy": stepper.model.cam_fovy + rng.uniform(-3, 3),
                "headlight": rng.uniform(0, 0.5, (3, 3)),
            },
        )
        which = rng.permutation(5)[: rng.integers(1, 6)]
        camera.draw(sources, which, images, stepper.run_over)
        for world in which.tolist():
            fresh = RasterCamera(stepper.model, SIZE)
            alone = fresh.frame(stepper.data[world], model=stepper.model_of(world))
            np.testing.assert_array_equal(images[world], alone)
    assert len({image.tobytes() for image in images}) == 5


def test_what_is_changed_in_a_model_shows_in_the_next_frame() -> None:
    model, data = compiled(geom("type='box' size='.4 .4 .2' rgba='1 .5 .2 1'"))
    camera = RasterCamera(model, (33, 33))
    before = camera.frame(data)
    model.geom_rgba[0, :3] = 0.2, 1.0, 0.5
    np.testing.assert_array_equal(camera.frame(data)[:, 16, 16], [26, 128, 64])
    model.geom_rgba[0, :3] = 1.0, 0.5, 0.2
    np.testing.assert_array_equal(camera.frame(data), before)


@pytest.mark.parametrize("view", HASHES)
def test_a_view_has_the_bytes_that_it_had(view: str) -> None:
    env = played("push_cube", 1, 0, seed=11)
    model, data = env.stepper.model, env.stepper.data[0]
    frame = RasterCamera(model, SIZE, view).frame(data)
    assert hashlib.sha256(frame.tobytes()).hexdigest()[:16] == HASHES[view]


def test_images_change_no_motion() -> None:
    options: dict[str, Any] = {"image_size": (16, 16), "renderer": "raster"}
    ends = []
    for given in ({}, options):
        env = make_env("push_cube", num_envs=2, chunk=4, seed=4, **given)
        torch.manual_seed(4)
        ends.append(env.rollout(3)["next", "observation", "environment_state"].numpy())
    np.testing.assert_array_equal(*ends)


def test_both_backends_draw_the_same_start() -> None:
    starts = [
        make_env(
            "open_drawer",
            backend=backend,
            image_size=SIZE,
            renderer="raster",
            seed=2,
        ).reset()["observation", "image"]
        for backend in ("native", "robosuite")
    ]
    assert (starts[0] == starts[1]).all()


# -- Against MuJoCo's own renderer --------------------------------------------------


def shares(
    task: str, episodes: int, rounds: int, view: str = "agentview"
) -> Iterator[float]:
    """Yield the share of pixels on which both renderers agree, of many states."""
    env = played(task, episodes, 1, seed=13)
    model = env.stepper.model
    camera, truth = RasterCamera(model, SIZE, view), Truth(model, SIZE)
    state = env.reset()
    for _ in range(rounds):
        for data in env.stepper.data:
            yield float(truth.agrees(data, camera.channels(data), view).mean())
        state = env.step_mdp(env.rand_step(state))
    truth.close()


@NEEDS_GL
@pytest.mark.parametrize("task", TASK_NAMES)
@pytest.mark.parametrize("view", ["agentview", "robot0_eye_in_hand"])
def test_both_renderers_show_the_same(task: str, view: str) -> None:
    found = list(shares(task, episodes=2, rounds=2, view=view))
    assert min(found) >= 0.98


@NEEDS_GL
@pytest.mark.slow
@pytest.mark.parametrize(
    "task",
    [
        pytest.param(one, marks=[] if one == "pick_and_place" else pytest.mark.thorough)
        for one in TASK_NAMES
    ],
)
def test_both_renderers_show_the_same_in_fifty_states(task: str) -> None:
    found = list(shares(task, episodes=10, rounds=5))
    assert len(found) == 50  # of 200 in all four tasks
    assert min(found) >= 0.98


# -- What is refused ----------------------------------------------------------------


def test_names_that_do_not_exist_are_refused() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown renderer 'rastr'.*'raster'"):
        make_env("push_cube", image_size=SIZE, renderer="rastr")  # type: ignore
    model, _ = compiled("")
    with pytest.raises(UnknownNameError, match="unknown camera 'agentvew'"):
        RasterCamera(model, SIZE, "agentvew")


def test_options_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(RlcoError, match="'robosuite' is OpenGL's; give renderer='open"):
        make_env(
            "push_cube", image_size=SIZE, renderer="raster", image_quality="robosuite"
        )
    with pytest.raises(RlcoError, match="renderer='raster' is of no use without"):
        make_env("push_cube", renderer="raster")


def test_a_camera_without_perspective_is_refused() -> None:
    flat = "projection='orthographic' fovy='2'"
    model, _ = compiled("", flat=flat)
    with pytest.raises(RlcoError, match="'flat' projects in parallel"):
        RasterCamera(model, SIZE, "flat")
