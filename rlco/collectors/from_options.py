"""A collector, and the simulator it plays in, from a recipe's options."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal, Protocol

from tensordict import TensorDictBase

from rlco.collectors.advantages import Advantage
from rlco.collectors.rollouts import RolloutCollector
from rlco.envs import make_env
from rlco.physics.spec.domain import make_domain
from rlco.physics.tasks.named_task import training_horizon
from rlco.training.distributed.ranks import Ranks


class CollectorOptions(Protocol):
    """The options of Stage II that say where rollouts come from and how good they are.

    Attributes:
        task: The task's name.
        train_domain: Where to play: a domain's name, or the path of an effects.yaml.
        train_sample: ``posterior``: each episode draws a parameter set of that file.
        num_envs: Episodes of a rollout.
        reward: ``shaped`` or ``sparse``.
        horizon: Control steps of an episode; None: the task's own for training.
        seed: Draws the episodes.
        gamma: See `RolloutCollector`, as the following.
        lmbda: GAE's lambda.
        advantage: ``gae`` or ``mc``.
        group_size: Episodes of a group.
    """

    task: str
    train_domain: str
    train_sample: Literal["none", "posterior"]
    num_envs: int
    reward: Literal["shaped", "sparse"]
    horizon: int | None
    seed: int
    gamma: float
    lmbda: float
    advantage: Advantage
    group_size: int


def make_collector(
    options: CollectorOptions,
    policy: Any,
    critic: Any | None,
    *,
    chunk: int,
    image_size: tuple[int, int] | None,
    renderer: Literal["raster", "opengl"] = "opengl",
    backend: Literal["native", "robosuite"] = "native",
    look: str | None = None,
    cameras: Sequence[str] = ("agentview",),
    prepare: Callable[[TensorDictBase], None] | None = None,
    ranks: Ranks | None = None,
    workers: int | None = None,
    ray_address: str | None = None,
    effects_code: str | None = None,
) -> RolloutCollector:
    """Return a collector that plays in the options' simulator.

    Args:
        options: See `CollectorOptions`.
        policy: See `RolloutCollector`.
        critic: See `RolloutCollector`.
        chunk: Control steps of a decision.
        image_size: Height and width of the images that the policy reads; None: none.
        renderer: What draws these images.
        backend: Who steps the model.
        look: How images look, see `make_env`; None: as the domain says.
        cameras: Names of the cameras whose images the policy reads.
        prepare: See `RolloutCollector`.
        ranks: See `RolloutCollector`; the options are those of one of them.
        workers: Processes of a Ray cluster that play, the environments divided between
            them; None: this one plays.
        ray_address: See `rlco.runs.ray_cluster.connect`.
        effects_code: Python file of effects of one's own, which workers load, too.
    """
    build = partial(
        make_env,
        options.task,
        domain=make_domain(options.train_domain),
        sample=None if options.train_sample == "none" else options.train_sample,
        backend=backend,
        num_envs=options.num_envs // (workers or 1),
        chunk=chunk,
        reward=options.reward,
        horizon=training_horizon(options.task, options.horizon),
        image_size=image_size,
        renderer=renderer if image_size else "opengl",
        look=look,
        cameras=cameras if image_size else ("agentview",),
        seed=options.seed,
    )
    playing = None
    if workers is not None:
        from rlco.collectors.ray_rollouts import RayWorkers, made_in

        make = partial(made_in, os.getcwd(), effects_code, build)
        playing = RayWorkers(workers, make, ray_address, options.seed)
    return RolloutCollector(
        build(),
        policy,
        critic,
        gamma=options.gamma,
        lmbda=options.lmbda,
        advantage=options.advantage,
        group_size=options.group_size,
        prepare=prepare,
        ranks=ranks,
        workers=playing,
    )
