"""Close the loop: hide an effect, find it in logs, and train with what was found.

    uv run recipes/close_loop.py
    uv run recipes/close_loop.py hidden=effects.yaml seeds=[0]

An effect that no simulator here is told of is added to ``stand_in``, the second
simulator that plays the robot's part; no robot moves. Logs are recorded there, of joint
positions and torques while the arm moves freely. find_gap.py compares them with the
simulator as it is known and writes effects.yaml. Then three policies imitate the same
number of demonstrations of the same expert, recorded in the nominal simulator, in the
mended one, and where the effect is (oracle), and are compared where the effect is.
"""

from __future__ import annotations

import logging
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import find_gap
import record_demos
import sft

from rlco.config import RunOptions, option
from rlco.run import Run, run_recipe

if TYPE_CHECKING:
    from rlco.physics.effects import AppliedEffect
    from rlco.statistics import ResultRow

log = logging.getLogger("rlco.close_loop")
METHODS = ("nominal", "mended", "oracle")


@dataclass
class Config(RunOptions):
    """Options of close_loop.py."""

    name: str = option("close_loop", "name of the run, a part of its folder's name")
    task: str = option("push_cube", "name of the task")
    simulator: str = option("stand_in", "domain in which all else takes place")
    hidden: str | None = option(
        None, "effects.yaml of what is hidden; null: a cable that pulls at the base"
    )
    seeds: list[int] = option([0, 1, 2], "one comparison each", minimum=0)
    recordings: int = option(6, "recordings of the arm", minimum=2)
    seconds: float = option(10.0, "length of a recording [s]", minimum=2)
    demos: int = option(40, "demonstrations for each policy", minimum=1)
    updates: int = option(1500, "optimiser steps for each policy", minimum=1)
    eval_episodes: int = option(128, "episodes of the comparison", minimum=1)


def hide(config: Config, path: Path) -> list[AppliedEffect]:
    """Write down what is hidden, and return it."""
    from rlco.physics.effects import AppliedEffect
    from rlco.physics.effects.effects_file import read_effects, write_effects

    if config.hidden is not None:
        effects = list(read_effects(config.hidden).effects)
    else:
        effects = [AppliedEffect("torque_bias", "joint1", {"torque": 5.0})]
    if not path.exists():
        write_effects(path, effects)
    return effects


def record_logs(config: Config, hidden: Path, folder: Path) -> None:
    """Let the arm move freely where the effect is; write NPZ files of what it tells.

    Each row has the joint positions that the encoders tell, with a noise of 0.1 mrad,
    and the torques that the controller sent to the joints, with one of 0.05 N m.
    """
    from dataclasses import replace

    import numpy as np

    from rlco.physics.domain import make_domain
    from rlco.physics.native import NativeStepper
    from rlco.physics.task import make_task

    # Rows are as frequent as control steps.
    task = replace(make_task(config.task), control_frequency=100)
    count, rows = config.recordings, round(100 * config.seconds)
    stepper = NativeStepper(
        task, make_domain(config.simulator), num_envs=count, effects=str(hidden)
    )
    rng = np.random.default_rng(config.seed)
    state = stepper.reset([task.sample(rng, None) for _ in range(count)])
    low, high = np.array([-0.15, -0.25, 1.0]), np.array([0.10, 0.25, 1.25])
    arm = stepper.copies.control.arm_ctrl
    position, torque = np.zeros((2, rows, count, arm.size))
    action = np.zeros((count, 1, 7))
    for row in range(rows):
        if row % 150 == 0:  # a new place, and a new turn of the hand
            goal = rng.uniform(low, high, (count, 3))
            turn = rng.uniform(-0.15, 0.15, (count, 3))
        wanted = np.zeros((count, 7))
        wanted[:, :3] = np.clip(4.0 * (goal - state.tool_position), -0.5, 0.5)
        wanted[:, 3:6] = turn * np.cos(2 * np.pi * row / 150)
        action[:, 0] += 0.06 * (wanted - action[:, 0])  # people do not jerk
        state = stepper.step(action).at(np.s_[:, 1])
        position[row] = stepper.reported_state().joint_position
        torque[row] = [data.ctrl[arm] for data in stepper.data]
    position += 1e-4 * rng.standard_normal(position.shape)
    torque += 0.05 * rng.standard_normal(torque.shape)
    model = stepper.model
    names = [model.joint(j).name for j in model.actuator_trnid[arm, 0]]
    folder.mkdir()
    for number in range(count):
        np.savez(
            folder / f"{number}.npz",
            time=np.arange(rows) / 100,
            position=position[:, number],
            torque=torque[:, number],
            joint_names=np.array(names),
        )


def write_model(config: Config, path: Path) -> None:
    """Write the simulator's model as it is known, without what is hidden."""
    from rlco.physics.tabletop import make_robosuite

    env = make_robosuite(config.task, domain=config.simulator)
    path.write_text(env.edit_model_xml(env.model.get_xml()))


def find(config: Config, run: Run, hidden: Path) -> Path:
    """Record, find the gap, and return what was found."""
    logs, model, out = (run.path / name for name in ("logs", "nominal.xml", "gap"))
    if not (out / "report.html").exists():
        for old in (logs, out):
            shutil.rmtree(old, ignore_errors=True)
        record_logs(config, hidden, logs)
        write_model(config, model)
        find_gap.main(find_gap.Config(model=str(model), data=str(logs), out=str(out)))
    return out / "effects.yaml"


def train(config: Config, run: Run, method: str, seed: int, effects: str | None) -> Any:
    """Record demonstrations under these effects, and imitate them."""
    name = f"{method}_s{seed}"
    demos = run.path / "demos" / name
    if not demos.exists():
        # A recording that was cut off is made anew, under another name until whole.
        part = demos.with_suffix(".part")
        shutil.rmtree(part, ignore_errors=True)
        record_demos.record(
            record_demos.Config(
                out=str(part),
                task=config.task,
                domain=config.simulator,
                episodes=config.demos,
                effects=effects,
                seed=600_000 + seed,  # far from the seeds of evaluations
            )
        )
        part.rename(demos)
    options = sft.Config(
        name=method,
        seed=seed,
        threads=config.threads,
        task=config.task,
        sim_demos=str(demos),
        sim_ratio=1.0,
        updates=config.updates,
    )
    data = sft.load(options)
    (run.path / "stages").mkdir(exist_ok=True)
    with run.stage(options, "sft", f"stages/{name}") as stage:
        return sft.train(options, stage, data)


def compare(config: Config, run: Run, found: Path, hidden: Path) -> list[ResultRow]:
    """Train by every method and seed, and evaluate where the effect is."""
    from rlco.evaluation import EVALUATION_SEED, evaluate, evaluation_env

    effects = {"nominal": None, "mended": str(found), "oracle": str(hidden)}
    rows = []
    for seed in config.seeds:
        for method in METHODS:
            policy = train(config, run, method, seed, effects[method])
            env = evaluation_env(
                config.task,
                config.simulator,
                chunk=policy.chunk,
                episodes=config.eval_episodes,
                effects=str(hidden),
                seed=EVALUATION_SEED + 2 + seed,
            )
            result = evaluate(policy, env, config.eval_episodes)
            log.info("seed %d, %-7s: %s", seed, method, result)
            rows.append(
                result.row(
                    method,
                    config.simulator,
                    seed,
                    task=config.task,
                    policy=policy.kind,
                )
            )
    return rows


def shrinkage(rows: list[ResultRow]) -> tuple[float, float]:
    """Return what the nominal policies lose to the oracle, and how much is mended.

    Returns:
        The loss of success, mean over seeds, and the share of it that is gone.
    """
    rates = {
        method: [r["successes"] / r["episodes"] for r in rows if r["method"] == method]
        for method in METHODS
    }
    nominal, mended, oracle = (sum(rates[m]) / len(rates[m]) for m in METHODS)
    loss = oracle - nominal
    return loss, (mended - nominal) / loss if loss > 0 else float("nan")


def main(config: Config) -> None:
    """Run the loop, and write the report."""
    from rlco import plots
    from rlco.physics.domain import make_domain
    from rlco.physics.task import make_task
    from rlco.report import write_report

    make_task(config.task)
    make_domain(config.simulator)
    with Run(config, "close_loop") as run:
        hidden = run.path / "hidden.yaml"
        effects = hide(config, hidden)
        (run.path / "demos").mkdir(exist_ok=True)
        found = find(config, run, hidden)
        rows = compare(config, run, found, hidden)
        run.save_results(rows)
        plots.save_figure(plots.success_bars(rows), run.plots / "success.png")
        loss, gone = shrinkage(rows)
    told = "; ".join(f"{e.name} {e.target} {dict(e.parameters)}" for e in effects)
    said = (
        f"Success where the effect is: trained in the nominal simulator it is "
        f"{100 * loss:.0f} points below training where the effect is; "
        f"{100 * gone:.0f} % of that is won back in the mended simulator."
    )
    log.info(said)
    report = write_report(
        run.path,
        notes=[
            f"Hidden in {config.simulator}: {told}.",
            said,
            f"{config.simulator} is a simulator that plays the robot's part. "
            "No robot moved for this report.",
        ],
    )
    log.info("report: %s", report)


if __name__ == "__main__":
    run_recipe(main, Config)
