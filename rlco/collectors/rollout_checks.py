"""Checks that a rollout is finite: as it is played, then what is computed from it."""

from __future__ import annotations

from collections.abc import Container, Iterable
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.envs.transforms import Transform

from rlco import keys
from rlco.errors import NonFiniteError
from rlco.finite import is_finite

_OBSERVED = (keys.STATE, keys.ENVIRONMENT_STATE)
_POLICY = "the policy gives it, from finite observations: its weights are off, lower lr"
_CRITIC = "the critic gives it, from finite observations: lower critic_lr"
_SUM = "rewards and values are finite, but their sum is not: scale the reward down"


class FiniteRollout(Transform):
    """Stops a rollout at the decision whose reward or observation is not finite.

    A policy makes NaN of a NaN observation, so that a step later the wrong one would
    be blamed.

    Args:
        read: Keys that policy and critic read; what neither reads may be anything.

    Attributes:
        iteration: Number of the rollout, for the message.
        decision: Decisions of it that have been played.

    Raises:
        NonFiniteError: A number is NaN or infinite.
    """

    def __init__(self, read: Container[Any]) -> None:
        super().__init__()
        self._seen = tuple(key for key in _OBSERVED if key in read)  # images are bytes
        self.decision = 0
        self.iteration = 0

    def begin(self, iteration: int) -> None:
        """Count the decisions of another rollout, within which episodes may restart."""
        self.iteration, self.decision = iteration, 0

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        when = f"after a reset by decision {self.decision}"
        self._check(
            tensordict_reset, self._seen, when if self.decision else "as it starts"
        )
        return tensordict_reset

    def _step(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase
    ) -> TensorDictBase:
        when = f"after decision {self.decision}"
        self._check(next_tensordict, (keys.REWARD, *self._seen), when)
        self.decision += 1
        return next_tensordict

    def _check(
        self, tensordict: TensorDictBase, read: Iterable[NestedKey], when: str
    ) -> None:
        for key in read:
            value = tensordict.get(key, None)
            if value is None or is_finite(value):
                continue
            broken = ~value.flatten(1).isfinite().all(1)
            raise NonFiniteError(
                f"{key!r} is NaN or infinite in {int(broken.sum())} of {len(broken)} "
                f"environments, first in environment {int(broken.int().argmax())}, "
                f"{when} of rollout {self.iteration} (counted from 0): the environment "
                "or a transform of it gives it, so look there; no option of the "
                "training cures it."
            )


def check_computed(rollout: TensorDictBase, iteration: int) -> None:
    """Check what policy, critic and estimator wrote into a rollout (N, T).

    Raises:
        NonFiniteError: A number is NaN or infinite; what is behind it is named.
    """
    value = keys.STATE_VALUE
    # Each is computed from those before it.
    for key, advice in (
        (keys.SAMPLE, _POLICY),
        (keys.LOG_PROB, _POLICY),
        (value, _CRITIC),
        (("next", value), _CRITIC),
        (keys.ADVANTAGE, _SUM),
    ):
        found = rollout.get(key, None)
        if found is None or is_finite(found):
            continue
        broken = ~found.reshape(*rollout.batch_size, -1).isfinite().all(-1)
        environment, decision = torch.nonzero(broken)[0].tolist()
        raise NonFiniteError(
            f"{key!r} is NaN or infinite in {int(broken.sum())} of {broken.numel()} "
            f"decisions of rollout {iteration}, first in environment {environment} at "
            f"decision {decision} (both from 0): {advice}."
        )
