"""How often the scripted expert of push_cube succeeds, in each domain.

Run ``python benchmarks/expert.py [episodes]`` with OMP_NUM_THREADS=1; it prints one
markdown table. The expert acts on the true state, without noise; an episode counts
where the task is solved at its end. Target: at least 95 % of 200 episodes.
"""

from __future__ import annotations

import sys

import numpy as np

from rlco.physics.domain import DOMAINS, Domain
from rlco.physics.native import NativeStepper
from rlco.physics.push_cube import TASK
from rlco.statistics import wilson_interval

COPIES = 50


def solved(domain: Domain, episodes: int) -> int:
    """Count the solved ones among the first episodes of seed 0."""
    stepper = NativeStepper(TASK, domain, num_envs=COPIES)
    count = 0
    for first in range(0, episodes, COPIES):
        rngs = [np.random.default_rng([0, first + i]) for i in range(COPIES)]
        state = stepper.reset([TASK.sample(rng, None) for rng in rngs])
        for _ in range(TASK.horizon):
            state = stepper.step(TASK.expert(state)[:, None]).at(np.s_[:, 1])
        count += int(TASK.success(state)[: episodes - first].sum())
    return count


def main(episodes: int) -> None:
    """Measure, and print the table."""
    print("| domain | solved | success [Wilson 95 %] |")
    print("|---|---|---|")
    for name, domain in DOMAINS.items():
        count = solved(domain, episodes)
        rate, low, high = wilson_interval(count, episodes)
        share = f"{rate:.1%} [{low:.1%}, {high:.1%}]"
        print(f"| {name} | {count} of {episodes} | {share} |", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
