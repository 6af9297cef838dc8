"""The plain robosuite environment of a task, by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rlco.physics.effects import load_code
from rlco.physics.robosuite.tabletop import Tabletop
from rlco.physics.spec.domain import GivenDomain, make_domain
from rlco.physics.spec.task import Task
from rlco.physics.tasks.make_task import make_task


def make_robosuite(
    task: str | Task,
    *,
    domain: GivenDomain = "sim",
    seed: int = 0,
    image_size: tuple[int, int] | None = None,
    effects_code: str | Path | None = None,
) -> Tabletop:
    """Return the plain robosuite environment of a task, at an episode's start.

    Args:
        task: A task or its name.
        domain: A domain, its name, or the path of its file.
        seed: Determines the episode that the environment starts in.
        image_size: Height and width of camera frames; None: no rendering.
        effects_code: Python file that registers effects of your own.

    Raises:
        UnknownNameError: If the task or the domain is unknown.
        RlcoError: If the domain's file cannot be read, or an effect cannot be applied.

    Example:
        >>> env = make_robosuite("push_cube", seed=3)
        >>> env.scene_state().object_position.shape
        (3, 3)
    """
    load_code(effects_code)
    env = Tabletop(make_task(task), make_domain(domain), image_size=image_size)
    env.start(env.task.initial_state(np.random.default_rng(seed)))
    return env
