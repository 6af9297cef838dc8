"""Quality fast: the same view, fewer triangles, and what is left out."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from camera_cases import (
    NEEDS_GL,
    SIZE,
    coloured,
    scene,
    tabletop,
)

from rlco.physics.rendering import camera as camera_module
from rlco.physics.rendering.camera import Camera
from rlco.physics.rendering.simple_meshes import merge_vertices, out_of_view

pytestmark = NEEDS_GL


def test_fast_shows_the_same_things_at_the_same_places() -> None:
    model, data = scene(tabletop())
    frames = []
    for quality in ("fast", "robosuite"):
        camera = Camera(model, (128, 128), quality=quality)
        frames.append(camera.frame(data))
        camera.close()
    for channel in range(3):
        masks = [coloured(frame, channel) for frame in frames]
        centres = [np.argwhere(mask).mean(axis=0) for mask in masks]
        # Edges are half seen with multisampling: a pixel more or less all around.
        assert masks[0].sum() == pytest.approx(masks[1].sum(), rel=0.2)
        assert np.abs(centres[0] - centres[1]).max() < 1.0  # pixel
    # Only edges differ by much.
    apart = np.abs(frames[0].astype(int) - frames[1]).max(axis=0)
    assert np.median(apart) <= 2
    assert (apart > 30).mean() < 0.06


@pytest.mark.slow
@pytest.mark.parametrize("name", ["agentview", "frontview", "robot0_eye_in_hand"])
def test_what_is_left_out_cannot_be_seen(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, data = scene(tabletop())
    camera = Camera(model, SIZE, name)
    hidden = out_of_view(model, data, model.camera(name).id, SIZE[1] / SIZE[0])
    culled = camera.frame(data)
    monkeypatch.setattr(
        camera_module, "out_of_view", lambda m, *_: np.zeros(m.ngeom, dtype=bool)
    )
    np.testing.assert_array_equal(culled, camera.frame(data))
    assert hidden.sum() > 5
    camera.close()


def test_a_box_is_out_of_view_where_all_of_it_is_beyond_a_side() -> None:
    # A camera at the origin looks along -z, 90 degrees high and, at aspect 1, wide:
    # at depth 1 it sees |x| <= 1. A box of half size 0.1 at depth 1 reaches the right
    # side, normal (1, 0, 1) / sqrt(2), while (x - 1) / sqrt(2) <= 0.2 / sqrt(2).
    places = {"in": (0, 0, -1), "edge": (1.19, 0, -1), "off": (1.21, 0, -1)}
    places |= {"up": (0, 1.21, -1), "behind": (0, 0, 0.11), "low": (0, -1.19, -1)}
    geoms = "".join(
        f"<geom name='{name}' type='box' size='.1 .1 .1' pos='{x} {y} {z}'/>"
        for name, (x, y, z) in places.items()
    )
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><camera name='c' fovy='90'/>{geoms}"
        "<geom name='floor' type='plane' size='0 0 1' pos='9 9 9'/>"
        "</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    hidden = out_of_view(model, data, 0, 1.0)
    names = {model.geom(index).name for index in np.flatnonzero(hidden)}
    assert names == {"off", "up", "behind"}
    # Twice as wide: at depth 1 it sees |x| <= 2.
    wide = out_of_view(model, data, 0, 2.0)
    assert {model.geom(i).name for i in np.flatnonzero(wide)} == {"up", "behind"}


def wedge() -> mujoco.MjModel:
    """Return a mesh of two tetrahedra's corners, one pair of them 1 mm apart."""
    vertices = "0 0 0  1 0 0  0 1 0  0 0 1  0.001 0 0"
    faces = "0 2 1  0 1 3  0 3 2  1 2 3  4 2 1  0 4 2  0 4 3"
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><asset><mesh name='m' vertex='{vertices}' face='{faces}' "
        "inertia='shell'/></asset>"
        "<worldbody><geom type='mesh' mesh='m'/></worldbody></mujoco>"
    )


def test_close_vertices_are_merged_and_flat_triangles_go() -> None:
    model = wedge()
    assert model.mesh_facenum[0] == 7
    merge_vertices(model, 1e-6)
    assert model.mesh_facenum[0] == 7
    merge_vertices(model, 0.1)
    # Vertices 0 and 4 become one: (4 2 1) repeats (0 2 1), (0 4 2), (0 4 3) are flat.
    assert model.mesh_facenum[0] == 4
    corners = model.mesh_face[:4]
    assert len({tuple(sorted(face)) for face in corners.tolist()}) == 4
    assert len(np.unique(corners)) == 4


def test_merging_what_coincides_changes_no_picture(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model, data = scene(tabletop())
    monkeypatch.setattr(camera_module, "DETAIL_DISTANCE", 1e-4)
    close = Camera(model, SIZE)
    monkeypatch.setattr(camera_module, "merge_vertices", lambda *_: None)
    whole = Camera(model, SIZE)
    np.testing.assert_array_equal(close.frame(data), whole.frame(data))
    close.close()
    whole.close()
