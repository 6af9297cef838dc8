"""Options of Stage II."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from rlco.runs.config import REQUIRED, folder_name, none_twice, option
from rlco.training.distributed.launch import LaunchOptions
from rlco.training.options.limits import (
    LARGEST_LR,
    LONGEST_EPISODE,
    MOST_ENVS,
    MOST_ROWS,
    WIDEST_LAYER,
    layers,
)
from rlco.training.options.policy_options import AugmentOptions
from rlco.training.options.training_domain_options import TrainingDomainOptions


@dataclass
class StageTwoOptions(LaunchOptions, AugmentOptions, TrainingDomainOptions):
    """Options of Stage II."""

    name: str = option(
        "rl_co", "name of the run, a part of its folder's name", check=folder_name
    )
    policy: str = option(
        REQUIRED, "folder of the policy that Stage I saved", input="folder"
    )
    task: str = option("push_cube", "name of the task")
    real_demos: str | None = option(
        None, "LeRobot folder of real demonstrations", input="folder"
    )
    episodes: str = option(
        "", "episodes of real_demos that are trained on, 0-19,25; empty: all"
    )
    rename: str = option(
        "", "features of real_demos with other names: THEIRS:OURS,THEIRS:OURS"
    )
    real_camera: str | None = option(
        None,
        "camera of these and of heldout_demos that is read, or several in the policy's "
        "order; null: its only one, or those of the same names",
    )
    heldout_demos: str | None = option(
        None,
        "LeRobot folder of real demonstrations to measure forgetting on",
        input="folder",
    )
    heldout_episodes: str = option("", "episodes of heldout_demos; empty: all")
    real_coeff: float = option(0.2, "beta, weight of the real anchor", minimum=0)
    forget_limit: float | None = option(
        None,
        "share of the real demonstrations' variance that RL may stop explaining: the "
        "anchor's weight begins at real_coeff and follows it; null: real_coeff stays",
        minimum=0,
        maximum=1,
    )
    iterations: int = option(100, "rollouts", minimum=1, may_change=True)
    num_envs: int = option(32, "episodes of a rollout", minimum=1, maximum=MOST_ENVS)
    horizon: int | None = option(
        None,
        "control steps of a training episode, truncated; null: the task's",
        minimum=1,
        maximum=LONGEST_EPISODE,
    )
    look: str | None = option(
        None,
        "how the images that it reads look in training: sim, stand_in, or random for "
        "another look in each episode; null: as train_domain says",
    )
    backend: Literal["native", "robosuite"] = option("native", "who steps the model")
    reward: Literal["shaped", "sparse"] = option("shaped", "reward of a control step")
    epochs: int = option(4, "passes over a rollout", minimum=1)
    target_kl: float | None = option(
        None,
        "no further pass follows one whose mean KL divergence is larger [nats]; null: "
        "all passes",
        minimum=0,
    )
    reuse: int = option(
        1,
        "earlier rollouts that are learned from again, by truncated importance weights",
        minimum=0,
        maximum=1000,
        earlier=0,
    )
    minibatch: int = option(
        128, "simulated decisions of a minibatch", minimum=1, maximum=MOST_ROWS
    )
    real_rows: int = option(
        128, "real rows of a minibatch", minimum=1, maximum=MOST_ROWS
    )
    lr: float = option(
        2e-4, "learning rate of the policy", minimum=0, maximum=LARGEST_LR
    )
    image_lr: float = option(
        1.0,
        "learning rate of the image encoder, as a share of the policy's",
        minimum=0,
        maximum=1,
    )
    image_fixed: bool = option(
        False,
        "leave the image encoder as Stage I made it; images of a rollout are read once",
    )
    lr_final: float = option(
        0.1,
        "learning rates after the last rollout, as a share of the first",
        minimum=0,
        maximum=1,
        earlier=1.0,
    )
    clip: float = option(0.2, "PPO's clip of the ratio", minimum=0, maximum=1)
    advantage: Literal["gae", "mc"] = option(
        "gae", "by a critic, or by returns within groups that start alike"
    )
    group_size: int = option(8, "mc: episodes of a group", minimum=2)
    gamma: float = option(0.97, "gae: discount a decision", minimum=0, maximum=1)
    lmbda: float = option(0.95, "GAE's lambda", minimum=0, maximum=1)
    critic: Literal["network", "head"] = option(
        "network", "gae: of its own, or a head on a token policy's state"
    )
    critic_hidden: list[int] = option(
        [256, 256],
        "gae: width of each hidden layer of the critic",
        minimum=1,
        maximum=WIDEST_LAYER,
        check=layers,
    )
    time_left: bool = option(
        True,
        "gae: the critic reads how much of the episode is left",
        earlier=False,
    )
    critic_lr: float = option(
        1e-3, "gae: learning rate of the critic", minimum=0, maximum=LARGEST_LR
    )
    critic_iterations: int = option(
        3, "gae: first rollouts that train the critic alone", minimum=0
    )
    max_grad_norm: float = option(
        1.0, "clip of the gradient's norm; inf: none", minimum=0, infinite=True
    )
    keep: Literal["last", "best"] = option(
        "last",
        "policy that is saved: the last one, or that of the evaluation with the "
        "highest success in train_domain",
    )
    eval_every: int = option(20, "rollouts between evaluations", minimum=1)
    eval_episodes: int = option(64, "episodes of an evaluation; 0: none", minimum=0)
    final_episodes: int | None = option(
        None,
        "episodes of the last evaluation, from other initial states; null: as many as "
        "of the others",
        minimum=0,
    )
    eval_domains: list[str] = option(
        ["sim", "stand_in"],
        "domains to evaluate in: names, MODULE:NAME, or paths of effects.yaml files",
        input="file",
        check=none_twice,
    )
    final_domains: list[str] = option(
        [],
        "further ones for the last evaluation alone, such as locked",
        input="file",
        check=none_twice,
    )

    @property
    def final(self) -> int:
        """Episodes of the last evaluation: ``final_episodes``, or what null means."""
        if self.final_episodes is None:
            return self.eval_episodes
        return self.final_episodes

    def evaluates(self, iteration: int) -> bool:
        """Return whether an iteration ends with an evaluation."""
        return iteration % self.eval_every == 0 or iteration == self.iterations


class AnchoredOptions(Protocol):
    """Options that every Stage II has, also that of large models."""

    real_demos: str | None
    real_coeff: float
    advantage: Literal["gae", "mc"]
    num_envs: int
    group_size: int


class RolloutOptions(Protocol):
    """Options that say how long a rollout is."""

    task: str
    num_envs: int
    horizon: int | None
