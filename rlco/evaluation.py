"""Success of a policy over paired initial states, and videos of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rlco import keys
from rlco.envs import make_env
from rlco.envs.chunk_env import ChunkEnv
from rlco.statistics import ResultRow, wilson_interval

# Initial states of evaluations come from seeds that no training reaches.
EVALUATION_SEED = 1_000_003
ROWS = 256  # of demonstrations with pictures that are evaluated at once


@dataclass(frozen=True)
class Evaluation:
    """What M episodes of a policy came to, in the order of their initial states.

    Attributes:
        success: Whether the task was solved at the episode's end, bool, shape (M,).
        seconds: Time until it was solved for good [s]; NaN where it was not.
    """

    success: NDArray[np.bool_]
    seconds: NDArray[np.float64]

    @property
    def rate(self) -> float:
        """Share of solved episodes."""
        return float(self.success.mean())

    def row(
        self,
        method: str,
        domain: str,
        seed: int,
        *,
        task: str,
        policy: str,
        variation: str | None = None,
    ) -> ResultRow:
        """Return this evaluation as a row of results.json."""
        return ResultRow(
            method=method,
            task=task,
            policy=policy,
            domain=domain,
            variation=variation,
            seed=seed,
            episodes=int(self.success.size),
            successes=int(self.success.sum()),
        )

    def __str__(self) -> str:
        low, high = wilson_interval(int(self.success.sum()), self.success.size)[1:]
        solved = self.seconds[self.success]
        share = f"{self.rate:.1%} [{low:.1%}, {high:.1%}]"
        text = f"{share} of {self.success.size} episodes"
        return f"{text}, in {np.median(solved):.1f} s" if solved.size else text


def evaluate(policy: Any, env: ChunkEnv, episodes: int) -> Evaluation:
    """Play the first `episodes` episodes of an environment's seed, without noise.

    The initial states depend on the seed alone, so two policies, and two domains,
    see the same ones: their difference is a paired one.

    Args:
        policy: Writes `action`; its most likely action is taken.
        env: Where to play; its batch is filled as often as needed.
        episodes: M.
    """
    decisions = -(-env.horizon // env.chunk)
    (count,) = env.batch_size
    period = env.chunk / env.task.control_frequency
    limit = env.horizon / env.task.control_frequency
    success, seconds = [], []
    for index in range(-(-episodes // count)):
        env.start_at(index)
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            rollout = env.rollout(decisions, policy)
        solved = rollout["next", keys.SUCCESS].squeeze(-1).numpy()
        # Decisions after the last unsolved one: solved for good from there on.
        trailing = np.cumprod(solved[:, ::-1], axis=1).sum(axis=1)
        # The last decision of an episode may be cut short.
        time = np.minimum((decisions - trailing + 1) * period, limit)
        success.append(solved[:, -1])
        seconds.append(np.where(solved[:, -1], time, np.nan))
    return Evaluation(
        np.concatenate(success)[:episodes], np.concatenate(seconds)[:episodes]
    )


def success_rates(
    policy: Any, places: Mapping[str, ChunkEnv], episodes: int
) -> dict[str, float]:
    """Return ``success_<domain>`` of a policy in each domain's environment."""
    return {
        f"success_{domain}": evaluate(policy, env, episodes).rate
        for domain, env in places.items()
    }


def imitation_error(policy: Any, frames: TensorDictBase) -> float:
    """Return the mean imitation loss a step on demonstrations, padding left out.

    Args:
        policy: Offers ``imitation_loss``.
        frames: Observations, chunks and ``action_is_pad``, batch size (B,).
    """
    # All pictures at once would need gigabytes inside a network.
    parts = frames.split(ROWS) if keys.IMAGE in policy.in_keys else [frames]
    with torch.no_grad():
        steps = torch.cat([policy.imitation_loss(part) for part in parts])
    return float(steps[~frames[keys.IS_PAD]].mean())


def evaluation_env(
    task: str, domain: str, *, chunk: int, episodes: int, **options: Any
) -> ChunkEnv:
    """Return the environment that evaluations share, at most 64 episodes at once."""
    # A diverged episode is neither a success nor a failure.
    options = {"seed": EVALUATION_SEED, "on_divergence": "raise", **options}
    return make_env(
        task, domain=domain, num_envs=min(episodes, 64), chunk=chunk, **options
    )


def record_video(
    policy: Any,
    task: str,
    domain: str,
    path: Path,
    *,
    chunk: int,
    index: int = 0,
    variation: str | None = None,
    seed: int = EVALUATION_SEED,
    image_size: tuple[int, int] = (240, 320),
) -> list[NDArray[np.uint8]]:
    """Write one episode as an mp4 video, one frame a decision; return the frames.

    Of a policy that reads pictures the video shows those, enlarged.

    Raises:
        RenderingError: If nothing can render.
    """
    import imageio.v3 as imageio

    seen = getattr(policy, "image_size", None)
    env = make_env(
        task,
        domain=domain,
        chunk=chunk,
        variation=variation,
        image_size=seen or image_size,
        image_quality="fast" if seen else "robosuite",
        seed=seed,
    )
    env.start_at(index)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        rollout = env.rollout(-(-env.horizon // chunk), policy)
    first = rollout[keys.IMAGE][0, :1]
    images = torch.cat([first, rollout["next", *keys.IMAGE][0]])
    times = max(1, image_size[0] // seen[0]) if seen else 1
    images = images.repeat_interleave(times, -1).repeat_interleave(times, -2)
    frames = list(images.permute(0, 2, 3, 1).numpy())
    env.close()
    rate = env.task.control_frequency / chunk
    # Browsers show H.264 with this layout of colours, and hardly any other.
    imageio.imwrite(path, np.stack(frames), fps=rate, codec="libx264")
    return frames
