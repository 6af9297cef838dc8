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
from policy_options import KindOptions, shared

from rlco.config import option
from rlco.run import Run, run_recipe

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    from rlco.physics.effects import AppliedEffect
    from rlco.physics.task import Array, SceneState
    from rlco.statistics import ResultRow

log = logging.getLogger("rlco.close_loop")
METHODS = ("nominal", "mended", "oracle")
ROWS = 100  # of a recording in a second
# Recordings start about this posture, above the table and far from the joints' limits,
# at most so far from it [rad].
POSTURE = (0.0, 0.0, 0.0, -2.1, 0.0, 2.2, 0.79)
SPREAD = (1.2, 0.15, 0.3, 0.15, 0.3, 0.2, 0.8)
REACH = (0.08, 0.18, 0.1, 0.2, 0.2, 0.2)  # of the tool's swings [m, rad]
GAIN = (5.0, 5.0, 5.0, 2.0, 2.0, 2.0, 0.0)  # of actions that follow them [1/m, 1/rad]


@dataclass
class Config(KindOptions):
    """Options of close_loop.py."""

    name: str = option("close_loop", "name of the run, a part of its folder's name")
    task: str = option("push_cube", "name of the task")
    simulator: str = option("stand_in", "domain in which all else takes place")
    hidden: str | None = option(
        None, "effects.yaml of what is hidden; null: a joint's encoder off by 3 degrees"
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
        effects = [AppliedEffect("joint_offset", "joint2", {"offset": 0.05})]
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

    # A torque that is read once in a longer control step is off by what damping has
    # taken since that step began; so each physics step, of 2 ms, is one.
    task = replace(make_task(config.task), control_frequency=500)
    count, rows = config.recordings, round(ROWS * config.seconds)
    stepper = NativeStepper(
        task, make_domain(config.simulator), num_envs=count, effects=str(hidden)
    )
    rng = np.random.default_rng(config.seed)
    postures = POSTURE + np.array(SPREAD) * rng.uniform(-1.0, 1.0, (count, 7))
    first = [replace(task.sample(rng, None), joint_position=q) for q in postures]
    stepper.reset(first)
    drive = free_motion(stepper.reported_state(), rng)
    arm = stepper.copies.control.arm_ctrl
    position, torque = np.zeros((2, rows, count, arm.size))
    for row in range(rows):
        action = drive(row / ROWS, stepper.reported_state())
        stepper.step(np.repeat(action[:, None], 500 // ROWS, axis=1))
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
            time=np.arange(rows) / ROWS,
            position=position[:, number],
            torque=torque[:, number],
            joint_names=np.array(names),
        )


def free_motion(
    start: SceneState, rng: np.random.Generator
) -> Callable[[float, SceneState], Array]:
    """Return what swings the tool about where it starts, each axis at its own pace.

    Returns:
        From a time [s] and the reported state, leading axes (N,), to actions (N, 7).
    """
    import numpy as np

    from rlco.physics.rotations import rotation_vector

    count = len(start.tool_position)
    pace = 2.0 * np.pi * rng.uniform(0.14, 0.26, (count, 6))  # [rad/s]
    reach = np.array(REACH) * rng.choice([-1.0, 1.0], (count, 6))

    def drive(time: float, state: SceneState) -> Array:
        away = reach * np.sin(pace * time)
        turned = state.tool_rotation @ np.swapaxes(start.tool_rotation, -1, -2)
        action = np.zeros((count, 7))
        action[:, :3] = start.tool_position + away[:, :3] - state.tool_position
        action[:, 3:6] = away[:, 3:] - rotation_vector(turned)
        return np.clip(action * GAIN, -1.0, 1.0)

    return drive


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
        **shared(config, KindOptions),
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
    sft.new_policy(sft.Config(task=config.task, **shared(config, KindOptions)))
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
