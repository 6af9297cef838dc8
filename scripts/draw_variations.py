"""Draw docs/figures/variations.png: every variation of every task, one frame each.

uv run scripts/draw_variations.py
"""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as imageio
import numpy as np

from rlco import keys
from rlco.reporting.headless import choose_gl

FIGURE = Path(__file__).parents[1] / "docs" / "figures" / "variations.png"
SIZE = (180, 240)


def main() -> None:
    """Draw a row for each task, a column for each variation but that of the camera."""
    choose_gl()
    from rlco.envs import make_env
    from rlco.physics.spec.names import TASK_NAMES
    from rlco.physics.tasks.make_task import make_task

    rows = []
    for name in TASK_NAMES:
        frames = []
        for variation in make_task(name).variations:
            if variation == "camera":
                continue
            env = make_env(
                name,
                variation=variation,
                image_size=SIZE,
                image_quality="robosuite",
                seed=3,
            )
            frames.append(env.reset()[keys.IMAGE][0].permute(1, 2, 0).numpy())
            env.close()
        rows.append(np.concatenate(frames, axis=1))
    imageio.imwrite(FIGURE, np.concatenate(rows))


if __name__ == "__main__":
    main()
