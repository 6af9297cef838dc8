"""One call that builds a task's environment in a domain, on a backend."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from rlco.envs.chunk_env import ON_DIVERGENCE, ChunkEnv, OnDivergence, RewardKind
from rlco.envs.robosuite_env import make_robosuite_env
from rlco.envs.tabletop_env import TabletopEnv
from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.effects import load_code
from rlco.physics.effects.corrected_model import Given
from rlco.physics.effects.effects_file import EffectsFile
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.native.world_checks import check_native
from rlco.physics.rendering.camera import Quality
from rlco.physics.rendering.image_size import check_image_size
from rlco.physics.rendering.renderers import check_renderer
from rlco.physics.robosuite.options import PREFIX
from rlco.physics.robosuite.stepper import RobosuiteStepper
from rlco.physics.spec.domain import (
    GivenDomain,
    SampleKind,
    drawing,
    make_domain,
    with_effects,
    with_look,
)
from rlco.physics.spec.looks import GivenLook
from rlco.physics.spec.names import Renderer
from rlco.physics.spec.stepper import Stepper
from rlco.physics.spec.task import Task
from rlco.physics.tasks.make_task import make_task
from rlco.physics.tasks.named_task import check_robosuite_domain
from rlco.physics.tasks.variations import (
    check_variation_images,
    check_variation_of,
    domain_in,
)
from rlco.physics.tasks.views import check_cameras

Backend = Literal["native", "robosuite"]


def make_env(
    task: str | Task,
    *,
    domain: GivenDomain = "sim",
    backend: Backend = "native",
    num_envs: int = 1,
    chunk: int = 1,
    reward: RewardKind = "shaped",
    horizon: int | None = None,
    image_size: tuple[int, int] | None = None,
    image_quality: Quality = "fast",
    renderer: Renderer = "opengl",
    cameras: Sequence[str] = ("agentview",),
    look: GivenLook | None = None,
    variation: str | None = None,
    effects: Given = None,
    effects_code: str | Path | None = None,
    sample: SampleKind = None,
    seed: int = 0,
    threads: int | None = None,
    exact: bool = False,
    on_divergence: OnDivergence = "reset",
    robosuite_options: Mapping[str, Any] | None = None,
) -> ChunkEnv:
    """Return a batch of a task's episodes as one TorchRL environment.

    Args:
        task: A task or its name; ``robosuite:Lift`` is robosuite's own Lift.
        domain: A domain, its name (``sim`` or ``stand_in``), or the path of its file,
            such as the ``effects.yaml`` that the gap workflow writes.
        backend: ``native`` steps the model in threads; ``robosuite`` lets robosuite
            step, about six times slower. The motion is the same up to
            rounding, which contacts enlarge; with ``exact=True`` to the last bit.
        num_envs: Batch size N.
        chunk: Control steps H a decision; actions have shape (N, H, A).
        reward: ``shaped`` or ``sparse``.
        horizon: Episode length in control steps; the task's own by default.
        image_size: Height and width of camera frames; None: no images.
        image_quality: ``fast``, or ``robosuite`` for robosuite's own pixels, about ten
            times slower.
        renderer: ``opengl``, or ``raster``, rlco's own: several times faster without a
            GPU, in the threads that step, and without an OpenGL library.
        cameras: Names of the model's cameras, such as ``robot0_eye_in_hand``. One gives
            ``("observation", "image")``, several ``("observation", "image", NAME)``.
        look: How images look: ``sim``, ``stand_in``, ``locked``, ``random`` for another
            one in each episode, a `Look` or `LookRanges`; None: as the domain says.
        variation: A named variation of the scene, one of the task's.
        effects: Physical effects to add to the domain's: a list of
            `rlco.physics.effects.AppliedEffect`, or the path of an ``effects.yaml``.
            The robot's controller does not know of them.
        effects_code: Python file that registers effects of your own.
        sample: ``posterior``: each episode draws one of the parameter sets that the
            domain's file holds beside its effects, and keeps it to its end. None: all
            episodes have the effects' own numbers.
        seed: Draws initial states, sensor noise and parameter sets.
        threads: Threads of the native backend; by default one for each
            processor that this process may run on.
        exact: Let the native backend compute with robosuite's own linear algebra,
            about a third slower.
        on_divergence: What to do with an environment whose simulation diverges:
            ``reset`` it and count it, see `rlco.envs.chunk_env.ChunkEnv`, or ``raise``.
        robosuite_options: robosuite's own, for its own tasks of one arm:
            ``{"robots": "UR5e"}``.

    Raises:
        UnknownNameError: If a name is unknown.
        RlcoError: If a number is out of range, options do not go together, an effect
            cannot be applied, or the domain has nothing to draw from.
        DataError: If the domain's or the effects' file cannot be read.
        RenderingError: If images are asked for and nothing can render.

    Example:
        >>> env = make_env("push_cube", num_envs=2, chunk=4, seed=1)
        >>> rollout = env.rollout(3)
        >>> rollout["action"].shape  # (environments, decisions, control steps, A)
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
    check_image_size(image_size)
    check_renderer(renderer, image_quality)
    if renderer != "opengl" and image_size is None:
        raise RlcoError(
            f"renderer={renderer!r} is of no use without images; give "
            "image_size=(height, width), or leave it out."
        )
    check_cameras(cameras)
    if tuple(cameras) != ("agentview",) and image_size is None:
        raise RlcoError(
            f"cameras={list(cameras)} are of no use without images; give "
            "image_size=(height, width), or leave them out."
        )
    if look is not None and image_size is None:
        raise RlcoError(
            "look= is of no use without images; give image_size=(height, width), or "
            "leave it out."
        )
    if image_quality != "fast" and image_size is None:
        raise RlcoError(
            f"image_quality={image_quality!r} is of no use without images; give "
            "image_size=(height, width), or leave it out."
        )
    check_native(backend, threads=threads, exact=exact)
    load_code(effects_code)
    domain = with_effects(drawing(make_domain(domain), sample), effects)
    domain = with_look(domain, look)
    if isinstance(task, str) and task.startswith(PREFIX):
        _refuse_for_robosuite(task, image_size, variation)
        check_robosuite_domain(task, domain)
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
            effects=EffectsFile(domain.effects) if domain.effects else None,
            sample=domain.model_sample,
        )
    if robosuite_options:
        raise RlcoError(
            f"robosuite_options= is for robosuite's own tasks, such as {PREFIX}Lift; "
            "leave it out."
        )
    task = make_task(task)
    check_variation_of(task, variation)
    check_variation_images(variation, image_size)
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
        )
    else:
        stepper = RobosuiteStepper(
            task,
            domain,
            num_envs=num_envs,
            variation=variation,
            on_divergence="mark",
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
        renderer=renderer,
        cameras=cameras,
        variation=variation,
        seed=seed,
        on_divergence=on_divergence,
    )


def _refuse_for_robosuite(
    task: str, image_size: tuple[int, int] | None, variation: str | None
) -> None:
    for name, given, given_at_all in (
        ("image_size", image_size, image_size is not None),
        ("variation", variation, variation is not None),
    ):
        if given_at_all:
            raise RlcoError(
                f"{name}={given!r} is not supported for {task!r}, one of robosuite's "
                "own tasks; leave it out, or give one of rlco's tasks."
            )
