"""How often a task's scripted expert succeeds, before anything is recorded from it.

    uv run recipes/check_expert.py task=push_cube
    PYTHONPATH=. uv run recipes/check_expert.py task=my_task:TASK noise=0.1

The expert acts on the true state; an episode counts where the task is solved at its
end. At least 95 % of 200 episodes should, in every domain that demonstrations are
recorded in: of an expert that fails often, only the easy starts are kept.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rlco.run import run_recipe
from rlco.runs.config import LAST_SEED, distinct, none_twice, option

if TYPE_CHECKING:
    from rlco.physics.tasks.expert_success import ExpertSuccess

log = logging.getLogger("rlco.check_expert")
#: Share of the episodes that an expert should solve.
WANTED = 0.95


@dataclass
class Config:
    """Options of check_expert.py."""

    task: str = option("push_cube", "name of the task, or MODULE:NAME of yours")
    domains: list[str] = option(
        ["sim", "stand_in"],
        "where it plays: names, MODULE:NAME, or paths of effects.yaml files",
        check=distinct,
    )
    variations: list[str] = option(
        [],
        "unseen variations of the task to play, too, each in the first domain",
        check=none_twice,
    )
    episodes: int = option(200, "episodes in each", minimum=1)
    noise: float = option(
        0.0, "noise of the commands; demonstrations have 0.1", minimum=0, maximum=1
    )
    seed: int = option(
        0, "seed of initial states and noise", minimum=0, maximum=LAST_SEED
    )
    effects_code: str | None = option(
        None, "Python file that registers effects of your own"
    )


def main(config: Config) -> None:
    """Play everywhere, and say how often it went well."""
    from rlco.physics.effects import load_code
    from rlco.physics.tasks.expert_success import expert_success
    from rlco.physics.tasks.make_task import make_task
    from rlco.physics.tasks.named_task import check_domains
    from rlco.physics.tasks.variations import check_variation_images, check_variation_of

    load_code(config.effects_code)
    task = make_task(config.task)
    domains = check_domains(config.task, config.domains)
    for variation in config.variations:
        check_variation_of(task, variation)
        check_variation_images(variation, None)
    places = [(domain, None) for domain in domains]
    places += [(domains[0], variation) for variation in config.variations]
    failed = False
    for domain, variation in places:
        played = expert_success(
            task,
            domain,
            episodes=config.episodes,
            seed=config.seed,
            noise=config.noise,
            variation=variation,
        )
        where = domain.name if variation is None else f"{domain.name}, {variation}"
        log.info("%s in %s: %s", task.name, where, in_words(played))
        failed |= played.solved.mean() < WANTED
    if failed:
        log.info(
            "an expert should solve %.0f %%: what is recorded of one that fails often "
            "are easy starts; record_demos films a failure where most episodes fail",
            100 * WANTED,
        )


def in_words(played: ExpertSuccess) -> str:
    """Return the share that was solved with its interval, and after how many steps."""
    import numpy as np

    from rlco.reporting.statistics import wilson_interval

    count = len(played.solved)
    rate, low, high = wilson_interval(int(played.solved.sum()), count)
    text = f"{rate:.1%} [{low:.1%}, {high:.1%}] of {count} episodes"
    if not played.solved.any():
        return text
    median, most, last = np.nanquantile(played.steps, [0.5, 0.95, 1.0])
    return (
        f"{text}, solved for good after {median:.0f} steps (median), {most:.0f} "
        f"(95 %), {last:.0f} (slowest)"
    )


if __name__ == "__main__":
    run_recipe(main, Config)
