"""How much better than expected each decision of a rollout was."""

from __future__ import annotations

from typing import Literal

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.objectives.llm import MCAdvantage

from rlco import keys
from rlco.errors import NoSignalError
from rlco.training.distributed.ranks import Ranks

#: By a critic and GAE, or by Monte-Carlo returns within groups, without a critic.
Advantage = Literal["gae", "mc"]


def normalize(
    advantage: torch.Tensor, broken: torch.Tensor, ranks: Ranks | None = None
) -> torch.Tensor:
    """Give a rollout's advantages mean 0 and deviation 1; broken decisions get 0.

    So does one that is alone: it is as good as expected, and has no deviation.

    Args:
        advantage: (N, T, 1).
        broken: where the simulation diverged, bool, (N, T, 1).
        ranks: Processes that learn together: mean and deviation are over the rollouts
            of all of them.
    """
    ranks = Ranks() if ranks is None else ranks
    sound = ranks.joined(advantage)[~ranks.joined(broken)]
    # Fewer than two have none, which would be NaN.
    deviation = sound.std() if sound.numel() > 1 else torch.zeros_like(sound.sum())
    scaled = (advantage - sound.mean()) / (deviation + 1e-5)
    normalized: torch.Tensor = scaled.masked_fill(broken, 0.0)
    return normalized


def group_advantages(rollout: TensorDictBase, group_size: int) -> torch.Tensor:
    """Compare each episode's return with its group's; all its decisions share that.

    TorchRL's :class:`~torchrl.objectives.llm.MCAdvantage`: with the returns R of
    ``group_size`` neighbours, which started alike, ``(R_i - mean) / std``, and 0 where
    all are equal. An episode in which the simulation diverged teaches nothing: its
    advantages are 0, and the others are compared without it.

    Args:
        rollout: whole episodes, batch size (N, T).
        group_size: episodes of a group; it divides N.

    Returns:
        (N, T, 1).

    Example:
        >>> reward = torch.tensor([[[0.0], [1.0]], [[0.0], [0.0]]])
        >>> diverged = torch.zeros(2, 2, 1, dtype=torch.bool)
        >>> rollout = TensorDict(
        ...     {"next": {"reward": reward, "diverged": diverged}}, [2, 2])
        >>> group_advantages(rollout, 2).squeeze(-1)
        tensor([[ 0.7071,  0.7071],
                [-0.7071, -0.7071]])
    """
    n, t = rollout.batch_size
    reward = rollout["next", keys.REWARD]
    done = torch.zeros_like(reward, dtype=torch.bool)
    done[:, -1] = True
    order = torch.arange(n, device=reward.device)
    group = (order // group_size).unsqueeze(-1).expand(n, t)
    episodes = TensorDict(
        {"group": group, "next": {keys.REWARD: reward, keys.DONE: done}}, [n, t]
    )
    advantage = torch.zeros_like(reward)
    sound = ~rollout["next", keys.DIVERGED].flatten(1).any(1)
    for first in range(0, n, group_size):
        members = order[first : first + group_size]
        kept = members[sound[members]]
        if len(kept) > 1:  # one alone has nothing to be compared with
            compare = MCAdvantage(
                len(kept), prompt_key="group", trajectory_return="sum"
            )
            found = compare.inv(episodes[kept])[keys.ADVANTAGE]
            advantage[kept] = found.view(len(kept), t, 1)
    return advantage


def check_signal(rollout: TensorDictBase) -> None:
    """Check that a rollout distinguishes better actions from worse ones.

    Without it a policy that solves nothing under a sparse reward trains for hours on
    advantages that are zero, or a critic's noise, while all curves look healthy.

    Raises:
        NoSignalError: all rewards are equal, or all advantages 0.
    """
    reward = rollout["next", keys.REWARD]
    if bool((reward != reward.flatten()[0]).any()) and rollout[keys.ADVANTAGE].any():
        return
    solved = rollout["next", keys.SUCCESS][:, -1]
    raise NoSignalError(int(solved.sum()), solved.numel())
