"""Figures of images: what is shown stands where and under the name that it should."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from rlco.reporting.image_plots import episode_strip, same_scene
from rlco.reporting.plot_style import save_figure


def test_an_episode_names_its_policy_and_its_instruction() -> None:
    frame = np.zeros((4, 6, 3), np.uint8)
    words = {"policy": "rl_co", "instruction": "push the red cube"}
    figure = episode_strip([frame], [0.0], "sim", **words)
    assert figure.get_label().startswith('Policy rl_co, asked to "push the red cube". ')


def test_a_scene_is_shown_by_camera_and_domain_side_by_side(tmp_path: Path) -> None:
    red, blue = (np.full((8, 8, 3), rgb, np.uint8) for rgb in ((200, 0, 0), (0, 0, 90)))
    path = tmp_path / "scene.png"
    figure = same_scene({"front": {"sim": red, "stand_in": blue}})
    save_figure(figure, path)
    with Image.open(path) as image:
        pixels, about = np.asarray(image.convert("RGB")), image.info
    (red_rows, red_columns), (blue_rows, blue_columns) = (
        np.nonzero((pixels == colour[0, 0]).all(-1)) for colour in (red, blue)
    )
    assert red_columns.max() < blue_columns.min()
    assert (red_rows.min(), red_rows.max()) == (blue_rows.min(), blue_rows.max())
    assert np.ptp(red_columns) > 400  # large enough to be looked at [pixels]
    assert [one.get_title() for one in figure.axes] == ["sim\nfront", "stand_in\nfront"]
    assert "8 x 8 pixels" in about["Description"]
    assert "stand_in (a second simulator, not a robot)" in about["Description"]
    assert "stand_in, is a second simulator, not a robot" in about["Comment"]
