"""A data set of demonstrations of a task's scripted expert."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

from tqdm import tqdm

from rlco.data.filming import film_demonstrations, film_failure
from rlco.data.recording import DemoWriter
from rlco.errors import ConfigError, RenderingError, RlcoError
from rlco.physics.effects.corrected_model import Given
from rlco.physics.rendering.renderers import check_renderer
from rlco.physics.robosuite.options import PREFIX
from rlco.physics.spec.domain import Domain, GivenDomain, make_domain, with_look
from rlco.physics.spec.look import Look
from rlco.physics.spec.look_file import content_of_look
from rlco.physics.spec.looks import RANDOM, GivenLook
from rlco.physics.spec.names import Renderer
from rlco.physics.spec.task import Task
from rlco.physics.tasks.demonstrate import (
    Demonstration,
    ExpertError,
    demonstrate,
)
from rlco.physics.tasks.make_task import make_task
from rlco.runs.whole_files import check_new_folder

log = logging.getLogger("rlco.data")


def record_demonstrations(
    path: str | Path,
    task: str,
    domain: GivenDomain,
    *,
    episodes: int,
    seed: int,
    noise: float = 0.1,
    effects: Given = None,
    camera: str | Sequence[str] | None = None,
    image_size: int | None = None,
    renderer: Renderer = "opengl",
    video: bool = False,
    look: GivenLook | None = None,
) -> int:
    """Record demonstrations of a task's expert as a LeRobot v3 data set.

    Args:
        path: The new folder.
        task: The task's name.
        domain: Where to record: a domain, its name or file.
        episodes: Successful episodes to keep.
        seed: Draws initial states and noise.
        noise: Of the commands, in units of their range.
        effects: Effects to add to the simulator, see `rlco.envs.make_env`.
        camera: Camera to record, or a list of several; None: no images.
        image_size: Side of its images [pixels].
        renderer: What draws them, ``raster`` or ``opengl``.
        video: Keep images as video, small and lossy, not as PNG.
        look: How images look, see `rlco.envs.make_env`; None: as the domain says.

    Returns:
        The number of frames.

    Raises:
        OutputExistsError: The folder exists; nothing in it was touched.
        RlcoError: The task has no expert, or the expert fails too often; then a film of
            a failure lies beside the folder, where anything can render.
        ConfigError: A camera without a size, or the other way round.
        RenderingError: Images are asked for and nothing can render.
    """
    if task.startswith(PREFIX):
        raise RlcoError(
            f"task {task!r} is robosuite's and has no scripted expert; record "
            "demonstrations of it elsewhere and give their LeRobot folder to sft.py."
        )
    check_new_folder(Path(path))
    check_renderer(renderer)
    what, where = make_task(task), with_look(make_domain(domain), look)
    given: dict[str, Any] = {
        "episodes": episodes,
        "seed": seed,
        "noise": noise,
        "effects": effects,
    }
    size = None if image_size is None else (image_size, image_size)
    demonstrations = _played(what, where, camera, size, renderer, given)
    frames = 0
    with _filmed_failure(Path(path), what, where, effects):
        # Effects that cannot be are noticed by the first one, before there is a folder.
        played = chain([next(demonstrations)], demonstrations)
        writer = DemoWriter(
            path,
            fps=what.control_frequency,
            state_names=what.state_names,
            environment_state_names=what.environment_state_names,
            action_names=what.action_names,
            robot_type=f"{what.robot.name.lower()}_{where.name}",
            camera=camera,
            image_size=size,
            video=video,
            recorded=_description(task, where, camera, renderer, given),
        )
        with writer:
            for demonstration, images in tqdm(
                played, "episodes", total=episodes, disable=None
            ):
                _write(writer, demonstration, images)
                frames += len(demonstration.action)
    return frames


def _description(
    task: str,
    domain: Domain,
    camera: str | Sequence[str] | None,
    renderer: Renderer,
    given: dict[str, Any],
) -> dict[str, Any]:
    """Return how a data set was recorded, in types of JSON."""
    found = {
        "task": task,
        "domain": domain.name,
        "seed": given["seed"],
        "noise": given["noise"],
    }
    if camera is None:
        return found
    cameras = [camera] if isinstance(camera, str) else list(camera)
    look = domain.look
    drawn = content_of_look(look) if isinstance(look, Look) else RANDOM
    return found | {"renderer": renderer, "cameras": cameras, "look": drawn}


@contextmanager
def _filmed_failure(
    path: Path, task: Task, domain: Domain, effects: Given
) -> Iterator[None]:
    """Film an episode where an expert fails, and say where the film lies."""
    try:
        yield
    except ExpertError as failure:
        film = path.with_name(f"{path.name}_episode_{failure.episode.number}.mp4")
        try:
            film_failure(film, task, domain, failure, effects=effects)
        except RenderingError:
            raise failure from None  # its reason is enough, without a film
        raise RlcoError(
            f"{failure.reason}; look at {film}, then correct the expert or the domain."
        ) from failure


def record_once(path: Path, task: str, domain: GivenDomain, **options: Any) -> None:
    """Record as `record_demonstrations` does, unless the folder is there already.

    A recording that was cut off is made anew: it has another name until it is whole.
    """
    if path.exists():
        return
    part = path.with_suffix(".part")
    shutil.rmtree(part, ignore_errors=True)
    frames = record_demonstrations(part, task, domain, **options)
    part.rename(path)
    log.info("recorded %d episodes, %d frames: %s", options["episodes"], frames, path)


def _played(
    task: Task,
    domain: Domain,
    camera: str | Sequence[str] | None,
    size: tuple[int, int] | None,
    renderer: Renderer,
    given: dict[str, Any],
) -> Iterator[tuple[Demonstration, Any]]:
    """Return demonstrations, each with its frames' images: None without a camera.

    An image is a map by camera where there is a list of cameras.
    """
    if (camera is None) != (size is None):
        raise ConfigError(
            ["camera and image_size belong together; give both or neither"]
        )
    if camera is None or size is None:
        plain = demonstrate(task, domain, **given)
        return ((one, [None] * len(one.action)) for one in plain)
    filmed = film_demonstrations(
        task, domain, camera=camera, image_size=size, renderer=renderer, **given
    )
    if isinstance(camera, str):
        return filmed
    return ((one, _by_frame(images)) for one, images in filmed)


def _by_frame(images: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a map by camera for each frame of a film by each camera."""
    frames = zip(*images.values(), strict=True)
    return [dict(zip(images, frame, strict=True)) for frame in frames]


def _write(writer: DemoWriter, demonstration: Demonstration, images: Any) -> None:
    """Write one episode."""
    for state, environment_state, action, image in zip(
        demonstration.state,
        demonstration.environment_state,
        demonstration.action,
        images,
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
