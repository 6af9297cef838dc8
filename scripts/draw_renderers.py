"""Draw docs/figures/raster.png, cameras.png and looks.png: renderers and looks.

uv run scripts/draw_renderers.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import numpy as np
import torch
from numpy.typing import NDArray

from rlco import keys
from rlco.reporting.headless import choose_gl

FIGURES = Path(__file__).parents[1] / "docs" / "figures"
SIDE = 128  # pixels of a frame, each drawn as 2 x 2
# Task, camera and decisions of random actions before the frame.
SCENES = (
    ("push_cube", "agentview", 6),
    ("pick_and_place", "agentview", 6),
    ("open_drawer", "frontview", 6),
)
QUALITIES = ("robosuite", "fast")
CAMERAS = ("agentview", "robot0_eye_in_hand")
GAP = 4  # white pixels between the frames of looks
RANDOM = 3  # columns of random looks


def main() -> None:
    """Draw the figures."""
    choose_gl()
    rows = [
        np.concatenate([frame(*scene, renderer=r) for r in ("raster", "opengl")], 1)
        for scene in SCENES
    ]
    imageio.imwrite(FIGURES / "raster.png", enlarged(np.concatenate(rows)))
    rows = [
        np.concatenate(
            [frame(*SCENES[0], domain=d, image_quality=q) for q in QUALITIES], 1
        )
        for d in ("sim", "stand_in")
    ]
    imageio.imwrite(FIGURES / "cameras.png", enlarged(np.concatenate(rows)))
    imageio.imwrite(FIGURES / "looks.png", enlarged(looks()))


def frame(task: str, camera: str, decisions: int, **options: Any) -> NDArray[np.uint8]:
    """Return one frame of an episode of random actions, (height, width, 3)."""
    from rlco.envs import make_env

    size = (SIDE, SIDE)
    env = make_env(task, chunk=4, image_size=size, cameras=[camera], seed=1, **options)
    torch.manual_seed(0)
    last = env.rollout(decisions)["next"][0, -1]
    env.close()
    return last[keys.IMAGE].permute(1, 2, 0).numpy()


def looks() -> NDArray[np.uint8]:
    """Return a row for each camera, a column for each look, by rlco's renderer."""
    from rlco.envs import make_env

    columns = []
    for look, count in (("sim", 1), ("stand_in", 1), ("locked", 1), ("random", RANDOM)):
        env = make_env(
            "push_cube",
            look=look,
            num_envs=count,
            image_size=(SIDE, SIDE),
            cameras=CAMERAS,
            renderer="raster",
            seed=3,
        )
        images = env.reset()["observation", "image"]
        columns += [
            stacked([images[c][k].permute(1, 2, 0).numpy() for c in CAMERAS], 0)
            for k in range(count)
        ]
        env.close()
    return stacked(columns, 1)


def stacked(frames: list[NDArray[np.uint8]], axis: int) -> NDArray[np.uint8]:
    """Return frames side by side along an axis, with white between them."""
    pads = [(0, 0), (0, 0), (0, 0)]
    pads[axis] = (0, GAP)
    padded = [np.pad(f, pads, constant_values=255) for f in frames[:-1]]
    return np.concatenate([*padded, frames[-1]], axis)


def enlarged(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an image of twice the size, its pixels as they are."""
    return image.repeat(2, 0).repeat(2, 1)


if __name__ == "__main__":
    main()
