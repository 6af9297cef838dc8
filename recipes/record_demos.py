"""Record demonstrations of a task's scripted expert as a LeRobot v3 data set.

    uv run recipes/record_demos.py domain=sim episodes=60 out=demos/sim
    uv run recipes/record_demos.py domain=stand_in episodes=20 out=demos/stand_in
    uv run recipes/record_demos.py out=demos/seen camera=agentview image_size=64

The domain ``stand_in`` is a second simulator that plays the robot's part. With a
robot at hand, record there instead, with LeRobot, and give that folder to sft.py.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rlco.config import REQUIRED, option
from rlco.errors import ConfigError, RlcoError
from rlco.run import run_recipe

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rlco.physics.domain import Domain
    from rlco.physics.task import Task

log = logging.getLogger("rlco.record_demos")


@dataclass
class Config:
    """Options of record_demos.py."""

    out: str = option(REQUIRED, "new folder for the data set")
    task: str = option("push_cube", "name of the task")
    domain: str = option("sim", "where to record: sim or stand_in")
    episodes: int = option(60, "successful episodes to keep", minimum=1)
    noise: float = option(
        0.1, "noise of the commands, in units of their range", minimum=0, maximum=1
    )
    seed: int = option(0, "seed of initial states and noise", minimum=0)
    effects: str | None = option(None, "effects.yaml: what to add to the simulator")
    camera: str | None = option(
        None, "camera to record, such as agentview; null: no pictures"
    )
    image_size: int | None = option(None, "side of its pictures [pixels]", minimum=16)
    video: bool = option(False, "keep pictures as video, small and lossy, not as PNG")


def record(config: Config) -> int:
    """Record; return the number of frames."""
    from tqdm import tqdm

    from rlco.data import DemoWriter
    from rlco.physics.domain import make_domain
    from rlco.physics.observation import ACTION_NAMES, STATE_NAMES
    from rlco.physics.robosuite_tasks import PREFIX
    from rlco.physics.task import make_task

    if config.task.startswith(PREFIX):
        raise RlcoError(
            f"task {config.task!r} is robosuite's and has no scripted expert; record "
            "demonstrations of it elsewhere and give their LeRobot folder to sft.py."
        )
    task, domain = make_task(config.task), make_domain(config.domain)
    demonstrations = played(config, task, domain)
    size = config.image_size
    frames = 0
    with DemoWriter(
        config.out,
        fps=task.control_frequency,
        state_names=STATE_NAMES,
        environment_state_names=task.environment_state_names,
        action_names=ACTION_NAMES,
        robot_type=f"panda_{domain.name}",
        camera=config.camera,
        image_size=None if size is None else (size, size),
        video=config.video,
    ) as writer:
        for demonstration, pictures in tqdm(
            demonstrations, "episodes", total=config.episodes, disable=None
        ):
            for state, environment_state, action, image in zip(
                demonstration.state,
                demonstration.environment_state,
                demonstration.action,
                pictures,
                strict=True,
            ):
                writer.add_frame(
                    state=state,
                    environment_state=environment_state,
                    action=action,
                    task=demonstration.instruction,
                    image=image,
                )
            writer.save_episode()
            frames += len(demonstration.action)
    return frames


def played(config: Config, task: Task, domain: Domain) -> Iterator[tuple[Any, Any]]:
    """Return demonstrations, each with its pictures: None a frame without a camera."""
    from rlco.data import film_demonstrations
    from rlco.physics.demonstrate import demonstrate

    options: dict[str, Any] = {
        "episodes": config.episodes,
        "seed": config.seed,
        "noise": config.noise,
        "effects": config.effects,
    }
    if (config.camera is None) != (config.image_size is None):
        raise ConfigError(
            ["camera and image_size belong together; give both or neither"]
        )
    if config.camera is None or config.image_size is None:
        plain = demonstrate(task, domain, **options)
        return ((one, [None] * len(one.action)) for one in plain)
    size = (config.image_size, config.image_size)
    return film_demonstrations(
        task, domain, camera=config.camera, image_size=size, **options
    )


def main(config: Config) -> None:
    """Record, then say what was recorded."""
    frames = record(config)
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
