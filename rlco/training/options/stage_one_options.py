"""Options of Stage I."""

from __future__ import annotations

from dataclasses import dataclass

from rlco.runs.config import folder_name, none_twice, option
from rlco.training.options.domain_flag_options import DomainFlagOptions
from rlco.training.options.limits import (
    LARGEST_LR,
    LONGEST_CHUNK,
    MOST_ROWS,
    WIDEST_LAYER,
    layers,
)
from rlco.training.options.policy_options import PolicyOptions
from rlco.training.options.pretraining_options import PretrainingOptions

#: What ``sim_ratio=null`` and ``eval_episodes=null`` stand for with a simulator.
SIM_RATIO, EVAL_EPISODES = 0.5, 128


@dataclass
class StageOneOptions(DomainFlagOptions, PretrainingOptions, PolicyOptions):
    """Options of Stage I."""

    name: str = option(
        "sft", "name of the run, a part of its folder's name", check=folder_name
    )
    task: str | None = option(
        "push_cube",
        "name of the task; null: a robot that no simulator has, sizes from the data",
    )
    sim_demos: str | None = option(
        None, "LeRobot folder of simulated demonstrations", input="folder"
    )
    real_demos: str | None = option(
        None, "LeRobot folder of real demonstrations", input="folder"
    )
    episodes: str = option(
        "", "episodes of real_demos that are trained on, 0-19,25; empty: all"
    )
    sim_episodes: str = option("", "the same of sim_demos")
    rename: str = option(
        "",
        "features of real_demos, and of heldout_demos, with other names: "
        "THEIRS:OURS,THEIRS:OURS",
    )
    real_camera: str | None = option(
        None,
        "camera of these and of heldout_demos that is read, or several in the order of "
        "camera=; null: its only one, or those of the same names",
    )
    heldout_demos: str | None = option(
        None,
        "LeRobot folder of real demonstrations to measure imitation on",
        input="folder",
    )
    heldout_episodes: str = option("", "episodes of heldout_demos; empty: all")
    sim_ratio: float | None = option(
        None,
        f"alpha, the share of sim; null: {SIM_RATIO}, with task=null and no sim_demos "
        "0",
        minimum=0,
        maximum=1,
    )
    chunk: int = option(
        4, "control steps of an action chunk", minimum=1, maximum=LONGEST_CHUNK
    )
    hidden: list[int] = option(
        [256, 256],
        "width of each hidden layer",
        minimum=1,
        maximum=WIDEST_LAYER,
        check=layers,
    )
    updates: int = option(1500, "optimiser steps", minimum=1)
    log_every: int = option(100, "updates between rows of metrics.csv", minimum=1)
    batch_size: int = option(
        256, "rows of a batch, both kinds together", minimum=1, maximum=MOST_ROWS
    )
    lr: float = option(
        1e-3,
        "learning rate, falling to 0 along a cosine",
        minimum=0,
        maximum=LARGEST_LR,
    )
    weight_decay: float = option(1e-4, "AdamW's weight decay", minimum=0)
    pretrain_domain: str = option(
        "sim", "pretrain_scenes: the simulator, a domain's name or file", input="file"
    )
    eval_episodes: int | None = option(
        None,
        f"episodes of the evaluation; 0: none; null: {EVAL_EPISODES}, with task=null 0",
        minimum=0,
    )
    eval_domains: list[str] = option(
        ["sim", "stand_in"],
        "domains to evaluate in: names, MODULE:NAME, or paths of effects.yaml files",
        input="file",
        check=none_twice,
    )
    effects_code: str | None = option(
        None, "Python file that registers effects of your own", input="file"
    )

    @property
    def alpha(self) -> float:
        """The share of simulated samples: ``sim_ratio``, or what null stands for."""
        if self.sim_ratio is not None:
            return self.sim_ratio
        return 0.0 if self.task is None and self.sim_demos is None else SIM_RATIO

    @property
    def evaluated(self) -> int:
        """Episodes of the evaluation: ``eval_episodes``, or what null stands for."""
        if self.eval_episodes is not None:
            return self.eval_episodes
        return 0 if self.task is None else EVAL_EPISODES
