"""Play a policy from paired initial states, and count what it solves.

Every policy meets the same episodes, so two runs of this can be compared:

    uv run recipes/evaluate.py policy=outputs/rl_co/RUN/policy domain=stand_in
    uv run recipes/evaluate.py policy=... variation=camera
    uv run recipes/evaluate.py policy=... videos=3        # needs an OpenGL library
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Literal

from rlco.config import REQUIRED, RunOptions, option
from rlco.run import Run, run_recipe

log = logging.getLogger("rlco.evaluate")


@dataclass
class Config(RunOptions):
    """Options of evaluate.py."""

    name: str = option("evaluate", "name of the run, a part of its folder's name")
    policy: str = option(REQUIRED, "folder of a saved policy")
    method: str = option("policy", "what to call it in results.json")
    task: str = option("push_cube", "name of the task")
    domain: str = option("sim", "where to play: sim or stand_in")
    variation: str | None = option(
        None, "unseen variation: shapes, colours, initial_states, distractors, camera"
    )
    effects: str | None = option(None, "effects.yaml: what to add to the simulator")
    backend: Literal["native", "robosuite"] = option("native", "who steps the model")
    episodes: int = option(256, "episodes, the first ones of the seed", minimum=1)
    videos: int = option(0, "episodes to film", minimum=0)


def main(config: Config) -> None:
    """Evaluate, film, and write results.json."""
    from policy_options import check_pictures

    from rlco.evaluation import EVALUATION_SEED, evaluate, evaluation_env, record_video
    from rlco.physics.camera import check_rendering
    from rlco.physics.named_task import named_task
    from rlco.policies import load_task_policy

    if config.videos:
        check_rendering()
    policy = load_task_policy(config.policy, named_task(config.task))
    check_pictures(policy, config.task)
    env = evaluation_env(
        config.task,
        config.domain,
        chunk=policy.chunk,
        episodes=config.episodes,
        backend=config.backend,
        variation=config.variation,
        effects=config.effects,
        image_size=policy.image_size,
        seed=EVALUATION_SEED + config.seed,
    )
    with Run(config, "evaluate") as run:
        result = evaluate(policy, env, config.episodes)
        where = config.domain + (f", {config.variation}" if config.variation else "")
        log.info("%s in %s: %s", config.method, where, result)
        row = result.row(
            config.method,
            config.domain,
            config.seed,
            task=config.task,
            policy=policy.kind,
            variation=config.variation,
        )
        run.save_results([row])
        for index in range(config.videos):
            path = run.videos / f"{config.domain}_{index}.mp4"
            record_video(
                policy,
                config.task,
                config.domain,
                path,
                chunk=policy.chunk,
                index=index,
                variation=config.variation,
                seed=EVALUATION_SEED + config.seed,
            )
            log.info("video: %s", path)


if __name__ == "__main__":
    run_recipe(main, Config)
