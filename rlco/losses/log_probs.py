"""The old log-probability of PPO, computed where it will be compared."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type


def log_probs(
    actor: Any, tensordict: TensorDictBase, *, rows: int | None = None
) -> torch.Tensor:
    """Return the log-probability of each stored sample under ``actor`` as it is.

    PPO compares log-probabilities of two times. Those of the rollout come from other
    batch sizes, another precision or compiled code, and differ by more than the
    policies do. Recomputed by the learner, by the calls that the loss makes, the first
    ratio is 1. Call it after the rollout and before the first update, under the
    learner's autocast where there is one, and store the result under
    ``("vla_action", "log_probs")``.

    Args:
        actor: the policy; ``actor.dist_sample_keys`` names the sample's entry.
        tensordict: observations and samples, batch size [*B].
        rows: size of the minibatches to come. Matrix products of another size round
            otherwise, which bfloat16 magnifies: split alike, they do not. None: at
            once.

    Returns:
        [*B], or finer where the actor's log-probability is.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from rlco.policies import GaussianPolicy
        >>> policy = GaussianPolicy(3, chunk=2)
        >>> td = TensorDict({"observation": {"state": torch.randn(8, 3)}}, [8])
        >>> td = policy(td)
        >>> old = log_probs(policy, td, rows=4)
        >>> torch.allclose(old, td["vla_action", "log_probs"], atol=1e-5)
        True
    """
    flat = tensordict.reshape(-1)
    parts = flat.split(rows) if rows else [flat]
    (sample_key,) = actor.dist_sample_keys
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        computed = [
            actor.get_dist(part).log_prob(part.get(sample_key)) for part in parts
        ]
    together = torch.cat(computed)
    return together.reshape(*tensordict.batch_size, *together.shape[1:])
