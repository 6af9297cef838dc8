"""Record demonstrations of a task's scripted expert as a LeRobot v3 data set.

    uv run recipes/record_demos.py domain=sim episodes=60 out=demos/sim
    uv run recipes/record_demos.py domain=stand_in episodes=20 out=demos/stand_in
    uv run recipes/record_demos.py domain=gap_report/effects.yaml out=demos/corrected
    uv run recipes/record_demos.py out=demos/images camera=agentview image_size=64

The domain ``stand_in`` is a second simulator that plays the robot's part. With a
robot at hand, record there instead, with LeRobot, and give that folder to sft.py.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Literal

from rlco.errors import ConfigError
from rlco.run import run_recipe
from rlco.runs.config import LAST_SEED, REQUIRED, option

log = logging.getLogger("rlco.record_demos")


@dataclass
class Config:
    """Options of record_demos.py."""

    out: str = option(REQUIRED, "new folder for the data set")
    task: str = option("push_cube", "name of the task")
    domain: str = option(
        "sim",
        "where to record: sim, stand_in, locked, MODULE:NAME, or the path of an "
        "effects.yaml",
    )
    episodes: int = option(60, "successful episodes to keep", minimum=1)
    noise: float = option(
        0.1, "noise of the commands, in units of their range", minimum=0, maximum=1
    )
    seed: int = option(
        0, "seed of initial states and noise", minimum=0, maximum=LAST_SEED
    )
    effects: str | None = option(
        None, "effects.yaml: what to add to the domain's simulator"
    )
    effects_code: str | None = option(
        None, "Python file that registers effects of your own"
    )
    camera: str | None = option(
        None,
        "camera to record, such as agentview, or several: "
        "agentview,robot0_eye_in_hand; null: no images",
    )
    image_size: int | None = option(None, "side of its images [pixels]", minimum=16)
    look: str | None = option(
        None,
        "how images look: sim, stand_in, locked, or random for another look in each "
        "episode; null: as the domain says",
    )
    renderer: Literal["raster", "opengl"] = option(
        "raster", "what draws them: rlco's own renderer, or OpenGL"
    )
    video: bool = option(False, "keep images as video, small and lossy, not as PNG")


def main(config: Config) -> None:
    """Record, then say what was recorded."""
    from rlco.data import record_demonstrations
    from rlco.physics.effects import load_code
    from rlco.training.options.policy_options import camera_list, check_look

    load_code(config.effects_code)
    check_look(config.look, config.image_size)
    if config.camera is None and config.video:
        raise ConfigError(
            ["video=true is of images, but none are recorded; give camera=agentview"]
        )
    cameras = camera_list(config.camera or "")
    frames = record_demonstrations(
        config.out,
        config.task,
        config.domain,
        episodes=config.episodes,
        seed=config.seed,
        noise=config.noise,
        effects=config.effects,
        # One alone is named as it always was.
        camera=cameras if len(cameras) > 1 else config.camera,
        look=config.look,
        image_size=config.image_size,
        renderer=config.renderer,
        video=config.video,
    )
    log.info(
        "recorded %d episodes, %d frames of %s in %s: %s",
        config.episodes,
        frames,
        config.task,
        config.domain,
        config.out,
    )


if __name__ == "__main__":
    run_recipe(main, Config)
