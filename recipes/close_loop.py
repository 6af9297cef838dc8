"""Close the loop: hide an effect, find it in logs, and train with what was found.

    uv run recipes/close_loop.py
    uv run recipes/close_loop.py hidden=effects.yaml seeds=[0]

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
from rlco.runs.config import option
from rlco.training.policy_options import KindOptions, group_values
from rlco.training.stage_one import StageOneOptions

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    from rlco.physics.effects import AppliedEffect
    from rlco.physics.spec.task import Array, SceneState
    from rlco.reporting.statistics import ResultRow

log = logging.getLogger("rlco.close_loop")
METHODS = ("nominal", "corrected", "oracle")
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


def record_logs(config: Config, hidden: Path, folder: Path) -> None:
    """Let the arm move freely where the effect is; write NPZ files of what it reports.

    Each row has the joint positions that the encoders report, with a noise of 0.1 mrad,
    and the torques that the controller sent to the joints, with one of 0.05 N m.
    """
    from dataclasses import replace

    import numpy as np

    from rlco.physics.native.stepper import NativeStepper
    from rlco.physics.spec.domain import make_domain
    from rlco.physics.tasks.make_task import make_task

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
    arm = stepper.worlds.control.arm_ctrl
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

    from rlco.physics.mj.rotations import rotation_vector

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
    from rlco.gap import load_model
    from rlco.gap.correct.corrected_files import corrected_xml
    from rlco.physics.effects.names import in_model
    from rlco.physics.tasks.plain_robosuite import make_robosuite

    env = make_robosuite(config.task, domain=config.simulator)
    path.write_text(env.edit_model_xml(env.model.get_xml()))
    # The effects of the simulator's domain are known, too.
    loaded = load_model(path)
    effects = in_model(env.domain.model_effects, loaded.model)
    path.write_text(corrected_xml(loaded, effects, path.parent))


def find(config: Config, run: Run, hidden: Path) -> Path:
    """Record, find the gap, and return what was found."""
    from rlco.gap import run_gap
    from rlco.runs.run_folder import command_line

    logs, model, out = (run.path / name for name in ("logs", "nominal.xml", "gap"))
    if not (out / "report.html").exists():
        for old in (logs, out):
            shutil.rmtree(old, ignore_errors=True)
        record_logs(config, hidden, logs)
        write_model(config, model)
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
        task=config.task,
        sim_ratio=1.0,
        updates=config.updates,
        effects_code=config.effects_code,
        **given,
        **group_values(config, KindOptions),
    )


def compare(config: Config, run: Run, found: Path, hidden: Path) -> list[ResultRow]:
    """Train by every method and seed, and evaluate where the effect is."""
    from rlco.evaluation import EVALUATION_SEED, evaluate, evaluation_env
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
                seed=EVALUATION_SEED + 2 + seed,
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
        The loss of success, mean over seeds, and the share of it that is gone.
    """
    rates = {
        method: [r["successes"] / r["episodes"] for r in rows if r["method"] == method]
        for method in METHODS
    }
    nominal, corrected, oracle = (sum(rates[m]) / len(rates[m]) for m in METHODS)
    loss = oracle - nominal
    return loss, (corrected - nominal) / loss if loss > 0 else float("nan")


def main(config: Config) -> None:
    """Run the loop, and write the report."""
    from rlco.evaluation import evaluation_domains
    from rlco.physics.effects import load_code
    from rlco.physics.tasks.make_task import make_task
    from rlco.reporting import plots
    from rlco.reporting.report import write_report
    from rlco.training.stage_one import new_policy

    # What is wrong shows before a folder is made.
    load_code(config.effects_code)
    make_task(config.task)
    (simulator,) = evaluation_domains(config.task, [config.simulator])
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
    result = (
        f"Success where the effect is: trained in the nominal simulator it is "
        f"{100 * loss:.0f} points below training where the effect is; "
        f"{100 * gone:.0f} % of that is won back in the corrected simulator."
    )
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
