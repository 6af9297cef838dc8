"""How often the scripted expert of each task succeeds, in each domain.

Run ``python benchmarks/expert.py [task=NAME ...] [episodes=N] [variations]`` with
OMP_NUM_THREADS=1; it prints one markdown table. The expert acts on the true state; an
episode counts where the task is solved at its end. Target: at least 95 % of 200
episodes, and with ``noise=0.1`` on its commands, as demonstrations are recorded, 90 %.
With ``variations`` each unseen variation is a row, in ``sim``; target: 90 % of 100.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

from rlco.physics.native.stepper import NativeStepper
from rlco.physics.spec.domain import DOMAINS, SIM, Domain
from rlco.physics.spec.names import TASK_NAMES
from rlco.physics.spec.task import Task
from rlco.physics.tasks.make_task import make_task
from rlco.reporting.statistics import wilson_interval

COPIES = 50


@dataclass
class Options:
    """What the command line may say."""

    tasks: tuple[str, ...] = TASK_NAMES
    episodes: int = 200
    noise: float = 0.0
    variations: bool = False


def solved(task: Task, domain: Domain, variation: str | None, options: Options) -> int:
    """Count the solved ones among the first episodes of seed 0."""
    stepper = NativeStepper(task, domain, num_envs=COPIES, variation=variation)
    count = 0
    for first in range(0, options.episodes, COPIES):
        rngs = [np.random.default_rng([0, first + i]) for i in range(COPIES)]
        state = stepper.reset([task.sample(rng, variation) for rng in rngs])
        for _ in range(task.horizon):
            action = task.expert(state)
            jitter = np.stack([rng.standard_normal(3) for rng in rngs])
            action[:, :3] += options.noise * jitter
            action = np.clip(action, -1.0, 1.0)
            state = stepper.step(action[:, None]).at(np.s_[:, 1])
        count += int(task.success(state)[: options.episodes - first].sum())
    return count


def main(options: Options) -> None:
    """Measure, and print the table."""
    print("| task | domain | variation | solved | success [Wilson 95 %] |")
    print("|---|---|---|---|---|")
    for name in options.tasks:
        task = make_task(name)
        places = [(domain, None) for domain in DOMAINS.values()]
        if options.variations:
            places = [(SIM, variation) for variation in task.variations]
        for domain, variation in places:
            count = solved(task, domain, variation, options)
            rate, low, high = wilson_interval(count, options.episodes)
            share = f"{rate:.1%} [{low:.1%}, {high:.1%}]"
            row = (name, domain.name, variation or "", f"{count} of {options.episodes}")
            print("|", " | ".join((*row, share)), "|", flush=True)


def read(arguments: list[str]) -> Options:
    """Read the command line."""
    options = Options()
    named = [argument.split("=", 1) for argument in arguments if "=" in argument]
    options.tasks = tuple(v for k, v in named if k == "task") or TASK_NAMES
    given = dict(named)
    options.episodes = int(given.get("episodes", options.episodes))
    options.noise = float(given.get("noise", options.noise))
    options.variations = "variations" in arguments
    return options


if __name__ == "__main__":
    main(read(sys.argv[1:]))
