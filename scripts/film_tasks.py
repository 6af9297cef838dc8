"""Film the scripted expert of each task for docs/gallery.

uv run scripts/film_tasks.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rlco.reporting.headless import choose_gl
from rlco.reporting.video import write_video

GALLERY = Path(__file__).parents[1] / "docs" / "gallery"
SIZE = (240, 320)


def main() -> None:
    """Write one film for each task."""
    choose_gl()
    from rlco.physics.spec.names import TASK_NAMES

    for name in TASK_NAMES:
        frames = film(name)
        path = GALLERY / f"{name}.mp4"
        write_video(path, frames, 20.0)
        print(f"{path.name}: {len(frames)} frames, {path.stat().st_size / 1e3:.0f} kB")


def film(name: str) -> np.ndarray:
    """Return an episode of the expert in sim, shape (T, height, width, 3), uint8."""
    from rlco.data.filming import film_demonstrations
    from rlco.physics.tasks.make_task import make_task

    given = {"camera": "agentview", "image_size": SIZE, "episodes": 1, "seed": 3}
    ((_, images),) = film_demonstrations(make_task(name), "sim", noise=0.0, **given)
    return np.transpose(images, (0, 2, 3, 1))


if __name__ == "__main__":
    main()
