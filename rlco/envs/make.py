"""One call that builds a task's environment in a domain, on a backend."""

from __future__ import annotations

from typing import Literal

import numpy as np

from rlco.envs.tabletop_env import RewardKind, Stepper, TabletopEnv
from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.domain import Domain, make_domain
from rlco.physics.native import NativeStepper
from rlco.physics.robosuite_stepper import RobosuiteStepper
from rlco.physics.task import Task, make_task

Backend = Literal["native", "robosuite"]


def make_env(
    task: str | Task,
    *,
    domain: str | Domain = "sim",
    backend: Backend = "native",
    num_envs: int = 1,
    chunk: int = 1,
    reward: RewardKind = "shaped",
    horizon: int | None = None,
    image_size: tuple[int, int] | None = None,
    variation: str | None = None,
    effects: object | None = None,
    seed: int = 0,
    threads: int | None = None,
) -> TabletopEnv:
    """Return a batch of a task's episodes as one TorchRL environment.

    Args:
        task: A task or its name.
        domain: A domain or its name: ``sim`` or ``stand_in``.
        backend: ``native`` steps the model in threads; ``robosuite`` lets robosuite
            step, about six times slower. The motion is the same.
        num_envs: Batch size N.
        chunk: Control steps H a decision; actions have shape (N, H, 7).
        reward: ``shaped`` or ``sparse``.
        horizon: Episode length in control steps; the task's own by default.
        image_size: Height and width of camera frames; None: no images.
        variation: A named variation of the initial states.
        effects: Physical effects to add to the model; none are known yet.
        seed: Draws initial states and sensor noise.
        threads: Threads of the native backend; by default one a core.

    Raises:
        UnknownNameError: If a name is unknown.
        RlcoError: If a number is out of range.
        RenderingError: If images are asked for and nothing can render.

    Example:
        >>> env = make_env("push_cube", num_envs=2, chunk=4, seed=1)
        >>> rollout = env.rollout(3)
        >>> rollout["action"].shape  # (environments, decisions, control steps, 7)
        torch.Size([2, 3, 4, 7])
        >>> rollout["observation", "state"].shape
        torch.Size([2, 3, 7])
    """
    task, domain = make_task(task), make_domain(domain)
    if backend not in ("native", "robosuite"):
        raise UnknownNameError("backend", backend, ["native", "robosuite"])
    if reward not in ("shaped", "sparse"):
        raise UnknownNameError("reward", reward, ["shaped", "sparse"])
    for name, value in (("num_envs", num_envs), ("chunk", chunk), ("horizon", horizon)):
        if value is not None and value < 1:
            raise RlcoError(f"{name}={value} is not allowed; give 1 or more.")
    if seed < 0:
        raise RlcoError(f"seed={seed} is not allowed; give 0 or more.")
    if image_size is not None and (len(image_size) != 2 or min(image_size) < 1):
        raise RlcoError(
            f"image_size={image_size} is not allowed; give (height, width) in pixels."
        )
    if effects is not None:
        raise RlcoError(
            "effects= is not supported yet; leave it out, and put what MJCF can hold "
            "into a Domain of your own."
        )
    # An unknown variation shows before anything is built.
    task.sample(np.random.default_rng(seed), variation)
    stepper: Stepper
    if backend == "native":
        stepper = NativeStepper(task, domain, num_envs=num_envs, threads=threads)
    else:
        stepper = RobosuiteStepper(task, domain, num_envs=num_envs)
    return TabletopEnv(
        task,
        domain,
        stepper,
        num_envs=num_envs,
        chunk=chunk,
        reward=reward,
        horizon=horizon,
        image_size=image_size,
        variation=variation,
        seed=seed,
    )
