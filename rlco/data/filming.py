"""Demonstrations by a task's scripted expert, with a camera's images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rlco.physics.effects.corrected_model import Given
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.rendering.camera import Camera
from rlco.physics.rendering.raster import RasterCamera
from rlco.physics.rendering.renderers import make_camera
from rlco.physics.spec.domain import GivenDomain
from rlco.physics.spec.names import Renderer
from rlco.physics.spec.task import InitialState, SceneState, Task
from rlco.physics.tasks.demonstrate import (
    Demonstration,
    ExpertError,
    demonstrate,
)
from rlco.reporting.video import write_video

Images = NDArray[np.uint8]
SIDE_BY_SIDE = 20  # episodes of the expert that run at once, at most


def film_demonstrations(
    task: Task,
    domain: GivenDomain,
    *,
    camera: str,
    image_size: tuple[int, int],
    episodes: int,
    seed: int,
    noise: float = 0.1,
    effects: Given = None,
    renderer: Renderer = "opengl",
) -> Iterator[tuple[Demonstration, Images]]:
    """Yield demonstrations, as `demonstrate` does, each with camera images.

    Each demonstration is played once more for the camera: drawing takes most of the
    time, and so none is spent on episodes that are dropped, nor on what follows a
    demonstration's end.

    Args:
        task: The task.
        domain: Where it is recorded; its camera stands where the domain says.
        camera: Name of one of the model's cameras.
        image_size: Height and width of the images [pixels].
        episodes: Successful episodes to yield.
        seed: Draws initial states, sensor noise and command noise.
        noise: Standard deviation of command noise, in units of the action's range.
        effects: Effects to add to the model, see `rlco.envs.make_env`.
        renderer: What draws the images, ``raster`` or ``opengl``.

    Returns:
        Demonstrations of L control steps, each with uint8 (L, 3, height, width).

    Raises:
        RenderingError: Nothing can render.
        UnknownNameError: The model has no such camera.
        RlcoError: If the expert fails in more than half of many episodes.
    """
    stage = NativeStepper(task, domain, num_envs=1, effects=effects)
    eye = make_camera(stage.model, image_size, camera, renderer=renderer)
    watch = _Watch(task, min(SIDE_BY_SIDE, episodes))
    demonstrations = demonstrate(
        watch.task,
        domain,
        episodes=episodes,
        seed=seed,
        noise=noise,
        num_envs=watch.count,
        effects=effects,
    )
    return (
        (one, _film(stage, eye, watch.start_of(one), one)) for one in demonstrations
    )


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
    eye = Camera(stage.model, image_size)
    episode = failure.episode
    rng = np.random.default_rng([failure.seed, episode.number])
    images = _film(stage, eye, task.sample(rng, None), episode.demonstration)
    write_video(path, images.transpose(0, 2, 3, 1), task.control_frequency)


class _Watch:
    """Remembers how the expert's episodes start, and which of them succeed."""

    def __init__(self, task: Task, count: int) -> None:
        self.count = count
        self._inner = task
        self._starts: list[InitialState] = []
        self._success: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._batch, self._next = 0, 0
        self.task = replace(task, sample=self._sample, success=self._solved)

    def _sample(self, rng: np.random.Generator, variation: str | None) -> InitialState:
        self._starts.append(self._inner.sample(rng, variation))
        return self._starts[-1]

    def _solved(self, state: SceneState) -> NDArray[np.bool_]:
        self._success = self._inner.success(state)
        return self._success

    def start_of(self, demonstration: Demonstration) -> InitialState:
        """Return how the demonstration that was just yielded started.

        They come in the order of their batch. One that succeeded and was passed over
        has an instruction that no later one has.
        """
        if len(self._starts) != self._batch:
            self._batch, self._next = len(self._starts), 0
        texts, batch = self._inner.instructions, self._starts[-self.count :]
        while not (
            self._success[self._next]
            and texts[batch[self._next].instruction_id] == demonstration.instruction
        ):
            self._next += 1
        self._next += 1
        return batch[self._next - 1]


def _film(
    stage: NativeStepper,
    eye: Camera | RasterCamera,
    start: InitialState,
    played: Demonstration,
) -> Images:
    """Return an image of each state in which an action was taken."""
    stage.reset([start])
    images = []
    for action in played.action:
        images.append(eye.frame(stage.data[0]))
        stage.step(action[None, None])
    return np.stack(images)
