"""Close the loop: hide an effect, find it in logs, and train with what was found.

    uv run recipes/close_loop.py
    uv run recipes/close_loop.py hidden=effects.yaml 'seeds=[0]'

An effect that no simulator here knows of is added to ``stand_in``, the second simulator
that plays the robot's part; no robot moves. Logs are recorded there, of joint positions
and torques while the arm moves freely. The gap workflow, that of find_gap.py, compares
them with the simulator as it is known and writes effects.yaml. Then three policies
imitate as many demonstrations of the same expert, recorded in the nominal simulator, in
the corrected one, and where the effect is (oracle); they are compared there.
"""

from __future__ import annotations

import logging
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rlco.run import Run, run_recipe
from rlco.runs.config import folder_name, option
from rlco.training.options.policy_options import KindOptions, group_values
from rlco.training.options.stage_one_options import StageOneOptions

if TYPE_CHECKING:
    from rlco.physics.effects import AppliedEffect
    from rlco.reporting.statistics import ResultRow

log = logging.getLogger("rlco.close_loop")
METHODS = ("nominal", "corrected", "oracle")


@dataclass
class Config(KindOptions):
    """Options of close_loop.py."""

    name: str = option(
        "close_loop", "name of the run, a part of its folder's name", check=folder_name
    )
    task: str = option("push_cube", "name of the task")
    simulator: str = option(
        "stand_in",
        "domain in which all else takes place: a name, MODULE:NAME, or an effects.yaml",
    )
    hidden: str | None = option(
        None, "effects.yaml of what is hidden; null: a joint's encoder off by 3 degrees"
    )
    seeds: list[int] = option([0, 1, 2], "one comparison each", minimum=0)
    recordings: int = option(6, "recordings of the arm", minimum=2)
    seconds: float = option(10.0, "length of a recording [s]", minimum=2)
    demos: int = option(40, "demonstrations for each policy", minimum=1)
    updates: int = option(1500, "optimiser steps for each policy", minimum=1)
    eval_episodes: int = option(128, "episodes of the comparison", minimum=1)
    effects_code: str | None = option(
        None, "Python file that registers effects of your own"
    )


def hide(config: Config, path: Path) -> list[AppliedEffect]:
    """Write down what is hidden, and return it."""
    from rlco.physics.effects import AppliedEffect
    from rlco.physics.effects.effects_file import read_effects, write_effects

    if config.hidden is not None:
        effects = list(read_effects(config.hidden).effects)
    else:
        effects = [AppliedEffect("joint_offset", "joint2", {"offset": 0.05})]
    if not path.exists():
        write_effects(path, effects)
    return effects


def find(config: Config, run: Run, hidden: Path) -> Path:
    """Record, find the gap, and return what was found."""
    from rlco.gap import run_gap
    from rlco.gap.practice_arm import record_arm, write_known_model
    from rlco.runs.run_folder import command_line
    from rlco.runs.whole_files import UNFINISHED

    logs, model, out = (run.path / name for name in ("logs", "nominal.xml", "gap"))
    if not (out / "report.html").exists():
        for old in (logs, out, out.with_name(out.name + UNFINISHED)):
            shutil.rmtree(old, ignore_errors=True)
        record_arm(
            logs,
            config.task,
            config.simulator,
            recordings=config.recordings,
            seconds=config.seconds,
            seed=config.seed,
            effects=str(hidden),
        )
        write_known_model(model, config.task, config.simulator)
        finding = run_gap(model, logs)
        if not finding.complete:
            raise KeyboardInterrupt
        for line in finding.summary():
            log.info("%s", line)
        finding.write(out, command=command_line())
    return out / "effects.yaml"


def train(config: Config, run: Run, method: str, seed: int, effects: str | None) -> Any:
    """Record demonstrations under these effects, and imitate them."""
    from rlco.data import record_once
    from rlco.training.stage_one import load_stage_one, train_stage_one

    name = f"{method}_s{seed}"
    demos = run.path / "demos" / name
    record_once(
        demos,
        config.task,
        config.simulator,
        episodes=config.demos,
        effects=effects,
        seed=600_000 + seed,  # far from the seeds of evaluations
    )
    options = stage_one(config, name=method, seed=seed, sim_demos=str(demos))
    data = load_stage_one(options)
    (run.path / "stages").mkdir(exist_ok=True)
    with run.stage(options, "sft", f"stages/{name}") as stage:
        return train_stage_one(options, stage, data)


def stage_one(config: Config, **given: Any) -> StageOneOptions:
    """Return the options of a run of Stage I, of simulated demonstrations alone."""
    return StageOneOptions(
        threads=config.threads,
        keep_checkpoints=config.keep_checkpoints,
        task=config.task,
        sim_ratio=1.0,
        updates=config.updates,
        effects_code=config.effects_code,
        **given,
        **group_values(config, KindOptions),
    )


def compare(config: Config, run: Run, found: Path, hidden: Path) -> list[ResultRow]:
    """Train by every method and seed, and evaluate where the effect is."""
    from rlco.evaluation import evaluate, evaluation_env, final_states_seed
    from rlco.physics.spec.domain import make_domain

    domain = make_domain(config.simulator)
    effects = {"nominal": None, "corrected": str(found), "oracle": str(hidden)}
    rows = []
    for seed in config.seeds:
        for method in METHODS:
            policy = train(config, run, method, seed, effects[method])
            env = evaluation_env(
                config.task,
                domain,
                chunk=policy.chunk,
                episodes=config.eval_episodes,
                effects=str(hidden),
                seed=final_states_seed(seed),
            )
            result = evaluate(policy, env, config.eval_episodes)
            log.info("seed %d, %-7s: %s", seed, method, result)
            row = result.row(
                method, domain.name, seed, task=config.task, policy=policy.kind
            )
            rows.append(row)
    return rows


def shrinkage(rows: list[ResultRow]) -> tuple[float, float]:
    """Return what the nominal policies lose to the oracle, and how much is won back.

    Returns:
        The loss of success, mean over seeds, and the share of it that is gone: NaN
        where nothing is lost.
    """
    rates = {
        method: [r["successes"] / r["episodes"] for r in rows if r["method"] == method]
        for method in METHODS
    }
    nominal, corrected, oracle = (sum(rates[m]) / len(rates[m]) for m in METHODS)
    loss = oracle - nominal
    return loss, (corrected - nominal) / loss if loss > 0 else float("nan")


def result_of(loss: float, gone: float) -> str:
    """Return in a sentence what `shrinkage` found."""
    nominal = "Success where the effect is: trained in the nominal simulator it is"
    if not loss > 0:
        return f"{nominal} no lower than trained where the effect is."
    return (
        f"{nominal} {100 * loss:.0f} points below training where the effect is; "
        f"{100 * gone:.0f} % of that is won back in the corrected simulator."
    )


def main(config: Config) -> None:
    """Run the loop, and write the report."""
    from rlco.evaluation import evaluation_domains
    from rlco.physics.effects import load_code
    from rlco.physics.tasks.make_task import make_task
    from rlco.physics.tasks.named_task import check_domains
    from rlco.reporting import plots
    from rlco.reporting.report import write_report
    from rlco.training.stage_one import new_policy

    # What is wrong shows before a folder is made.
    load_code(config.effects_code)
    make_task(config.task)
    (simulator,) = evaluation_domains(config.task, [config.simulator])
    check_domains(config.task, [] if config.hidden is None else [config.hidden])
    new_policy(stage_one(config))
    with Run(config, "close_loop") as run:
        hidden = run.path / "hidden.yaml"
        effects = hide(config, hidden)
        (run.path / "demos").mkdir(exist_ok=True)
        found = find(config, run, hidden)
        rows = compare(config, run, found, hidden)
        run.save_results(rows)
        plots.save_figure(plots.success_bars(rows), run.plots / "success.png")
        loss, gone = shrinkage(rows)
    listed = "; ".join(f"{e.name} {e.target} {dict(e.parameters)}" for e in effects)
    result = result_of(loss, gone)
    log.info(result)
    report = write_report(
        run.path,
        notes=[
            f"Hidden in {simulator}: {listed}.",
            result,
            f"{simulator} is a simulator that plays the robot's part. "
            "No robot moved for this report.",
        ],
    )
    log.info("report: %s", report)


if __name__ == "__main__":
    run_recipe(main, Config)
