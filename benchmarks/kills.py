"""Kill every recipe at random moments, go on, and compare with one left alone.

    OMP_NUM_THREADS=1 uv run benchmarks/kills.py kills=20
    OMP_NUM_THREADS=1 uv run benchmarks/kills.py recipes=sft,rl_co:5 seed=7

A recipe with small settings runs once to its end. Then it is started again as often as
asked for, ended by ``kill -9`` after a random part of that time, and resumed; where a
recipe has no ``resume=``, it is started anew, without what a kill left where that is
refused. What it leaves must be the same to the
byte: tables, weights, checkpoints, demonstrations and results; not the times in them.
Processes are forked from one that has loaded the libraries, so that kills fall into
the recipe's own work, not into its imports.
"""

from __future__ import annotations

import functools
import hashlib
import importlib
import json
import os
import random
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.context import ForkProcess
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from safetensors import safe_open

import rlco.gap
from rlco.errors import RlcoError
from rlco.lerobot_files import read_folder
from rlco.physics.effects import EFFECTS
from rlco.run import run_recipe
from rlco.runs.whole_files import UNFINISHED

RECIPES = Path(__file__).parents[1] / "recipes"
#: Names of files that tell times, or are drawn; a run's own checkpoints hold the rest.
_VOLATILE = {"run.json", "timings.csv", "log.txt", "attempts.json"}
_COMPARED = {
    ".csv",
    ".json",
    ".safetensors",
    ".parquet",
    ".npz",
    ".yaml",
    ".xml",
    ".diff",
    ".md",
}
_TIMES = {"seconds", "cpu_seconds", "finished", "attempts", "minutes", "command"}
_SMALL_ARM = """<mujoco model="arm"><compiler angle="radian"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.2"/>
<geom type="capsule"
fromto="0 0 0 .2 0 0" size=".02"/></body></worldbody><actuator>
<position name="m1" joint="shoulder" kp="20" kv="1"/></actuator></mujoco>"""

_JOB = '''"""Count in a file, and go on where it was."""
import json, sys, time
from pathlib import Path

given = dict(argument.split("=", 1) for argument in sys.argv[1:])
out = Path(given.get("resume") or given["out"])
out.mkdir(exist_ok=True)
for name in ("config.yaml", "run.json"):
    (out / name).write_text("{}")
done = len((out / "steps.txt").read_text()) if (out / "steps.txt").exists() else 0
for step in range(done, int(given["steps"])):
    with (out / "steps.txt").open("a") as file:
        file.write(".")
    time.sleep(0.05)
seed = int(given["seed"])
row = {"method": "count", "domain": "sim", "episodes": 9, "successes": seed}
(out / "metrics.csv").write_text("step,success_sim\\n1,.5\\n")
(out / "results.json").write_text(json.dumps({"rows": [row | {"seed": seed}]}))
'''


@dataclass(frozen=True)
class Case:
    """A recipe with small settings.

    Attributes:
        recipe: Its name.
        options: But for ``out``.
        goes_on: How it goes on after a kill: ``resume``, ``same`` (the same command
            again), or ``anew`` (that too; what it refuses is taken away first).
    """

    recipe: str
    options: tuple[str, ...]
    goes_on: str = "resume"


def start(recipe: str, options: list[str], log: Path) -> ForkProcess:
    """Run a recipe in a process of its own, forked from this one."""
    process = get_context("fork").Process(target=_run, args=(recipe, options, log))
    process.start()
    return process


def _run(recipe: str, options: list[str], log: Path) -> None:
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    module: Any = importlib.import_module(recipe)
    run_recipe(module.main, module.Config, options)


def ended(process: ForkProcess, within: float | None = None) -> int | None:
    """Wait for a process; return its status, None if it runs on after so long [s]."""
    process.join(within)
    return process.exitcode


def to_its_end(recipe: str, options: list[str], log: Path) -> None:
    """Run a recipe to its end.

    Raises:
        RuntimeError: It failed; the end of its log is quoted.
    """
    if (status := ended(start(recipe, options, log))) != 0:
        tail = log.read_text("utf-8", "replace")[-1500:]
        raise RuntimeError(f"{recipe} ended with status {status}:\n{tail}")


def without_times(content: Any) -> Any:
    """Return what a JSON file holds without its times."""
    if isinstance(content, Mapping):
        return {k: without_times(v) for k, v in content.items() if k not in _TIMES}
    if isinstance(content, list):
        return [without_times(value) for value in content]
    return content


def tensors_of(path: Path) -> bytes:
    """Return what a safetensors file holds; its header has no fixed order."""
    with safe_open(path, framework="pt") as file:
        header = {k: v for k, v in (file.metadata() or {}).items() if k != "checksum"}
        parts = [json.dumps(header, sort_keys=True).encode()]
        for name in sorted(file.keys()):
            tensor = file.get_tensor(name)
            parts += [f"{name} {tensor.dtype} {tensor.shape}".encode()]
            parts += [tensor.reshape(-1).view(torch.uint8).numpy().tobytes()]
    return b"".join(parts)


def left(folder: Path) -> dict[str, str]:
    """Return the digest of every file that two runs of a recipe have alike."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if not path.is_file() or path.name in _VOLATILE:
            continue
        if path.suffix not in _COMPARED or path.is_symlink():
            continue
        content = path.read_bytes()
        if path.suffix == ".json":
            content = json.dumps(without_times(json.loads(content))).encode()
        if path.suffix == ".safetensors":
            content = tensors_of(path)
        found[str(path.relative_to(folder))] = hashlib.sha256(content).hexdigest()
    return found


# -- What the recipes need, made once ----------------------------------------------


def write_logs(folder: Path) -> None:
    """Write a model of one joint, and logs of one that a friction slows."""
    import mujoco

    folder.mkdir()
    (folder / "arm.xml").write_text(_SMALL_ARM)
    rubbed = _SMALL_ARM.replace('damping="0.2"', 'damping="0.2" frictionloss="0.4"')
    model = mujoco.MjModel.from_xml_string(rubbed)
    for number in range(4):
        data = mujoco.MjData(model)
        rows = []
        for step in range(600):
            data.ctrl[:] = np.sin(0.004 * (1 + number) * step) * (0.5 + 0.1 * number)
            rows.append([data.time, data.qpos[0], data.ctrl[0]])
            for _ in range(5):
                mujoco.mj_step(model, data)
        lines = [",".join(f"{value:.6f}" for value in row) for row in rows]
        header = "time,shoulder_position,command_m1"
        name = f"log{number}.csv"
        (folder / name).write_text("\n".join([header, *lines]) + "\n")


def make_cases(place: Path, wanted: list[str]) -> Iterator[Case]:
    """Make the inputs of the recipes, and yield each with its options."""
    sim, real, log = place / "sim", place / "real", place / "made.txt"
    record = ("domain=sim", "episodes=2")
    sft = (f"sim_demos={sim}", f"real_demos={real}", "updates=300", "log_every=20")
    sft += ("batch_size=16", "hidden=[32]", "eval_episodes=0")
    policy = place / "sft"
    rl_co = (f"policy={policy / 'policy'}", f"real_demos={real}", "iterations=6")
    rl_co += ("num_envs=2", "epochs=1", "minibatch=30", "real_rows=8", "eval_every=3")
    rl_co += ("critic_iterations=1", "eval_episodes=2", "eval_domains=[sim]")
    rl_co += (f"heldout_demos={real}", "keep=best")
    quick = ("sim_demos=1", "real_demos=1", "heldout_demos=1", "updates=40")
    quick += ("iterations=2", "num_envs=3", "eval_every=1", "curve_episodes=2")
    quick += ("eval_episodes=2", "film=false")
    loop = ("seeds=[3]", "seconds=4", "demos=1", "updates=60", "eval_episodes=2")
    tiny = ("config=debug", f"policy={place / 'tiny'}", "real_coeff=0", "horizon=8")
    given = {
        "record_demos": Case("record_demos", record, "anew"),
        "sft": Case("sft", sft),
        "rl_co": Case("rl_co", rl_co),
        "find_gap": Case(
            "find_gap",
            (f"model={place / 'logs/arm.xml'}", f"data={place / 'logs'}", "threads=1"),
            "anew",
        ),
        "compare": Case(
            "compare", (f"experiment={place / 'small.yaml'}", "nice=0"), "same"
        ),
        "quickstart": Case("quickstart", quick),
        "close_loop": Case("close_loop", loop),
        "lerobot_co_train": Case(
            "lerobot_co_train",
            (*tiny, "eval_episodes=0", "iterations=3", "save_every=1", "lr=1e-3"),
        ),
    }
    if needs_demos := {"sft", "rl_co"} & set(wanted):
        for folder, domain in ((sim, "sim"), (real, "stand_in")):
            options = [f"domain={domain}", "episodes=2", f"out={folder}"]
            to_its_end("record_demos", options, log)
    if "rl_co" in needs_demos:
        to_its_end("sft", [*sft, f"out={policy}"], log)
    if "find_gap" in wanted:
        write_logs(place / "logs")
    if "compare" in wanted:
        (place / "job.py").write_text(_JOB)
        (place / "small.yaml").write_text(yaml.safe_dump(experiment()))
    if "lerobot_co_train" in wanted:
        from rlco.policies.tiny.smolvla import write_tiny_smolvla

        write_tiny_smolvla(place / "tiny")
    for name in wanted:
        yield given[name]


def experiment() -> dict[str, Any]:
    """Return an experiment of three seeds of a job that needs no library."""
    options = {"seed": "{seed}", "steps": 20}
    return {
        "name": "small",
        "over": {"seed": [1, 2, 3]},
        "jobs": {"count": {"script": "job.py", "minutes": 1, "options": options}},
        "table": {"methods": {"count": {"job": "count"}}},
    }


@contextmanager
def few_effects() -> Iterator[None]:
    """Let searches of gaps look at five effects: a kill needs no longer search."""
    known = {"joint_offset", "torque_bias", "encoder_scale", "payload"}
    known |= {"coulomb_friction"}
    whole = rlco.gap.run_gap
    rlco.gap.run_gap = functools.partial(whole, exclude=set(EFFECTS) - known)
    try:
        yield
    finally:
        rlco.gap.run_gap = whole


#: Modules that recipes import when they are under way.
WARM = (
    "torch.utils.tensorboard",
    "rlco.collectors",
    "rlco.evaluation",
    "rlco.training.learner",
    "rlco.training.stage_one",
    "rlco.training.stage_two",
)


def warm(recipes: list[str]) -> None:
    """Load what the recipes load, and their compiled functions, before any fork."""
    for module in (*recipes, *WARM):
        importlib.import_module(module)
    from rlco.envs import make_env

    env = make_env("push_cube", num_envs=1, horizon=2, threads=1)
    env.rollout(2)
    env.close()


# -- Kills -------------------------------------------------------------------------


def state_of(out: Path, whole: dict[str, str]) -> str:
    """Say what a killed recording or search left."""
    if not out.exists():
        part = unfinished(out)
        written = part.exists() and any(part.iterdir())
        return "a part, of another name" if written else "nothing"
    if left(out) == whole:
        return "all of it"
    if (out / "meta").is_dir():
        try:
            read_folder(out)
        except RlcoError:
            return "a part, refused"
        return "a part, read as whole"
    return "a part"


def unfinished(out: Path) -> Path:
    """Return what a folder is called until it is whole."""
    return out.with_name(out.name + UNFINISHED)


def take_away(out: Path) -> None:
    """Take away what a command refuses; an empty part of a folder is none of it."""
    shutil.rmtree(out, ignore_errors=True)
    part = unfinished(out)
    if part.exists() and any(part.iterdir()):
        shutil.rmtree(part)


def spent() -> float:
    """Return the processor time of all processes that were started and ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def kill_and_go_on(case: Case, place: Path, kills: int, draw: random.Random) -> Counter:
    """Return how often a recipe was killed, and what became of it."""
    out, log = place / "run", place / f"{case.recipe}.txt"
    begin = [*case.options, f"out={out}"]
    began, before = time.monotonic(), spent()
    to_its_end(case.recipe, begin, log)
    lasted = time.monotonic() - began
    whole = left(out)
    shutil.rmtree(out)
    counts: Counter[str] = Counter({"files": len(whole)})
    counts["seconds"] = round(lasted)
    counts["processor"] = round(spent() - before)
    while counts["killed"] < kills:
        process, began = start(case.recipe, begin, log), time.monotonic()
        part = (counts["killed"] + draw.random()) / kills  # spread over all of it
        if ended(process, part * lasted) is None:
            process.kill()
            process.join()
            counts["killed"] += 1
        else:  # faster than the last that was left alone: it is none of the kills
            lasted = time.monotonic() - began
            shutil.rmtree(out, ignore_errors=True)
            continue
        if case.goes_on == "anew":
            counts[state_of(out, whole)] += 1
            take_away(out)
        elif case.goes_on == "same":
            time.sleep(1)  # its jobs end with it, not before it
        options = [f"resume={out}"]
        if case.goes_on != "resume" or not out.exists():
            options = begin
        status = ended(start(case.recipe, options, log))
        found = left(out) if status == 0 else {}
        if found == whole:
            counts["equal"] += 1
        else:
            counts["different"] += 1
            both = found.keys() | whole.keys()
            names = [n for n in sorted(both) if found.get(n) != whole.get(n)]
            print(f"{case.recipe}: status {status}, differ: {names[:8]}")
            shutil.move(out, place / f"{case.recipe} {counts['different']}")
        shutil.rmtree(out, ignore_errors=True)
    counts["minutes"] = round((spent() - before) / 60, 1)
    return counts


def main() -> None:
    given = dict(argument.split("=", 1) for argument in sys.argv[1:])
    kills, seed = int(given.get("kills", 20)), int(given.get("seed", 0))
    names = "record_demos,sft,rl_co,find_gap,compare,lerobot_co_train,quickstart,"
    asked = given.get("recipes", names + "close_loop").split(",")
    often = {one.split(":")[0]: int(one.partition(":")[2] or kills) for one in asked}
    names = list(often)
    place = Path(given.get("place") or tempfile.mkdtemp())
    place.mkdir(exist_ok=True)
    sys.path.insert(0, str(RECIPES))
    torch.set_num_threads(1)
    warm(names)
    print(
        "| recipe | seconds | of the processor | files compared | kills | equal |",
        end="",
    )
    print(" different | processor minutes of all | left |")
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    with few_effects():
        for case in make_cases(place, names):
            draw = random.Random(f"{case.recipe} {seed}")
            counts = kill_and_go_on(case, place, often[case.recipe], draw)
            states = ("nothing", "all of it", "a part", "a part, refused")
            states += ("a part, of another name", "a part, read as whole")
            said = ", ".join(f"{s}: {counts[s]}" for s in states if counts[s])
            columns = ("seconds", "processor", "files", "killed", "equal", "different")
            columns += ("minutes",)
            cells = " | ".join(str(counts[name]) for name in columns)
            print(f"| {case.recipe} | {cells} | {said} |", flush=True)


if __name__ == "__main__":
    main()
