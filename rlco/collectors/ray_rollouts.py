"""Rollouts of environments in other processes, over Ray by TorchRL's collector."""

from __future__ import annotations

import logging
import os
import platform
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType

from rlco.collectors import patience
from rlco.collectors.local_rollouts import checked
from rlco.collectors.rollout_checks import FiniteRollout
from rlco.envs.chunk_env import ChunkEnv
from rlco.errors import ConfigError, LostProcessError, RlcoError
from rlco.physics.effects import load_code
from rlco.runs.ray_cluster import connect, disconnect, import_ray
from rlco.runs.state_files import seed_everything
from rlco.training.distributed.ranks import lost_rank

log = logging.getLogger("rlco.collectors")

#: TorchRL 0.14.1 collects nothing where no number of frames is given.
_FRAMES = sys.maxsize

#: A rollout that takes so many times as long as the longest before is reported.
_SLOWER = 5
#: In which a worker answers that plays nothing [s].
_ANSWER = 5.0


@dataclass(frozen=True)
class RayWorkers:
    """Processes of a Ray cluster that play, each in environments of its own.

    Attributes:
        count: How many.
        make_env: Makes a worker's environment; is sent to it, as all it holds.
        address: Of the cluster, see `rlco.runs.ray_cluster.connect`.
        seed: Of the run; a worker's actions depend on it, on the worker and on the
            rollout, so that a rollout that is played again is the same.
    """

    count: int
    make_env: Callable[[], ChunkEnv]
    address: str | None = None
    seed: int = 0


class RayRollouts:
    """Plays one episode of each environment of each worker.

    TorchRL's `RayCollector` sends the policy's weights before each rollout. A worker
    that ends is started again, with all others, and the rollout is played again: as it
    would have been.

    Args:
        workers: Where.
        policy: Acts; each worker has a copy.
        read: See `LocalRollouts`, as what follows.
        frames: Decisions of a worker's rollout, its environments together.
        group_size: Episodes that start alike.
        part: The first worker's part.
        parts: Of all workers, those of other ranks with them.
    """

    def __init__(
        self,
        workers: RayWorkers,
        policy: Any,
        read: frozenset[Any],
        *,
        frames: int,
        group_size: int = 1,
        part: int = 0,
        parts: int = 1,
    ) -> None:
        self._workers, self._policy, self._frames = workers, policy, frames
        self._part, self._parts = part, parts
        self._make_env = partial(_worker_env, workers.make_env, read, group_size)
        self._connected = connect(workers.address, workers.count)
        self._check_processors()
        self._collector: Any = None
        self._batches: Iterator[TensorDictBase] = iter(())
        self._processes: list[str] = []
        self._longest = 0.0
        self._start()

    def _check_processors(self) -> None:
        """Refuse what would wait without end, and without a word, for processors.

        Raises:
            ConfigError: The cluster has fewer than there are workers.
        """
        there = int(import_ray().cluster_resources().get("CPU", 0))
        wanted = max(self._workers.count, self._parts)
        if there < wanted:
            if self._connected:
                disconnect()
            raise ConfigError(
                [
                    f"the Ray cluster has {there} processors, and each of "
                    f"{wanted} workers takes one; start more nodes, or give fewer "
                    "workers"
                ]
            )

    def play(self, iteration: int) -> TensorDictBase:
        """Return the rollout of one iteration, (N, T), in the order of the workers.

        Raises:
            LostProcessError: A worker ended, and again when it was started anew.
            NonFiniteError: See `RolloutCollector.collect`.
        """
        # Weights on their way to one that ends break off by an error of gloo's.
        died = (import_ray().exceptions.RayActorError, RuntimeError)
        try:
            return self._play(iteration)
        except died as error:
            if (reason := _lost(error)) is None:
                raise
        log.warning(
            "a worker has ended (%s): all are started again, and rollout %d is played "
            "again",
            reason,
            iteration,
        )
        self._stop()
        self._start()
        try:
            return self._play(iteration)
        except died as error:
            if (reason := _lost(error)) is None:
                raise
            raise LostProcessError(
                f"a worker ended twice in rollout {iteration} ({reason}); nothing that "
                "was saved is lost: look at its node's memory and at Ray's logs, then "
                "go on with resume=DIR."
            ) from error

    def _play(self, iteration: int) -> TensorDictBase:
        ray = import_ray()
        began = []
        for index, worker in enumerate(self._collector.remote_collectors):
            part = self._part + index
            seed = np.random.SeedSequence([self._workers.seed, part, iteration])
            began.append(
                worker.begin.remote(
                    iteration,
                    iteration * self._parts + part,
                    int(seed.generate_state(1)[0]),
                )
            )
        try:
            ray.get(began)
            self._collector.update_policy_weights_(self._policy)
            with self._impatient(iteration):
                stacked = next(self._batches)
        except ray.exceptions.RayTaskError as error:
            if isinstance(error.cause, RlcoError):
                raise error.cause from None
            raise
        return stacked.flatten(0, 1)  # (workers, environments, T)

    @contextmanager
    def _impatient(self, iteration: int) -> Iterator[None]:
        """Say so, once, where workers are long over a rollout: a hang is silent."""
        wait = max(patience.PATIENCE, _SLOWER * self._longest)
        timer = threading.Timer(wait, self._report_unfinished, (iteration, wait))
        timer.daemon = True
        timer.start()
        began = time.monotonic()
        try:
            yield
        finally:
            timer.cancel()
            timer.join()
        self._longest = max(self._longest, time.monotonic() - began)

    def _report_unfinished(self, iteration: int, waited: float) -> None:
        workers = self._collector.remote_collectors
        asked = [worker.__ray_call__.remote(_answer) for worker in workers]
        answered, _ = import_ray().wait(asked, num_returns=len(asked), timeout=_ANSWER)
        playing = [
            process
            for process, question in zip(self._processes, asked, strict=True)
            if question not in answered
        ]
        if playing:
            log.warning(
                "rollout %d: not ended after %.3g s by %s; an environment hangs there "
                "or is very slow. A process that is killed is started again, Ctrl-C "
                "ends the run, and nothing that was saved is lost.",
                iteration,
                waited,
                ", ".join(playing),
            )

    def _start(self) -> None:
        ray = import_ray()
        from torchrl.collectors.distributed import RayCollector

        count = self._workers.count
        self._collector = RayCollector(
            [self._make_env] * count,
            self._policy,
            frames_per_batch=self._frames * count,
            total_frames=_FRAMES,
            collector_class=WorkerCollector,
            collector_kwargs={"auto_register_policy_transforms": False},
            remote_configs={"num_cpus": 1},
            reset_at_each_iter=True,
            exploration_type=ExplorationType.RANDOM,
            sync=True,
        )
        self._batches = iter(self._collector)
        self._processes = ray.get(
            [
                worker.__ray_call__.remote(_process, index)
                for index, worker in enumerate(self._collector.remote_collectors)
            ]
        )

    def _stop(self) -> None:
        self._collector.shutdown()

    def close(self) -> None:
        """End the workers, and the cluster if it is of this process alone."""
        self._stop()
        if self._connected:
            disconnect()


class WorkerCollector(Collector):
    """A worker's collector, which knows which episodes a rollout is of."""

    def __bool__(self) -> bool:
        # Ray asks an actor that raised whether it is true, and so for its length: of an
        # endless collector that is no integer, and its worker would end without a word.
        return True

    def begin(self, iteration: int, episode: int, seed: int) -> None:
        """Let the next batch be of these episodes, and its actions of this seed."""
        finite: Any = self.env.transform[-1]
        finite.begin(iteration)
        self.env.base_env.start_at(episode)
        seed_everything(seed)


def _answer(_worker: WorkerCollector) -> None:
    """Answer: what plays a rollout does not."""


def _process(_worker: WorkerCollector, index: int) -> str:
    return f"worker {index} (process {os.getpid()} on {platform.node()})"


def _worker_env(
    make_env: Callable[[], ChunkEnv], read: frozenset[Any], group_size: int
) -> TransformedEnv:
    torch.set_num_threads(1)
    env = make_env()
    env.start_in_groups(group_size)
    return checked(env, FiniteRollout(read))


def made_in(
    folder: str, effects_code: str | None, make_env: Callable[[], ChunkEnv]
) -> ChunkEnv:
    """Return an environment made where relative paths and modules are found.

    Args:
        folder: The working directory of the process that trains; nodes that do not
            share it find what is installed alone.
        effects_code: Python file of effects of one's own; None: there are none.
        make_env: Makes it.
    """
    if Path(folder).is_dir():
        os.chdir(folder)
        sys.path.insert(0, folder)
    load_code(effects_code)
    return make_env()


def _lost(error: Exception) -> str | None:
    """Return why a worker has ended, in a line; None if none has."""
    if not isinstance(error, import_ray().exceptions.RayActorError):
        return None if lost_rank(error) is None else "its connection broke off"
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    reasons = [
        line for line in lines if "cause" in line.lower() or "exit" in line.lower()
    ]
    return (reasons or lines or [type(error).__name__])[0][:200].rstrip(".")
