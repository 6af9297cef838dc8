"""How many control steps a second rollouts have, played here and by workers of Ray.

Run ``python benchmarks/scale.py [task=push_cube] [num_envs=32] [horizon=64] [rounds=8]
[workers=1,2,4]`` with OMP_NUM_THREADS=1. Every side plays the same number of whole
episodes by the same small policy. The sides take turns, so that what else the machine
does meets all; a rate is the median over rounds, a ratio the median of the rounds'
ratios. More workers than processors share these: only ratios of one run say anything.

The overhead of Ray is the time of its two workers over that of two processes of
TorchRL's own collector, minus one.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from typing import Any

import numpy as np
import torch
from torchrl.collectors import Collector
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import ExcludeTransform

from rlco import keys
from rlco.collectors.local_rollouts import LocalRollouts
from rlco.collectors.ray_rollouts import RayRollouts, RayWorkers
from rlco.envs import make_env
from rlco.physics.tasks.named_task import named_task
from rlco.policies import GaussianPolicy, task_sizes
from rlco.runs.ray_cluster import connect, disconnect

CHUNK = 4
PLAIN, PROCESSES, LOCAL = "TorchRL's Collector", "its 2 processes", "rlco, this process"
DEFAULTS = {
    **{"task": "push_cube", "num_envs": "32", "horizon": "64", "rounds": "8"},
    "workers": "1,2,4",
}
Side = Callable[[], object]


def plain(make: Callable[[int], Any], policy: Any, envs: int, count: int) -> Collector:
    """Return TorchRL's own collector, in one process or in several."""
    factory = partial(_without_text, make, envs // count)
    frames = envs * decisions(make)
    several = {"num_collectors": count, "sync": True} if count > 1 else {}
    return Collector(
        [factory] * count if count > 1 else factory(),
        policy,
        frames_per_batch=frames,
        total_frames=-1,
        reset_at_each_iter=True,
        auto_register_policy_transforms=False,
        **several,
    )


def decisions(make: Callable[[int], Any]) -> int:
    """Return how many decisions an episode has."""
    env = make(1)
    return -(-env.horizon // env.chunk)


def sides(
    make: Callable[[int], Any], policy: Any, envs: int, workers: list[int]
) -> Iterator[tuple[str, Side, Callable[[], object]]]:
    """Yield each side's name, what plays one rollout of it, and what ends it."""
    length = decisions(make)
    for name, count in ((PLAIN, 1), (PROCESSES, 2)):
        collector = plain(make, policy, envs, count)
        yield name, partial(next, iter(collector)), collector.shutdown
    read = frozenset(policy.in_keys)
    local = LocalRollouts(make(envs), policy, read, decisions=length)
    yield LOCAL, partial(local.play, 0), local.close
    for count in workers:
        each = envs // count
        rollouts = RayRollouts(
            RayWorkers(count, partial(make, each)), policy, read, frames=each * length
        )
        yield f"rlco, {count} of Ray", partial(rollouts.play, 0), rollouts.close


def main(arguments: list[str]) -> None:
    """Measure, and print a table."""
    given = DEFAULTS | dict(argument.split("=", 1) for argument in arguments)
    envs, horizon = int(given["num_envs"]), int(given["horizon"])
    workers = [int(count) for count in given["workers"].split(",")]
    torch.set_num_threads(1)
    torch.manual_seed(0)
    sizes = task_sizes(named_task(given["task"]))
    policy = GaussianPolicy(chunk=CHUNK, hidden=(256, 256), **sizes)
    make = partial(_make, given["task"], horizon)
    seconds: dict[str, list[float]] = {}
    connect(None, sum(workers))
    with ExitStack() as stack:
        stack.callback(disconnect)
        playing: dict[str, Side] = {}
        for name, play, end in sides(make, policy, envs, workers):
            stack.callback(end)
            play()  # compiles, and resets for the first time
            playing[name] = play
            print(f"{name} is ready", file=sys.stderr)
        for _ in range(int(given["rounds"])):
            for name, play in playing.items():
                began = time.perf_counter()
                play()
                seconds.setdefault(name, []).append(time.perf_counter() - began)
    report(seconds, envs * horizon, f"rlco, {workers[0]} of Ray")


def _make(task: str, horizon: int, num_envs: int) -> Any:
    return make_env(task, num_envs=num_envs, chunk=CHUNK, horizon=horizon)


def _without_text(make: Callable[[int], Any], num_envs: int) -> TransformedEnv:
    """Return an environment as rlco has it: texts cost time, and are not read."""
    return TransformedEnv(make(num_envs), ExcludeTransform(keys.INSTRUCTION))


def report(seconds: dict[str, list[float]], frames: int, first: str) -> None:
    """Print the table, and Ray's overhead where two of its workers were measured."""
    print(f"| {frames} frames a rollout | frames/s | to {first} | to {PLAIN} |")
    print("|---|---|---|---|")
    times = {name: np.array(values) for name, values in seconds.items()}
    for name, taken in times.items():
        rate = np.median(frames / taken)
        one, other = (np.median(times[base] / taken) for base in (first, PLAIN))
        print(f"| {name} | {rate:.0f} | {one:.2f} | {other:.2f} |")
    two = times.get("rlco, 2 of Ray")
    if two is not None:
        ratios = two / times[PROCESSES]
        low, high = np.percentile(ratios, [25, 75])
        print(
            f"\noverhead of Ray with 2 workers: {np.median(ratios) - 1:+.1%} "
            f"(quartiles {low - 1:+.1%} to {high - 1:+.1%})"
        )


if __name__ == "__main__":
    main(sys.argv[1:])
