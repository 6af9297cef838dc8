"""Success with images of both qualities, by a policy whose eyes know only `fast`.

Run with OMP_NUM_THREADS=1, after a policy on positions was trained (the commands are
in benchmarks/README.md)::

    python benchmarks/camera_quality.py policy=outputs/sft/RUN/policy

A small convolutional network learns to read the positions of cubes and marks from
128 x 128 images of quality `fast`, along episodes of that policy. Then it stands in
front of the policy, and all play the same episodes of push_cube in ``sim``: on reported
positions, and on images of either quality. Prints one markdown table.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from rlco import keys
from rlco.envs import make_env
from rlco.evaluation import evaluate, evaluation_env
from rlco.policies import load_policy
from rlco.run import run_recipe
from rlco.runs.config import REQUIRED, option

log = logging.getLogger("rlco.camera_quality")
SIZE = (128, 128)
TASK, DOMAIN = "push_cube", "sim"


@dataclass
class Config:
    """Options of camera_quality.py."""

    policy: str = option(REQUIRED, "folder of a saved policy on positions")
    training_episodes: int = option(192, "episodes to learn images from", minimum=1)
    epochs: int = option(12, "times each image is seen", minimum=1)
    episodes: int = option(64, "episodes of each evaluation", minimum=1)
    seed: int = option(0, "seed of images and network", minimum=0)


class Eyes(nn.Module):
    """Images to positions: convolutions, where each channel is brightest, a head."""

    def __init__(self, outputs: int, channels: int = 32) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv2d(3, 24, 8, stride=4, padding=2),
            nn.ReLU(),
            nn.Conv2d(24, channels, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(channels, channels, 1),
        )
        self.head = nn.Sequential(
            nn.Linear(2 * channels, 128), nn.ReLU(), nn.Linear(128, outputs)
        )
        self.register_buffer("mean", torch.zeros(outputs))
        self.register_buffer("scale", torch.ones(outputs))

    def normalised(self, images: Tensor) -> Tensor:
        """Return positions in units of their spread, (B, 3, H, W) -> (B, E)."""
        weights = self.layers(images.float() / 255.0 - 0.5).flatten(2).softmax(-1)
        side = torch.linspace(-1.0, 1.0, SIZE[0] // 4)
        grid = torch.cartesian_prod(side, side)
        return self.head((weights @ grid).flatten(1))

    def forward(self, images: Tensor) -> Tensor:
        """Return positions, (B, 3, H, W) -> (B, E), [m]."""
        return self.normalised(images) * self.scale + self.mean


def collect(policy: Any, episodes: int, seed: int) -> tuple[Tensor, Tensor]:
    """Return images, (B, 3, H, W), and what is reported with them, (B, E)."""
    env = make_env(
        TASK,
        domain=DOMAIN,
        num_envs=min(episodes, 32),
        chunk=policy.chunk,
        image_size=SIZE,
        seed=seed,
    )
    images, positions = [], []
    for _ in range(-(-episodes // env.batch_size[0])):
        with torch.no_grad():  # with exploration: more of what could happen
            rollout = env.rollout(-(-env.horizon // env.chunk), policy)
        images.append(rollout[keys.IMAGE].flatten(0, 1))
        positions.append(rollout[keys.ENVIRONMENT_STATE].flatten(0, 1))
    env.close()
    return torch.cat(images), torch.cat(positions)


def learn(images: Tensor, positions: Tensor, epochs: int) -> Eyes:
    """Return a network that reads positions from images."""
    eyes = Eyes(positions.shape[1])
    eyes.mean, eyes.scale = positions.mean(0), positions.std(0)
    wanted = (positions - eyes.mean) / eyes.scale
    batches = len(images) // 64
    optimiser = torch.optim.Adam(eyes.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, max_lr=3e-3, total_steps=epochs * batches
    )
    for epoch in range(epochs):
        total = 0.0
        for rows in torch.randperm(len(images))[: batches * 64].split(64):
            loss = nn.functional.smooth_l1_loss(
                eyes.normalised(images[rows]), wanted[rows], beta=0.1
            )
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            total += loss.item()
        log.info("epoch %d: loss %.4f", epoch + 1, total / batches)
    return eyes.eval()


class Seeing:
    """A policy on positions with eyes in front of it; notes their errors [m]."""

    def __init__(self, policy: Any, eyes: Eyes) -> None:
        self.policy, self.eyes = policy, eyes
        self.errors: list[Tensor] = []

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write what the policy does on the positions that its eyes read."""
        seen = self.eyes(tensordict[keys.IMAGE])
        reported = tensordict[keys.ENVIRONMENT_STATE]
        pairs = (seen - reported).unflatten(-1, (-1, 2))
        self.errors.append(pairs.norm(dim=-1).flatten())
        acted = self.policy(tensordict.clone().set(keys.ENVIRONMENT_STATE, seen))
        return acted.set(keys.ENVIRONMENT_STATE, reported)


def main(config: Config) -> None:
    """Learn, evaluate, and print the table."""
    torch.manual_seed(config.seed)
    policy, _ = load_policy(config.policy)
    images, positions = collect(policy, config.training_episodes, config.seed)
    log.info("%d images", len(images))
    eyes = learn(images, positions, config.epochs)
    columns = "the policy observes", "success [Wilson 95 %]"
    print("|", " | ".join((*columns, "median error, 95 % below [mm]")), "|")
    print("|---|---|---|")
    for quality in (None, "fast", "robosuite"):
        options = {"image_size": SIZE, "image_quality": quality} if quality else {}
        env = evaluation_env(
            TASK, DOMAIN, chunk=policy.chunk, episodes=config.episodes, **options
        )
        player = Seeing(policy, eyes) if quality else policy
        result = evaluate(player, env, config.episodes)
        env.close()
        name = f"images, `{quality}`" if quality else "reported positions"
        error = ""
        if quality:
            every = 1e3 * torch.cat(player.errors)
            error = f"{every.median():.1f}, {every.quantile(0.95):.1f}"
        print(f"| {name} | {result} | {error} |", flush=True)


if __name__ == "__main__":
    run_recipe(main, Config)
