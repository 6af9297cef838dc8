"""Where Stage II runs: in this process, in several that learn, in others that play."""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, Protocol

from rlco.errors import ConfigError
from rlco.runs.config import RunOptions, option

if TYPE_CHECKING:
    import torch

    from rlco.training.distributed.ranks import Ranks


@dataclass
class LearnersOptions(RunOptions):
    """The option that says whether one process learns or several."""

    launch: Literal["local", "torchrun"] = option(
        "local",
        "where it runs: this process; torchrun: the learners that torchrun has "
        "started, between which num_envs, minibatch and real_rows are divided",
        may_change=True,
    )

    @property
    def workers(self) -> None:
        """No Ray: each learner plays."""

    @property
    def ray_address(self) -> None:
        """No Ray."""


@dataclass
class LaunchOptions(RunOptions):
    """Options that say where a training runs."""

    launch: Literal["local", "ray", "torchrun"] = option(
        "local",
        "where it runs: this process; ray: it learns, and workers of a Ray cluster "
        "play; torchrun: the learners that torchrun has started, between which "
        "num_envs, minibatch and real_rows are divided",
        may_change=True,
    )
    workers: int | None = option(
        None,
        "ray: processes that play, between which num_envs is divided; torchrun: the "
        "same of all learners together, null: each learner plays itself",
        minimum=1,
        may_change=True,
    )
    ray_address: str | None = option(
        None,
        "ray: the cluster, auto or HOST:PORT; null: one of this machine alone",
        may_change=True,
    )


class DividedOptions(Protocol):
    """Options whose numbers are of all ranks together."""

    num_envs: int
    minibatch: int
    real_rows: int
    advantage: Literal["gae", "mc"]
    group_size: int
    seed: int

    @property
    def launch(self) -> Literal["local", "ray", "torchrun"]:
        """Where it runs."""

    @property
    def workers(self) -> int | None:
        """Processes of a Ray cluster that play."""

    @property
    def ray_address(self) -> str | None:
        """Of that cluster."""


def check_launch(options: DividedOptions, recipe: str = "rl_co") -> None:
    """Check that a training was started as its options say, and can be divided so.

    Args:
        options: The options.
        recipe: Which they are of.

    Raises:
        ConfigError: It was not; every problem is reported.
    """
    started = started_by_torchrun()
    problems = _without_ray(options)
    if options.launch == "torchrun" and started is None:
        problems.append(
            "launch=torchrun needs what torchrun tells its processes; start torchrun "
            f"--nproc-per-node=2 recipes/{recipe}.py launch=torchrun ..."
        )
    if options.launch != "torchrun" and started is not None:
        problems.append(
            f"torchrun has started {started} processes, and launch={options.launch} "
            "would train the same in each; give launch=torchrun, or start without "
            "torchrun"
        )
    learning = (started or 1) if options.launch == "torchrun" else 1
    problems += _undivided(options, learning)
    if problems:
        raise ConfigError(problems)
    if options.workers is not None:
        from rlco.runs.ray_cluster import check_ray

        check_ray(options.ray_address)


def started_by_torchrun() -> int | None:
    """Return how many processes torchrun has started; None where it started none."""
    if "TORCHELASTIC_RUN_ID" not in os.environ:
        return None
    return int(os.environ["WORLD_SIZE"])


def _without_ray(options: DividedOptions) -> list[str]:
    """Return what is wrong with the options of Ray."""
    given = [n for n in ("workers", "ray_address") if getattr(options, n) is not None]
    if options.launch == "local" and given:
        return [
            f"{' and '.join(given)} belong to launch=ray and launch=torchrun, but "
            "launch=local; give launch=ray"
        ]
    if options.launch == "ray" and options.workers is None:
        return ["launch=ray needs to know how many processes play; give workers=2"]
    if options.launch == "torchrun" and len(given) == 1:
        return [
            f"launch=torchrun with {given[0]} alone: learners share one Ray cluster; "
            "give both workers=N and ray_address=HOST:PORT, or neither"
        ]
    return []


def _undivided(options: DividedOptions, learning: int) -> list[str]:
    """Return what cannot be divided between learners and those that play."""
    problems = [
        f"{name}={value} cannot be divided between {learning} learners; give a multiple"
        for name in ("minibatch", "real_rows")
        if (value := getattr(options, name)) % learning
    ]
    playing = learning if options.workers is None else options.workers
    if playing % learning:
        problems.append(
            f"workers={playing} cannot be divided between {learning} learners; give a "
            "multiple"
        )
    each, rest = divmod(options.num_envs, playing)
    grouped = options.advantage == "mc" and playing > 1
    if rest:
        problems.append(
            f"num_envs={options.num_envs} cannot be divided between {playing} "
            "processes that play; give a multiple"
        )
    elif grouped and each % options.group_size:
        problems.append(
            f"num_envs={options.num_envs} gives each of {playing} processes {each} "
            f"episodes, and group_size={options.group_size} does not divide these; "
            "give a multiple"
        )
    return problems


def own_options[C: DividedOptions](options: C, ranks: Ranks) -> C:
    """Return a rank's own part of options that are of all ranks together.

    Example:
        >>> from rlco.training.distributed.ranks import Ranks
        >>> from rlco.training.options.stage_two_options import (
        ...     StageTwoOptions,
        ... )
        >>> options = StageTwoOptions(policy="policy", num_envs=32)
        >>> own_options(options, Ranks(rank=1, count=4)).num_envs
        8
    """
    divided = ("num_envs", "minibatch", "real_rows")
    parts = {name: getattr(options, name) // ranks.count for name in divided}
    if options.workers is not None:
        parts["workers"] = options.workers // ranks.count
    return replace(options, **parts)  # type: ignore[type-var]


def take_gpu(options: DividedOptions) -> None:
    """Let "cuda" be a GPU of this process's own, where its machine has one for each."""
    from rlco.training.distributed.ranks import gpus_for_all, local_rank

    if options.launch == "torchrun" and gpus_for_all():
        import torch

        torch.cuda.set_device(local_rank())


@contextmanager
def learners(
    options: DividedOptions, device: torch.device | None = None
) -> Iterator[Ranks]:
    """Connect this process with those that learn with it, where there are any.

    Args:
        options: Say whether there are.
        device: Where the policy computes; None: the CPU.

    Raises:
        LostProcessError: One of them ended before the others.
    """
    from rlco.training.distributed.ranks import (
        Ranks,
        join_ranks,
        leave_ranks,
        lost_rank,
    )

    if options.launch != "torchrun":
        yield Ranks(seed=options.seed)
        return
    on_gpu = device is not None and device.type == "cuda"
    ranks = join_ranks(options.seed, gpus=on_gpu)
    if not ranks.leads:  # they would say what the first says
        logging.getLogger("rlco").setLevel(logging.WARNING)
    try:
        yield ranks
    except (RuntimeError, KeyboardInterrupt) as error:
        # torchrun asks the others to end, too, perhaps while this one notices.
        lost = lost_rank(error) or lost_rank(error.__context__)
        if lost is None:
            raise
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # it ends, and says why first
        raise lost from error
    finally:
        leave_ranks()
