"""What a loss inside another loss really reads and returns.

TorchRL's PPO losses declare keys that differ from what they read and return where the
advantages were computed before.
"""

from __future__ import annotations

from tensordict import NestedKey
from torchrl.objectives import LossModule, PPOLoss

_CLIPPED = "value_clip_fraction"


def precomputed_keys(loss: LossModule) -> list[NestedKey]:
    """Return what a PPO loss would compute itself, wrongly, from a minibatch.

    That is the advantage, and the value target where there is a critic; nothing for a
    loss without advantages.
    """
    keys = loss.tensor_keys
    if not hasattr(keys, "advantage"):
        return []
    return [keys.advantage, *([keys.value_target] if _has_critic(loss) else [])]


def input_keys(loss: LossModule) -> list[NestedKey]:
    """Return what ``loss`` reads where its advantages were computed before."""
    precomputed = precomputed_keys(loss)
    if not precomputed:
        return list(loss.in_keys)
    if getattr(loss, "clip_value", None) is not None:
        precomputed.append(loss.tensor_keys.value)
    present = [key for key in loss.in_keys if key[0] != "next"]
    return list(dict.fromkeys([*present, *precomputed]))


def output_keys(loss: LossModule) -> list[NestedKey]:
    """Return what ``loss`` returns, always."""
    keys = list(loss.out_keys)
    if not isinstance(loss, PPOLoss):
        return keys
    if not _has_critic(loss):
        keys = [key for key in keys if key not in ("loss_critic", _CLIPPED)]
    extra = ["kl_approx"]
    if _has_critic(loss) and loss.log_explained_variance:
        extra.append("explained_variance")
    return list(dict.fromkeys([*keys, *extra]))


def _has_critic(loss: LossModule) -> bool:
    return (
        getattr(loss, "critic_network", None) is not None
        # ReinforceLoss has a critic and no coefficient of it.
        and getattr(loss, "critic_coeff", 1.0) is not None
    )
