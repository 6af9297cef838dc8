"""Frames a second of Stage II, collecting and learning, on both backends.

    uv run benchmarks/stage_two.py
    uv run benchmarks/stage_two.py of=images num_envs=128 horizon=64

Records a few demonstrations, trains Stage I for a moment, then runs recipes/rl_co.py on
each backend in turns, and prints what a rollout costs and where its time goes. With
``of=images`` the variants are a policy on poses, and one on two cameras whose encoder
is fixed, or trained on, all on the native backend. The policy learns little here: it is
the time that counts.
"""

from __future__ import annotations

import csv
import statistics
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rlco.run import run_recipe
from rlco.runs.config import option

RECIPES = Path(__file__).parents[1] / "recipes"
CAMERAS = ("camera=agentview,robot0_eye_in_hand", "image_size=64")
FROM_IMAGES = (
    *CAMERAS,
    "image=dense",
    "use_environment_state=false",
    "pretrain_scenes=200",
    "pretrain_passes=1",
    "image_fixed=true",
)
#: Options of each variant beside the shared ones, and whether its policy reads images.
VARIANTS: dict[str, dict[str, tuple[list[str], bool]]] = {
    "backends": {
        "native": (["backend=native"], False),
        "robosuite": (["backend=robosuite"], False),
    },
    "images": {
        "poses": ([], False),
        "images, encoder fixed": (["image_fixed=true"], True),
        "images, encoder trained": (["image_lr=0.1"], True),
    },
}
Row = dict[str, float]


@dataclass
class Config:
    """Options of stage_two.py."""

    of: Literal["backends", "images"] = option("backends", "what is compared")
    task: str = option("push_cube", "name of the task")
    num_envs: int = option(32, "episodes of a rollout", minimum=1)
    horizon: int = option(32, "control steps of an episode", minimum=1)
    iterations: int = option(3, "rollouts of a run; the first is not counted")
    turns: int = option(2, "runs of each variant", minimum=1)


def recipe(name: str, *options: str) -> None:
    """Run a recipe, quietly."""
    command = [sys.executable, str(RECIPES / f"{name}.py"), *options]
    subprocess.run(command, check=True, capture_output=True)


def prepare(config: Config, folder: Path, *, images: bool) -> list[str]:
    """Record and imitate; return the options of Stage II."""
    demos, run = folder / "demos", folder / "sft"
    task = f"task={config.task}"
    where = (f"out={demos}", task, "domain=stand_in", "episodes=3")
    recipe("record_demos", *where, *(CAMERAS if images else ()))
    few = ("updates=50", "eval_episodes=0", "sim_ratio=0")
    given = (f"real_demos={demos}", *few, *(FROM_IMAGES if images else ()))
    recipe("sft", f"out={run}", task, *given)
    return [task, f"policy={run / 'policy'}", f"real_demos={demos}"]


def stage_two(config: Config, options: list[str], out: Path) -> list[Row]:
    """Run Stage II; return its timings, without the first rollout's."""
    size = [f"num_envs={config.num_envs}", f"horizon={config.horizon}"]
    more = [*size, f"iterations={config.iterations + 1}", "eval_episodes=0"]
    recipe("rl_co", f"out={out}", *options, *more)
    with (out / "timings.csv").open(newline="") as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    return rows[1:]


def main(config: Config) -> None:
    """Measure and print."""
    variants = VARIANTS[config.of]
    rows: dict[str, list[Row]] = {name: [] for name in variants}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        given = {
            images: prepare(config, folder / f"images_{images}", images=images)
            for images in {images for _, images in variants.values()}
        }
        for turn in range(config.turns):
            for number, (one, (options, images)) in enumerate(variants.items()):
                out = folder / f"{number}_{turn}"
                rows[one] += stage_two(config, [*given[images], *options], out)
    last = list(variants)[-1]
    print(f"| | collect [s] | learn [s] | frames a second | times {last} |")
    print("|---|---|---|---|---|")
    rates = {one: _median(found, "frames_per_second") for one, found in rows.items()}
    for one, found in rows.items():
        collect, learn = _median(found, "collect"), _median(found, "learn")
        times = rates[one] / rates[last]
        print(
            f"| {one} | {collect:.2f} | {learn:.2f} | {rates[one]:.0f} | {times:.2f} |"
        )


def _median(rows: list[Row], part: str) -> float:
    return statistics.median(row[part] for row in rows)


if __name__ == "__main__":
    run_recipe(main, Config)
