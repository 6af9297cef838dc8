"""One call that builds a task's environment in a domain, on a backend."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from rlco.envs.chunk_env import ON_DIVERGENCE, ChunkEnv, OnDivergence, RewardKind
from rlco.envs.robosuite_env import make_robosuite_env
from rlco.envs.tabletop_env import Stepper, TabletopEnv
from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.camera import Quality, check_quality
from rlco.physics.copy_checks import check_native
from rlco.physics.domain import Domain, make_domain
from rlco.physics.mended_model import Given, given_effects
from rlco.physics.native import NativeStepper
from rlco.physics.robosuite_options import PREFIX
from rlco.physics.robosuite_stepper import RobosuiteStepper
from rlco.physics.task import Task, make_task
from rlco.physics.variations import check_variation_of, domain_in

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
    image_quality: Quality = "fast",
    variation: str | None = None,
    effects: Given = None,
    seed: int = 0,
    threads: int | None = None,
    exact: bool = False,
    on_divergence: OnDivergence = "reset",
    robosuite_options: Mapping[str, Any] | None = None,
) -> ChunkEnv:
    """Return a batch of a task's episodes as one TorchRL environment.

    Args:
        task: A task or its name; ``robosuite:Lift`` is robosuite's own Lift.
        domain: A domain or its name: ``sim`` or ``stand_in``.
        backend: ``native`` steps the model in threads; ``robosuite`` lets robosuite
            step, about six times slower. The motion is the same up to
            rounding, which contacts enlarge; with ``exact=True`` to the last bit.
        num_envs: Batch size N.
        chunk: Control steps H a decision; actions have shape (N, H, 7).
        reward: ``shaped`` or ``sparse``.
        horizon: Episode length in control steps; the task's own by default.
        image_size: Height and width of camera frames; None: no images.
        image_quality: ``fast``, or ``robosuite`` for robosuite's own pixels, about ten
            times slower.
        variation: A named variation of the scene, one of the task's.
        effects: Physical effects to add to the model: a list of
            `rlco.physics.effects.AppliedEffect`, or the path of an ``effects.yaml``.
            The robot's controller does not know of them.
        seed: Draws initial states and sensor noise.
        threads: Threads of the native backend; by default one a core.
        exact: Let the native backend compute with robosuite's own linear algebra,
            about a third slower.
        on_divergence: What to do with an environment whose simulation diverges:
            ``reset`` it and count it, see `rlco.envs.chunk_env.ChunkEnv`, or ``raise``.
        robosuite_options: robosuite's own, for its own tasks of one arm:
            ``{"robots": "UR5e"}``.

    Raises:
        UnknownNameError: If a name is unknown.
        RlcoError: If a number is out of range, options do not go together, or an
            effect cannot be applied.
        DataError: If the effects' file cannot be read.
        RenderingError: If images are asked for and nothing can render.

    Example:
        >>> env = make_env("push_cube", num_envs=2, chunk=4, seed=1)
        >>> rollout = env.rollout(3)
        >>> rollout["action"].shape  # (environments, decisions, control steps, 7)
        torch.Size([2, 3, 4, 7])
        >>> rollout["observation", "state"].shape
        torch.Size([2, 3, 7])
    """
    if backend not in ("native", "robosuite"):
        raise UnknownNameError("backend", backend, ["native", "robosuite"])
    if reward not in ("shaped", "sparse"):
        raise UnknownNameError("reward", reward, ["shaped", "sparse"])
    if on_divergence not in ON_DIVERGENCE:
        raise UnknownNameError("on_divergence", on_divergence, ON_DIVERGENCE)
    for name, value in (("num_envs", num_envs), ("chunk", chunk), ("horizon", horizon)):
        if value is not None and value < 1:
            raise RlcoError(f"{name}={value} is not allowed; give 1 or more.")
    if seed < 0:
        raise RlcoError(f"seed={seed} is not allowed; give 0 or more.")
    if image_size is not None and (len(image_size) != 2 or min(image_size) < 1):
        raise RlcoError(
            f"image_size={image_size} is not allowed; give (height, width) in pixels."
        )
    check_quality(image_quality)
    if image_quality != "fast" and image_size is None:
        raise RlcoError(
            f"image_quality={image_quality!r} is of no use without images; give "
            "image_size=(height, width), or leave it out."
        )
    check_native(backend, threads=threads, exact=exact)
    given = given_effects(effects)
    if isinstance(task, str) and task.startswith(PREFIX):
        _refuse_for_robosuite(task, domain, image_size, variation)
        return make_robosuite_env(
            task.removeprefix(PREFIX),
            backend=backend,
            num_envs=num_envs,
            chunk=chunk,
            reward=reward,
            horizon=horizon,
            seed=seed,
            threads=threads,
            exact=exact,
            on_divergence=on_divergence,
            options=robosuite_options or {},
            effects=given,
        )
    if robosuite_options:
        raise RlcoError(
            f"robosuite_options= is for robosuite's own tasks, such as {PREFIX}Lift; "
            "leave it out."
        )
    task, domain = make_task(task), make_domain(domain)
    check_variation_of(task, variation)
    domain = domain_in(domain, variation)
    stepper: Stepper
    if backend == "native":
        stepper = NativeStepper(
            task,
            domain,
            num_envs=num_envs,
            threads=threads,
            exact=exact,
            variation=variation,
            on_divergence="mark",
            effects=given,
        )
    else:
        stepper = RobosuiteStepper(
            task,
            domain,
            num_envs=num_envs,
            variation=variation,
            on_divergence="mark",
            effects=given,
        )
    return TabletopEnv(
        task,
        domain,
        stepper,
        num_envs=num_envs,
        chunk=chunk,
        reward=reward,
        horizon=horizon,
        image_size=image_size,
        image_quality=image_quality,
        variation=variation,
        seed=seed,
        on_divergence=on_divergence,
    )


def _refuse_for_robosuite(
    task: str,
    domain: str | Domain,
    image_size: tuple[int, int] | None,
    variation: str | None,
) -> None:
    for name, given, given_at_all in (
        ("domain", domain, domain != "sim"),
        ("image_size", image_size, image_size is not None),
        ("variation", variation, variation is not None),
    ):
        if given_at_all:
            raise RlcoError(
                f"{name}={given!r} is not supported for {task!r}, one of robosuite's "
                "own tasks; leave it out, or give one of rlco's tasks."
            )
