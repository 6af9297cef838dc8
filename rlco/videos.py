"""Videos of a policy's episodes, and images of a scene, to be looked at."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rlco import keys
from rlco.envs import make_env
from rlco.evaluation import EVALUATION_SEED, read_by
from rlco.physics.spec.domain import GivenDomain, make_domain
from rlco.physics.spec.names import Renderer
from rlco.reporting.video import write_video

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Film:
    """One filmed episode.

    Attributes:
        frames: One image per decision, (height, width, 3) each.
        period: Time between two frames [s].
        instruction: What the policy was asked to do.
    """

    frames: list[NDArray[np.uint8]]
    period: float
    instruction: str

    def strip(self, domain: str, method: str, count: int = 5) -> Figure:
        """Return a figure of about so many frames, with their times."""
        from rlco.reporting.image_plots import episode_strip

        some = range(0, len(self.frames), max(1, len(self.frames) // count))
        return episode_strip(
            [self.frames[i] for i in some],
            [i * self.period for i in some],
            domain,
            policy=method,
            instruction=self.instruction,
        )


def record_video(
    policy: Any,
    task: str,
    domain: GivenDomain,
    path: Path,
    *,
    chunk: int,
    index: int = 0,
    image_size: tuple[int, int] = (240, 320),
    renderer: str | None = None,
    **options: Any,
) -> Film:
    """Write one episode as an mp4 video, one frame per decision; return what it shows.

    Of a policy that reads images the video shows those, enlarged, of several cameras
    beside each other.

    Args:
        policy: Writes `action`; its most likely action is taken.
        task: The task's name.
        domain: Where to play.
        path: The video.
        chunk: Control steps of a decision.
        index: Number of the episode.
        image_size: Height and width of the frames of a policy that reads none.
        renderer: What draws the images that a policy reads; None: what it was trained
            with. Frames of a policy that reads none are OpenGL's.
        **options: Further options of `make_env` (``backend``, ``variation``,
            ``effects``, ``seed``): the same as in the evaluation, for its episode.

    Raises:
        RenderingError: If no renderer is available.
    """
    image_read = getattr(policy, "image_size", None)
    drawn: dict[str, Any] = {"image_size": image_size, "image_quality": "robosuite"}
    if image_read:
        drawn = read_by(policy, renderer)
    env = make_env(
        task,
        domain=domain,
        chunk=chunk,
        **drawn,
        **{"seed": EVALUATION_SEED, **options},
    )
    env.start_at(index)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        rollout = env.rollout(-(-env.horizon // chunk), policy)
    read = [
        torch.cat([rollout[key][0, :1], rollout["next", *key][0]])
        for key in keys.image_keys(drawn.get("cameras", ("agentview",)))
    ]
    images = torch.cat(read, -1)
    times = max(1, image_size[0] // image_read[0]) if image_read else 1
    images = images.repeat_interleave(times, -1).repeat_interleave(times, -2)
    frames = list(images.permute(0, 2, 3, 1).numpy())
    instruction = env.task.instructions[int(rollout[keys.INSTRUCTION_ID][0, 0])]
    env.close()
    period = chunk / env.task.control_frequency
    write_video(path, np.stack(frames), 1.0 / period)
    return Film(frames, period, instruction)


def same_scene(
    task: str,
    domains: Iterable[GivenDomain],
    *,
    cameras: Sequence[str] = ("agentview",),
    image_size: tuple[int, int] = (64, 64),
    renderer: Renderer = "raster",
    index: int = 0,
) -> dict[str, dict[str, NDArray[np.uint8]]]:
    """Return what cameras see as an episode starts, in several domains.

    Args:
        task: The task's name.
        domains: Where it starts, each time from the same state.
        cameras: Names of the model's cameras.
        image_size: Height and width of the images [pixels].
        renderer: What draws them.
        index: Number of the episode.

    Returns:
        Images (height, width, 3) by camera and domain.

    Raises:
        RenderingError: If no renderer is available.
    """
    images: dict[str, dict[str, NDArray[np.uint8]]] = {name: {} for name in cameras}
    for domain in map(make_domain, domains):
        env = make_env(
            task,
            domain=domain,
            image_size=image_size,
            cameras=cameras,
            renderer=renderer,
            seed=EVALUATION_SEED,
        )
        env.start_at(index)
        start = env.reset()
        for name, key in zip(cameras, keys.image_keys(cameras), strict=True):
            images[name][domain.name] = start[key][0].permute(1, 2, 0).numpy()
        env.close()
    return images
