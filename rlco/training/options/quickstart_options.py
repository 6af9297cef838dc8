"""Options of the quickstart: a selection of those of its stages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from rlco.runs.config import distinct, folder_name, none_twice, option
from rlco.training.options.limits import LARGEST_LR, LONGEST_EPISODE, MOST_ENVS
from rlco.training.options.policy_options import PolicyOptions
from rlco.training.options.pretraining_options import PretrainingOptions
from rlco.training.options.training_domain_options import TrainingDomainOptions

METHODS = ("real_only", "sft", "rl_only", "rl_co")
#: What image=dense implies: images alone, by an encoder that learns from labelled
#: scenes where things are and then stays. docs/images.md has what was measured.
FROM_IMAGES: dict[str, Any] = {
    "camera": "agentview,robot0_eye_in_hand",
    "use_environment_state": False,
    "pretrain_scenes": 8000,
    "pretrain_passes": 15,
    "image_fixed": True,
    "sim_demos": 200,
    "real_demos": 20,
    "rl_lr": 5e-5,  # 2e-4, which suits poses, moves it too far at first
    "horizon": 120,  # as evaluations: what is lost there late has to be met in training
}


@dataclass
class QuickstartOptions(TrainingDomainOptions, PretrainingOptions, PolicyOptions):
    """Options of quickstart.py."""

    name: str = option(
        "quickstart", "name of the run, a part of its folder's name", check=folder_name
    )
    task: str = option("push_cube", "name of the task")
    image: Literal["none", "conv", "dense", "mobilenet"] = option(
        "none",
        "encoder of images: none, one of rlco's two small ones, or ImageNet's "
        "MobileNetV2",
        implies={"dense": FROM_IMAGES},
    )
    methods: list[str] = option(
        list(METHODS), f"which to compare: {', '.join(METHODS)}", check=distinct
    )
    sim_demos: int = option(
        12, "demonstrations to record in the training domain", minimum=1
    )
    real_demos: int = option(6, "demonstrations to record in stand_in", minimum=1)
    heldout_demos: int = option(
        9, "more in stand_in, held out of training, to measure forgetting", minimum=1
    )
    real_domain: str = option(
        "stand_in",
        "domain that plays the robot's part: a name, MODULE:NAME, or the path of an "
        "effects.yaml",
    )
    sim_ratio: float = option(0.5, "alpha of Stage I", minimum=0, maximum=1)
    updates: int = option(1500, "optimiser steps of Stage I", minimum=1)
    iterations: int = option(40, "rollouts of Stage II", minimum=1)
    num_envs: int = option(32, "episodes per rollout", minimum=1, maximum=MOST_ENVS)
    horizon: int | None = option(
        None,
        "control steps of a training episode in Stage II, truncated; null: the task's",
        minimum=1,
        maximum=LONGEST_EPISODE,
    )
    real_coeff: float = option(0.2, "beta of Stage II", minimum=0)
    rl_lr: float = option(
        2e-4,
        "learning rate of the policy in Stage II",
        minimum=0,
        maximum=LARGEST_LR,
    )
    advantage: Literal["gae", "mc"] = option(
        "gae", "gae: by a critic; mc: by returns within groups of equal initial states"
    )
    eval_every: int = option(20, "rollouts between evaluations", minimum=1)
    curve_episodes: int = option(32, "episodes per point of a curve", minimum=1)
    eval_episodes: int = option(
        128, "episodes per method and domain of the comparison", minimum=1
    )
    film: bool = option(True, "render frames and a video if OpenGL is found")
    eval_domains: list[str] = option(
        ["sim", "stand_in"],
        "domains to compare in: names, MODULE:NAME, or paths of effects.yaml files; "
        "the last one is filmed",
        input="file",
        check=distinct,
    )
    final_domains: list[str] = option(
        [],
        "further ones for the comparison alone, not for curves, such as locked",
        input="file",
        check=none_twice,
    )
    train_domain: str = option(
        "sim",
        "domain of the simulated demonstrations and of Stage II: a name, "
        "MODULE:NAME, or the path of an effects.yaml",
        input="file",
    )

    @property
    def reads_images(self) -> bool:
        """Whether policies read images."""
        return self.image != "none"
