"""The weight of the anchor, adapted so that RL forgets the robot only so far."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from tensordict import TensorDictBase

from rlco.errors import DataError
from rlco.losses.co_training import CoTrainingLoss
from rlco.training.alignment import explained

#: The weight is multiplied or divided by this after a rollout.
STEP = 1.25
#: Ends of the weight: below the first it is no anchor, above the second no RL.
LEAST, MOST = 0.002, 2.0
#: Demonstrated frames, at most, on which forgetting is measured after each rollout.
FRAMES = 4096


@dataclass
class AnchorWeight:
    """A constraint on forgetting, held by the anchor's weight as Lagrange multiplier.

    What is constrained is how much less of the demonstrated actions' variance the
    policy explains than it did before RL (`rlco.training.alignment.explained`). After
    each rollout beta is raised by a quarter where that exceeds the limit, and else
    lowered by a fifth: dual ascent in the logarithm of the multiplier, by the
    constraint's sign. Where RL leaves the demonstrations as well explained as the limit
    asks, the anchor fades; where it does not, the anchor holds.

    Attributes:
        limit: Share of the variance that may be forgotten, 0 to 1.
        policy: The policy as it is before RL.
        frames: The anchor's demonstrations, every frame.

    Raises:
        DataError: Demonstrations of one action alone: no variance can be forgotten.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from rlco.losses import ImitationLoss
        >>> from rlco.policies import GaussianPolicy
        >>> policy = GaussianPolicy(1, chunk=1, action_size=1, hidden=(4,))
        >>> frames = TensorDict(
        ...     {"observation": {"state": torch.randn(8, 1)},
        ...      "vla_action": {"chunk": torch.randn(8, 1, 1)},
        ...      "action_is_pad": torch.zeros(8, 1, dtype=torch.bool)}, [8])
        >>> loss = CoTrainingLoss(
        ...     ImitationLoss(policy), ImitationLoss(policy), real_coeff=0.2)
        >>> weight = AnchorWeight(0.05, policy, frames)
        >>> weight.adapt(loss)["forgotten"], round(float(loss.real_coeff), 3)
        (0.0, 0.16)
    """

    limit: float
    policy: Any
    frames: TensorDictBase
    _before: float = field(init=False)

    def __post_init__(self) -> None:
        self.frames = self.frames[:: -(-len(self.frames) // FRAMES)]
        found = explained(self.policy, self.frames)
        if not found.total.any():
            raise DataError(
                f"forget_limit={self.limit} limits the share of the demonstrated "
                "actions' variance that is forgotten, but all actions of the anchor's "
                "demonstrations are the same; give others, or forget_limit=null."
            )
        self._before = found.share

    def adapt(self, loss: CoTrainingLoss) -> dict[str, float]:
        """Set a loss's ``real_coeff`` by what the policy has forgotten.

        Returns:
            ``forgotten``, the share of the variance that it no longer explains, and the
            ``real_coeff`` that the rollout was learned from with.
        """
        forgotten = self._before - self._explained()
        weight = float(loss.real_coeff)
        changed = weight * STEP if forgotten > self.limit else weight / STEP
        loss.real_coeff = min(max(changed, LEAST), MOST)
        return {"forgotten": forgotten, "real_coeff": weight}

    def _explained(self) -> float:
        return explained(self.policy, self.frames).share
