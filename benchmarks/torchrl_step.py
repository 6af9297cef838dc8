"""How many control steps a second whole TorchRL environments make.

Run ``python benchmarks/torchrl_step.py [rounds=10] [task=push_cube] [envs=32]`` with
OMP_NUM_THREADS=1; it prints one markdown table. TensorDict in, TensorDict out: `envs`
environments at once, native, and robosuite's own step in TorchRL's SerialEnv and
ParallelEnv, in turns. ``profile=1`` prints where the native environment's time goes.
"""

from __future__ import annotations

import cProfile
import pstats
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torchrl.envs import EnvBase, ParallelEnv, SerialEnv
from torchrl.envs.utils import step_mdp

from rlco.envs import make_env

STEPS = 8


def player(env: EnvBase) -> Callable[[], float]:
    """Return a round: control steps a second from a reset on."""
    torch.manual_seed(0)
    action = env.action_spec.rand().mul_(0.5)
    count = env.batch_size.numel() * STEPS

    def play() -> float:
        td = env.reset()
        began = time.perf_counter()
        for _ in range(STEPS):
            td = step_mdp(env.step(td.set("action", action)))
        return count / (time.perf_counter() - began)

    return play


def main(rounds: int, task: str, envs: int, profile: bool) -> None:
    """Measure, and print the table."""

    def slow(num_envs: int) -> EnvBase:
        return make_env(task, backend="robosuite", num_envs=num_envs)

    native = make_env(task, num_envs=envs)
    if profile:
        play = player(native)
        play()
        profiler = cProfile.Profile()
        profiler.runcall(lambda: [play() for _ in range(rounds)])
        pstats.Stats(profiler).sort_stats("tottime").print_stats(25)
        return
    made: dict[str, EnvBase] = {
        "robosuite, SerialEnv": SerialEnv(envs, lambda: slow(1)),
        "native": native,
        "native, 1 thread": make_env(task, num_envs=envs, threads=1),
    }
    for workers in (1, 2, 4):
        made[f"robosuite, ParallelEnv({workers})"] = ParallelEnv(
            workers, lambda w=workers: slow(envs // w)
        )
    sides: dict[str, Any] = {name: player(env) for name, env in made.items()}
    for play in sides.values():
        play()
    rates = np.array([[play() for play in sides.values()] for _ in range(rounds)])
    best = rates[:, [name.startswith("robosuite") for name in sides]].max(axis=1)
    print(
        f"| {task}, {envs} environments | control steps a second | times the best of "
        "robosuite [quartiles] |"
    )
    print("|---|---|---|")
    for name, row, ratio in zip(sides, rates.T, (rates / best[:, None]).T, strict=True):
        low, middle, high = np.percentile(ratio, [25, 50, 75])
        middle_rate = np.median(row)
        print(f"| {name} | {middle_rate:.0f} | {middle:.2f} [{low:.2f}, {high:.2f}] |")
    for env in made.values():
        env.close()


if __name__ == "__main__":
    given = dict(argument.split("=", 1) for argument in sys.argv[1:])
    main(
        int(given.get("rounds", 10)),
        given.get("task", "push_cube"),
        int(given.get("envs", 32)),
        bool(int(given.get("profile", 0))),
    )
