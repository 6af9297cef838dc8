"""Demonstrations by a task's scripted expert, with a camera's images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rlco.physics.effects.corrected_model import Given
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.spec.domain import GivenDomain, make_domain, with_look
from rlco.physics.spec.looks import GivenLook
from rlco.physics.spec.names import Renderer
from rlco.physics.spec.task import Task
from rlco.physics.tasks.demonstrate import (
    Demonstration,
    ExpertError,
    demonstrate,
)
from rlco.physics.tasks.views import Views
from rlco.reporting.video import write_video

Images = NDArray[np.uint8]
_ONE = np.zeros(1, np.int64)  # the only world


def film_demonstrations(
    task: Task,
    domain: GivenDomain,
    *,
    camera: str | Sequence[str],
    image_size: tuple[int, int],
    episodes: int,
    seed: int,
    noise: float = 0.1,
    effects: Given = None,
    renderer: Renderer = "opengl",
    look: GivenLook | None = None,
) -> Iterator[tuple[Demonstration, Any]]:
    """Yield demonstrations, as `demonstrate` does, each with camera images.

    Each demonstration is played once more for the camera: drawing takes most of the
    time, and so none is spent on episodes that are dropped, nor on what follows a
    demonstration's end.

    Args:
        task: The task.
        domain: Where it is recorded; its camera stands where the domain says.
        camera: Name of one of the model's cameras, or a list of several names.
        image_size: Height and width of the images [pixels].
        episodes: Successful episodes to yield.
        seed: Draws initial states, sensor noise and command noise.
        noise: Standard deviation of command noise, in units of the action's range.
        effects: Effects to add to the model, see `rlco.envs.make_env`.
        renderer: What draws the images, ``raster`` or ``opengl``.
        look: How they look, see `rlco.envs.make_env`; None: as the domain says.

    Returns:
        Demonstrations of L control steps, each with uint8 (L, 3, height, width), or
        with a map from cameras' names to such where several are named.

    Raises:
        RenderingError: Nothing can render.
        UnknownNameError: The model has no such camera.
        RlcoError: If a camera is named twice, or if the expert fails in more than half
            of many episodes.
    """
    domain = with_look(make_domain(domain), look)
    stage = NativeStepper(task, domain, num_envs=1, effects=effects)
    names = [camera] if isinstance(camera, str) else camera
    views = Views(stage, domain.look, image_size, cameras=names, renderer=renderer)
    demonstrations = demonstrate(
        task, domain, episodes=episodes, seed=seed, noise=noise, effects=effects
    )

    def films() -> Iterator[tuple[Demonstration, Any]]:
        for one in demonstrations:
            images = _film(stage, views, task, seed, one)
            yield one, images[camera] if isinstance(camera, str) else images

    return films()


def film_failure(
    path: Path,
    task: Task,
    domain: GivenDomain,
    failure: ExpertError,
    *,
    effects: Given = None,
    image_size: tuple[int, int] = (240, 320),
) -> None:
    """Write the episode of an expert's failure as an mp4 video, in real time.

    Args:
        path: The video.
        task: The task.
        domain: Where the expert failed.
        failure: What `demonstrate` raised.
        effects: The effects that were added to the model.
        image_size: Height and width of the frames [pixels].

    Raises:
        RenderingError: Nothing can render.
    """
    stage = NativeStepper(task, domain, num_envs=1, effects=effects)
    views = Views(stage, stage.domain.look, image_size)
    played = failure.episode.demonstration
    (images,) = _film(stage, views, task, failure.seed, played).values()
    write_video(path, images.transpose(0, 2, 3, 1), task.control_frequency)


def _film(
    stage: NativeStepper,
    views: Views,
    task: Task,
    seed: int,
    played: Demonstration,
) -> dict[str, Images]:
    """Return images of each state in which an action was taken, by camera.

    Args:
        stage: One world.
        views: Its cameras.
        task: The task.
        seed: Of its episodes: with the episode's number it draws how it starts, its
            look and the noise of its images.
        played: What happens in it.
    """
    views.start(_ONE, seed, [played.episode])
    rng = np.random.default_rng([seed, played.episode])
    stage.reset([task.initial_state(rng)])
    images: dict[str, list[Images]] = {name: [] for name in views.images}
    for step, action in enumerate(played.action):
        views.draw(_ONE, np.array([step]))
        for name, frames in views.images.items():
            images[name].append(frames[0].copy())
        stage.step(action[None, None])
    return {name: np.stack(frames) for name, frames in images.items()}
