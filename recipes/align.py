"""Before training, an answer: how much of what sim teaches holds for the robot's data.

    uv run recipes/align.py sim_demos=demos/sim real_demos=demos/stand_in
    uv run recipes/align.py task=null sim_demos=demos/sim real_demos=demos/my_arm

Small policies imitate the simulated demonstrations, the real ones, and both; each is
tested on demonstrations that it has not seen. No simulator is run and no robot moves.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from rlco.files.indices import format_indices, index_list
from rlco.run import Run, run_recipe
from rlco.runs.config import REQUIRED, folder_name, option
from rlco.training.options.limits import LONGEST_CHUNK
from rlco.training.options.policy_options import PolicyOptions, group_values
from rlco.training.options.stage_one_options import StageOneOptions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rlco.reporting.alignment.page import Alignment
    from rlco.training.alignment import Explained

log = logging.getLogger("rlco.align")


@dataclass
class Config(PolicyOptions):
    """Options of align.py."""

    name: str = option(
        "align", "name of the run, a part of its folder's name", check=folder_name
    )
    task: str | None = option(
        "push_cube",
        "name of the task; null: a robot that no simulator has, sizes from the data",
    )
    sim_demos: str = option(REQUIRED, "LeRobot folder of simulated demonstrations")
    real_demos: str = option(REQUIRED, "LeRobot folder of real demonstrations")
    sim_episodes: str = option("", "episodes of sim_demos, 0-19,25; empty: all")
    episodes: str = option("", "the same of real_demos")
    rename: str = option(
        "", "features of real_demos with other names: THEIRS:OURS,THEIRS:OURS"
    )
    real_camera: str | None = option(
        None, "camera of real_demos that is read; null: its only one"
    )
    folds: int = option(
        4,
        "parts of the real demonstrations, each held out once; no more than they are",
        minimum=2,
    )
    chunk: int = option(
        4, "control steps of an action chunk", minimum=1, maximum=LONGEST_CHUNK
    )
    updates: int = option(
        300,
        "optimiser steps of each policy; after many a few demonstrations are known by "
        "heart",
        minimum=1,
    )


class Fold(NamedTuple):
    """Episodes to train on, and those held out, as options take them."""

    sim: str
    sim_held_out: str
    real: str
    real_held_out: str


def main(config: Config) -> None:
    """Train on each part, test on what was held out, and write one page."""
    from rlco.reporting.alignment.page import write_alignment

    check(config)
    folds = split(config)
    with Run(config, "align") as run:
        (run.path / "stages").mkdir(exist_ok=True)
        found = measure(config, run, folds)
        path = write_alignment(run.path, found)
    for line in found.sentences():
        log.info("%s", line)
    log.info("report: %s", path)


def check(config: Config) -> None:
    """Check what the options say of each other, and that both data sets can be read."""
    from rlco.errors import ConfigError
    from rlco.training.stage_one import load_stage_one

    if config.policy != "gaussian":
        raise ConfigError(
            [
                f"policy={config.policy}, but align measures with policy=gaussian, the "
                "one that is trained fastest; leave it out"
            ]
        )
    every = Fold(config.sim_episodes, "", config.episodes, "")
    load_stage_one(stage_options(config, every, "both"))


def split(config: Config) -> list[Fold]:
    """Return what each policy is trained on; every real episode is held out once."""
    real = episodes_of(config.real_demos, config.episodes, "real_demos")
    sim = episodes_of(config.sim_demos, config.sim_episodes, "sim_demos")
    count = min(config.folds, len(real))
    folds = []
    for k in range(count):
        # Of the simulated ones a fifth, in each fold another.
        out, sim_out = set(real[k::count]), set(sim[k % 5 :: 5])
        folds.append(
            Fold(
                format_indices(set(sim) - sim_out),
                format_indices(sim_out),
                format_indices(set(real) - out),
                format_indices(out),
            )
        )
    return folds


def episodes_of(path: str, chosen: str, name: str) -> list[int]:
    """Return the episodes of a data set that are to be used."""
    from rlco.errors import ConfigError
    from rlco.lerobot_files import read_folder

    episodes = index_list(chosen) or [one.index for one in read_folder(path).episodes]
    if len(episodes) < 2:
        raise ConfigError(
            [
                f"{name}={path} leaves {len(episodes)} episode, and some are held out; "
                "at least 2 are needed"
            ]
        )
    return episodes


def stage_options(config: Config, fold: Fold, method: str) -> StageOneOptions:
    """Return the options of one training."""
    ratio = {"sim_only": 1.0, "real_only": 0.0, "both": 0.5}[method]
    return StageOneOptions(
        seed=config.seed,
        threads=config.threads,
        task=config.task,
        sim_demos=config.sim_demos,
        sim_episodes=fold.sim,
        real_demos=config.real_demos,
        episodes=fold.real,
        rename=config.rename,
        real_camera=config.real_camera,
        sim_ratio=ratio,
        chunk=config.chunk,
        updates=config.updates,
        log_every=config.updates,
        eval_episodes=0,
        **group_values(config, PolicyOptions),
    )


def measure(config: Config, run: Run, folds: Sequence[Fold]) -> Alignment:
    """Train every policy, and test it on what it has not seen."""
    from statistics import fmean

    from rlco.reporting.alignment.page import Alignment
    from rlco.training.alignment import explained, features, pooled, probe_accuracy

    def train(method: str, k: int) -> tuple[Any, Any]:
        options = stage_options(config, folds[k], method)
        return imitate(run, options, f"{method}_{k}")

    def held_out(k: int) -> Any:
        """Return what fold k does not train on."""
        from rlco.training.stage_one import load_stage_one

        fold = folds[k]
        other = Fold(fold.sim_held_out, "", fold.real_held_out, "")
        return load_stage_one(stage_options(config, other, "both"))

    sim_policy, _ = train("sim_only", 0)
    names = held_out(0).task.action_names
    own = explained(sim_policy, held_out(0).sim.frames())
    cross, alone, both, told_apart = [], [], [], []
    for k in range(len(folds)):
        left = held_out(k)
        unseen = left.real.frames()
        cross.append(explained(sim_policy, unseen))
        alone.append(explained(train("real_only", k)[0], unseen))
        policy, data = train("both", k)
        both.append(explained(policy, unseen))
        told_apart.append(
            probe_accuracy(
                tuple(features(policy, d.frames()) for d in (data.sim, data.real)),
                tuple(features(policy, d.frames()) for d in (left.sim, left.real)),
            )
        )
    held_out_episodes = [index_list(fold.real_held_out) or [] for fold in folds]
    parts: dict[str, Explained] = {
        "own": own,
        "cross": pooled(cross),
        "real_only": pooled(alone),
        "both": pooled(both),
    }
    return Alignment(
        shares={name: part.share for name, part in parts.items()},
        by_action={name: part.shares() for name, part in parts.items()},
        actions=list(names),
        probe=fmean(told_apart),
        sim=(config.sim_demos, len(index_list(folds[0].sim) or ())),
        real=(config.real_demos, sum(map(len, held_out_episodes))),
        folds=len(folds),
    )


def imitate(run: Run, options: StageOneOptions, name: str) -> tuple[Any, Any]:
    """Return a policy of Stage I, and what it was trained on."""
    from rlco.training.stage_one import load_stage_one, train_stage_one

    data = load_stage_one(options)
    with run.stage(options, "sft", f"stages/{name}") as stage:
        return train_stage_one(options, stage, data), data


if __name__ == "__main__":
    run_recipe(main, Config)
