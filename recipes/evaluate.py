"""Play a policy from paired initial states, and count what it solves.

Every policy meets the same episodes, so two runs of this can be compared:

    uv run recipes/evaluate.py policy=outputs/rl_co/RUN/policy domain=stand_in
    uv run recipes/evaluate.py policy=... domain=gap_report/effects.yaml
    uv run recipes/evaluate.py policy=... variation=camera
    uv run recipes/evaluate.py policy=... videos=3        # needs an OpenGL library
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any, Literal

from rlco.errors import ConfigError
from rlco.run import Run, run_recipe
from rlco.runs.config import REQUIRED, RunOptions, folder_name, option

log = logging.getLogger("rlco.evaluate")


@dataclass
class Config(RunOptions):
    """Options of evaluate.py."""

    name: str = option(
        "evaluate", "name of the run, a part of its folder's name", check=folder_name
    )
    policy: str = option(REQUIRED, "folder of a saved policy")
    method: str = option("policy", "what to call it in results.json")
    task: str = option("push_cube", "name of the task")
    domain: str = option(
        "sim",
        "where to play: sim, stand_in, locked, MODULE:NAME, or the path of an "
        "effects.yaml",
    )
    variation: str | None = option(
        None,
        "unseen variation: shapes, colours, initial_states, distractors, camera, "
        "lights, or one of your own task's",
    )
    effects: str | None = option(
        None, "effects.yaml: what to add to the domain's simulator"
    )
    backend: Literal["native", "robosuite"] = option("native", "who steps the model")
    renderer: Literal["raster", "opengl"] | None = option(
        None,
        "what draws the images of a policy that reads some; null: what it was trained "
        "with",
    )
    look: str | None = option(
        None,
        "how the images that it reads look: sim, stand_in, locked, random; null: as "
        "the domain says",
    )
    guidance: float | None = option(
        None,
        "weight of the domain flag of a policy that reads one; null: as it was saved",
    )
    episodes: int = option(256, "episodes, the first ones of the seed", minimum=1)
    videos: int = option(0, "episodes to film", minimum=0)
    effects_code: str | None = option(
        None, "Python file that registers effects of your own"
    )


def main(config: Config) -> None:
    """Evaluate, film, and write results.json."""
    from rlco.evaluation import (
        evaluate,
        evaluation_domains,
        evaluation_env,
        final_states_seed,
        read_by,
    )
    from rlco.physics.effects import load_code
    from rlco.physics.tasks.named_task import named_task
    from rlco.policies import load_task_policy
    from rlco.training.options.policy_options import (
        check_film,
        check_filmed,
        check_look,
        check_rendered,
    )
    from rlco.videos import record_video

    load_code(config.effects_code)
    (domain,) = evaluation_domains(config.task, [config.domain]).values()
    if config.videos:
        check_filmed(config.task)
    policy = load_task_policy(config.policy, named_task(config.task))
    if config.renderer is not None and policy.image_size is None:
        raise ConfigError(
            [
                f"renderer={config.renderer} draws what a policy reads, but policy "
                f"{config.policy!r} reads no images; leave it out"
            ]
        )
    if config.videos:
        check_film(policy, config.renderer)
    if config.guidance is not None:
        policy.set_guidance(config.guidance)
    check_rendered(policy, config.task, config.renderer)
    check_look(config.look, policy.image_size)
    # What is filmed is what is counted.
    options: dict[str, Any] = {
        "chunk": policy.chunk,
        "backend": config.backend,
        "variation": config.variation,
        "effects": config.effects,
        "seed": final_states_seed(config.seed),
        "look": config.look,
    }
    env = evaluation_env(
        config.task,
        domain,
        episodes=config.episodes,
        **read_by(policy, config.renderer),
        **options,
    )
    with Run(config, "evaluate") as run:
        result = evaluate(policy, env, config.episodes)
        where = domain.name + (f", {config.variation}" if config.variation else "")
        where += f", look {config.look}" if config.look else ""
        log.info("%s in %s: %s", config.method, where, result)
        row = result.row(
            config.method,
            domain.name,
            config.seed,
            task=config.task,
            policy=policy.kind,
            variation=config.variation,
        )
        if config.look:
            row["look"] = config.look
        if config.renderer:
            row["renderer"] = config.renderer
        if config.guidance is not None:
            row["guidance"] = config.guidance
        run.save_results([row])
        for index in range(config.videos):
            path = run.videos / f"{domain.name}_{index}.mp4"
            record_video(
                policy,
                config.task,
                domain,
                path,
                index=index,
                renderer=config.renderer,
                **options,
            )
            log.info("video: %s", path)


if __name__ == "__main__":
    run_recipe(main, Config)
