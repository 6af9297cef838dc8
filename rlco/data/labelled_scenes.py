"""Random scenes of a task as images, with the poses that only a simulator knows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

from rlco.errors import ConfigError
from rlco.keys import ENVIRONMENT_STATE, INSTRUCTION_ID, STATE, image_keys
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.rendering.renderers import check_renderer
from rlco.physics.spec.domain import GivenDomain, make_domain, with_look
from rlco.physics.spec.looks import GivenLook
from rlco.physics.spec.names import Renderer
from rlco.physics.spec.observation import noise_size, observe
from rlco.physics.spec.robot import POSITION
from rlco.physics.spec.sensors import Sensors
from rlco.physics.spec.task import Task
from rlco.physics.tasks.check_task import check_task
from rlco.physics.tasks.views import Views

#: Control steps between two scenes of an episode.
EVERY = 4
#: Command noise, in units of the action's range: the tool strays from the expert's
#: path, as that of a policy in training does.
NOISE = 0.3


def labelled_scenes(
    task: Task,
    count: int,
    *,
    seed: int,
    image_size: tuple[int, int],
    cameras: Sequence[str] = ("agentview",),
    domain: GivenDomain = "sim",
    look: GivenLook | None = "random",
    renderer: Renderer = "raster",
    every: int = EVERY,
    noise: float = NOISE,
    num_envs: int = 16,
    threads: int | None = None,
) -> TensorDict:
    """Return images of scenes along an expert's noisy paths, with the true poses.

    An episode gives one scene each `every` control steps, from a phase of its own, so
    many episodes contribute. Each has another layout, and with ``look="random"``
    another look. Rows have the keys of demonstrations (`rlco.data.load_demos`), without
    actions: ``("observation", "state")`` [S], ``("observation", "environment_state")``
    [E] and ``instruction_id`` [], both states without sensor noise; and images, uint8
    [3, height, width], see `rlco.keys.image_keys`. What is to be predicted from an
    image follows from both states:
    `rlco.policies.nets.positions.relative_positions`.

    Args:
        task: The task; its expert moves the robot.
        count: Scenes M. The first of them do not depend on how many follow.
        seed: Determines initial states, looks and noise.
        image_size: Height and width of the images [pixels].
        cameras: Names of the model's cameras.
        domain: The simulator: a domain, its name or file.
        look: How images look, see `rlco.envs.make_env`; None: as the domain says.
        renderer: What draws them, ``raster`` or ``opengl``.
        every: Control steps between two scenes of an episode.
        noise: Standard deviation of command noise, in units of the action's range.
        num_envs: Episodes that are stepped together; the rows do not depend on it.
        threads: Threads that step and draw; None: one a core.

    Returns:
        Rows [M], ordered by episode and then by time.

    Raises:
        ConfigError: A number is out of range, or the task's parts do not fit.
        UnknownNameError: No such camera, domain, look or renderer.
        RenderingError: Nothing can render.

    Example:
        >>> from rlco.physics.tasks.push_cube import TASK
        >>> rows = labelled_scenes(TASK, 5, seed=0, image_size=(64, 64), num_envs=2)
        >>> rows["observation", "image"].shape, rows["observation", "state"].shape
        (torch.Size([5, 3, 64, 64]), torch.Size([5, 7]))
    """
    numbers = {"count": count, "every": every, "num_envs": num_envs}
    if problems := [f"{k}={v} must be at least 1" for k, v in numbers.items() if v < 1]:
        raise ConfigError(problems)
    check_renderer(renderer)
    task, where = check_task(task), with_look(make_domain(domain), look)
    # No more episodes than a few scenes need: each has at least these.
    scenes = max((task.training_horizon or task.horizon) // every, 1)
    num_envs = min(num_envs, math.ceil(count / scenes))
    stepper = NativeStepper(task, where, num_envs=num_envs, threads=threads)
    views = Views(stepper, where.look, image_size, cameras=cameras, renderer=renderer)
    parts: list[TensorDict] = []
    first, found = 0, 0
    try:
        while found < count:
            part = _episodes(task, stepper, views, seed, first, every, noise)
            parts.append(part)
            first, found = first + num_envs, found + len(part)
    finally:
        views.close()
    rows: TensorDict = torch.cat(parts)
    return rows[:count]


def _episodes(
    task: Task,
    stepper: NativeStepper,
    views: Views,
    seed: int,
    first: int,
    every: int,
    noise: float,
) -> TensorDict:
    """Return the scenes of one episode of each world, ordered by episode."""
    worlds = np.arange(count := stepper.num_envs)
    views.start(worlds, seed, (first + worlds).tolist())
    rngs = [np.random.default_rng([seed, first + index]) for index in worlds.tolist()]
    state = stepper.reset([task.initial_state(rng) for rng in rngs])
    horizon = task.training_horizon or task.horizon
    shape = (horizon, len(task.action_names))
    jitter = noise * np.stack([rng.standard_normal(shape) for rng in rngs])
    jitter[..., POSITION.stop :] = 0.0  # as in demonstrations
    phase = np.array([rng.integers(every) for rng in rngs])
    # What is true, whatever the domain's sensors report.
    exact = replace(stepper.domain, sensors=Sensors())
    silent = np.zeros((count, noise_size(task)))
    episode: list[NDArray[np.int64]] = []
    columns: dict[Any, list[NDArray[Any]]] = {}
    names = list(views.images)
    for t in range(horizon):
        which = np.flatnonzero((t + phase) % every == 0)
        if which.size:
            views.draw(which, np.full(count, t))
            robot, environment = observe(task, exact, state, silent)
            row: dict[Any, NDArray[Any]] = {
                STATE: robot.astype(np.float32),
                ENVIRONMENT_STATE: environment.astype(np.float32),
                INSTRUCTION_ID: state.instruction_id,
            }
            for key, name in zip(image_keys(names), names, strict=True):
                row[key] = views.images[name]
            episode.append(which)
            for key, values in row.items():
                columns.setdefault(key, []).append(values[which])  # a copy
        command = np.clip(task.expert(state) + jitter[:, t], -1.0, 1.0)
        state = stepper.step(command[:, None]).at(np.s_[:, 1])
    order = torch.from_numpy(np.argsort(np.concatenate(episode), kind="stable"))
    rows = TensorDict(batch_size=[len(order)])
    for key, parts in columns.items():
        rows.set(key, torch.from_numpy(np.concatenate(parts))[order])
    return rows
