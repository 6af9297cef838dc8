"""The whole chain in one command: record, imitate, reinforce, compare, report.

    uv run recipes/quickstart.py

Demonstrations are recorded in the simulator and in ``stand_in``, a second simulator
that plays the robot's part; no robot moves. Then three policies are trained and
compared in both: real_only (Stage I on real demonstrations alone), sft (Stage I on
both) and rl_co (sft, then PPO in the simulator anchored to the real demonstrations).
"""

from __future__ import annotations

import logging
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import record_demos
import rl_co
import sft
from policy_options import SIM_CAMERA, AugmentOptions, PolicyOptions, shared

from rlco.config import option
from rlco.errors import RenderingError, UnknownNameError
from rlco.run import Run, run_recipe

log = logging.getLogger("rlco.quickstart")
METHODS = ("real_only", "sft", "rl_only", "rl_co")


@dataclass
class Config(PolicyOptions):
    """Options of quickstart.py."""

    name: str = option("quickstart", "name of the run, a part of its folder's name")
    task: str = option("push_cube", "name of the task")
    methods: list[str] = option(
        ["real_only", "sft", "rl_co"], f"which to compare: {', '.join(METHODS)}"
    )
    sim_demos: int = option(12, "demonstrations to record in sim", minimum=1)
    real_demos: int = option(6, "demonstrations to record in stand_in", minimum=1)
    heldout_demos: int = option(
        9, "more of those, never trained on: they measure forgetting", minimum=1
    )
    sim_ratio: float = option(0.5, "alpha of Stage I", minimum=0, maximum=1)
    updates: int = option(1500, "optimiser steps of Stage I", minimum=1)
    iterations: int = option(50, "rollouts of Stage II", minimum=1)
    num_envs: int = option(128, "episodes of a rollout", minimum=1)
    real_coeff: float = option(0.2, "beta of Stage II", minimum=0)
    advantage: Literal["gae", "mc"] = option(
        "gae", "by a critic, or by returns within groups that start alike"
    )
    eval_every: int = option(25, "rollouts between evaluations", minimum=1)
    curve_episodes: int = option(64, "episodes of each point of a curve", minimum=1)
    eval_episodes: int = option(128, "episodes of the comparison", minimum=1)
    film: bool = option(True, "render frames and a video, where OpenGL is found")


def record(config: Config, folder: Path) -> dict[str, str]:
    """Record what is not recorded yet; return the folders."""
    plan = {
        "sim": ("sim", config.sim_demos, 3 * config.seed),
        "real": ("stand_in", config.real_demos, 3 * config.seed + 1),
        "heldout": ("stand_in", config.heldout_demos, 3 * config.seed + 2),
    }
    seen = config.image != "none"
    folders = {}
    for name, (domain, episodes, seed) in plan.items():
        path = folder / name
        folders[name] = str(path)
        if not path.exists():
            # A recording that was cut off is made anew, under another name until whole.
            part = path.with_suffix(".part")
            shutil.rmtree(part, ignore_errors=True)
            frames = record_demos.record(
                record_demos.Config(
                    out=str(part),
                    task=config.task,
                    domain=domain,
                    episodes=episodes,
                    camera=SIM_CAMERA if seen else None,
                    image_size=config.image_size if seen else None,
                    # Far from the seeds of rollouts and of evaluations.
                    seed=500_000 + seed,
                )
            )
            part.rename(path)
            log.info("recorded %d episodes, %d frames: %s", episodes, frames, path)
    return folders


def stage_two(
    config: Config, folder: Path, demos: dict[str, str], method: str
) -> rl_co.Config:
    """Return the options of a run of Stage II inside a run directory."""
    return rl_co.Config(
        name=method,
        seed=config.seed,
        threads=config.threads,
        task=config.task,
        policy=str(folder / "stages" / "sft" / "policy"),
        real_demos=demos["real"],
        heldout_demos=demos["heldout"],
        real_coeff=0.0 if method == "rl_only" else config.real_coeff,
        iterations=config.iterations,
        num_envs=config.num_envs,
        advantage=config.advantage,
        eval_every=config.eval_every,
        eval_episodes=config.curve_episodes,
        **shared(config, AugmentOptions),
    )


def stage_one(config: Config, demos: dict[str, str], method: str) -> sft.Config:
    """Return the options of a run of Stage I."""
    return sft.Config(
        name=method,
        seed=config.seed,
        threads=config.threads,
        task=config.task,
        sim_demos=demos["sim"],
        real_demos=demos["real"],
        sim_ratio=0.0 if method == "real_only" else config.sim_ratio,
        updates=config.updates,
        **shared(config, PolicyOptions),
    )


def train(config: Config, run: Run, demos: dict[str, str]) -> dict[str, Any]:
    """Train every policy that the methods need; return them by method."""
    needed = set(config.methods)
    if needed & {"rl_only", "rl_co"}:
        needed.add("sft")
    policies: dict[str, Any] = {}
    for method in METHODS:
        if method not in needed:
            continue
        folder = f"stages/{method}"
        if method in ("real_only", "sft"):
            options = stage_one(config, demos, method)
            data = sft.load(options)
            (run.path / "stages").mkdir(exist_ok=True)
            with run.stage(options, "sft", folder) as stage:
                policies[method] = sft.train(options, stage, data)
        else:
            options = stage_two(config, run.path, demos, method)
            start, data = rl_co.load(options)
            with run.stage(options, "rl_co", folder) as stage:
                policies[method] = rl_co.train(options, stage, start, data)
    return {method: policies[method] for method in config.methods}


def compare(config: Config, policies: dict[str, Any]) -> list[Any]:
    """Evaluate every policy in both domains, from the same initial states."""
    from rlco.evaluation import EVALUATION_SEED, evaluate, evaluation_env

    rows = []
    for domain in ("sim", "stand_in"):
        one = next(iter(policies.values()))
        # Other initial states than those of the learning curves.
        env = evaluation_env(
            config.task,
            domain,
            chunk=one.chunk,
            episodes=config.eval_episodes,
            image_size=one.image_size,
            seed=EVALUATION_SEED + 1 + config.seed,
        )
        for method, policy in policies.items():
            result = evaluate(policy, env, config.eval_episodes)
            log.info("%-9s in %-8s: %s", method, domain, result)
            row = result.row(
                method, domain, config.seed, task=config.task, policy=policy.kind
            )
            rows.append(row)
    return rows


def draw(config: Config, run: Run, rows: list[Any], policies: dict[str, Any]) -> None:
    """Draw the figures of the report."""
    from rlco import plots
    from rlco.evaluation import record_video
    from rlco.metrics import read_metrics

    plots.save_figure(plots.success_bars(rows), run.plots / "success.png")
    curves, errors = [], {}
    for method in ("rl_only", "rl_co"):
        if method not in policies:
            continue
        table = read_metrics(run.path / "stages" / method / "metrics.csv")
        for domain in ("sim", "stand_in"):
            name = f"success_{domain}"
            points = [row for row in table if name in row]
            curves.append(
                plots.Curve(
                    method,
                    domain,
                    [row["frames"] for row in points],
                    [[row[name] for row in points]],
                    config.curve_episodes,
                )
            )
        points = [row for row in table if "imitation_error_heldout" in row]
        errors[method] = (
            [row["frames"] for row in points],
            [row["imitation_error_heldout"] for row in points],
        )
        points = [row for row in table if "grad_cosine" in row]
        if points:
            figure = plots.gradient_terms(
                [row["step"] for row in points],
                [row["grad_norm_sim"] for row in points],
                [row["grad_norm_real"] for row in points],
                [row["grad_cosine"] for row in points],
            )
            plots.save_figure(figure, run.plots / "gradients.png")
    if curves:
        plots.save_figure(plots.learning_curves(curves), run.plots / "curves.png")
        plots.save_figure(plots.imitation_error(errors), run.plots / "forgetting.png")
    if not config.film:
        return
    method, policy = list(policies.items())[-1]
    try:
        path = run.videos / f"{method}_stand_in.mp4"
        frames = record_video(policy, config.task, "stand_in", path, chunk=policy.chunk)
    except RenderingError as error:
        log.warning("no frames in the report: %s", error)
        return
    some = range(0, len(frames), max(1, len(frames) // 5))
    figure = plots.episode_strip(
        [frames[i] for i in some], [i * policy.chunk / 20 for i in some], "stand_in"
    )
    plots.save_figure(figure, run.plots / "episode.png")


def main(config: Config) -> None:
    """Run the chain, and write the report."""
    for method in config.methods:
        if method not in METHODS:
            raise UnknownNameError("method", method, METHODS)
    from rlco.physics.task import make_task
    from rlco.report import write_report

    make_task(config.task)
    nowhere = {"sim": "", "real": "", "heldout": ""}
    rl_co.check(stage_two(config, Path(), nowhere, "rl_co"))
    sft.check(stage_one(config, nowhere, "sft"))
    with Run(config, "quickstart") as run:
        demos = record(config, run.path / "data")
        policies = train(config, run, demos)
        rows = compare(config, policies)
        run.save_results(rows)
        draw(config, run, rows, policies)
    report = write_report(
        run.path,
        notes=[
            "stand_in is a second simulator that plays the robot's part. "
            "No robot moved for this report."
        ],
    )
    log.info("report: %s", report)


if __name__ == "__main__":
    run_recipe(main, Config)
