"""Looks at what a policy on a robot is given: NaN, and numbers in another unit."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import nn

from rlco.errors import DataError
from rlco.finite import is_finite
from rlco.keys import ENVIRONMENT_STATE, STATE
from rlco.policies.nets.normalizer import QuantileNormalizer

log = logging.getLogger("rlco.policies")

#: A number so far from the middle of its data is reported, where 1 is the distance to
#: the 1 % and the 99 % quantile: off the data by half of their range.
FAR = 2.0

_KEYS = {"state": STATE, "environment_state": ENVIRONMENT_STATE}


def check_observations(
    policy: nn.Module, names: Mapping[str, Sequence[str]] | None = None
) -> None:
    """Let a policy look at each observation that it is called with.

    `load_policy` does this. A NaN or infinity is refused, as the network would answer
    it with an action all the same. A number far from those of the training data
    (radians instead of degrees, another order of joints, a joint that never moved
    before) is warned of, once each. Training has checks of its own, and leaves this
    out.

    Args:
        policy: A policy of this package.
        names: Under ``state`` and ``environment_state``, a name for each number; they
            are counted where there is none.

    Raises:
        DataError: By the policy's calls, where an observation is not finite.

    Example:
        >>> from tensordict import TensorDict
        >>> from rlco.policies import GaussianPolicy
        >>> policy = GaussianPolicy(2, chunk=1, hidden=(4,))
        >>> check_observations(policy, {"state": ["shoulder", "elbow"]})
        >>> state = torch.tensor([[0.0, torch.nan]])
        >>> policy(TensorDict({"observation": {"state": state}}, [1]))
        Traceback (most recent call last):
        ...
        rlco.errors.DataError: observation.state is nan under 'elbow'; ...
    """
    encoder: Any = policy.encoder
    looks = [
        _Look(name, getattr(encoder, name), (names or {}).get(name, ()))
        for name in _KEYS
        if getattr(encoder, name) is not None
    ]

    policy.register_forward_pre_hook(_Looks(looks))


class _Looks:
    """A hook of a policy's calls; a class, so that policies can be pickled."""

    def __init__(self, looks: Sequence[_Look]) -> None:
        self._looks = looks

    def __call__(self, policy: nn.Module, given: tuple[Any, ...]) -> None:
        for look in self._looks:
            look.check(given[0])


class _Look:
    """Looks at one entry of observations, and remembers what it has warned of."""

    def __init__(
        self, name: str, normalizer: QuantileNormalizer, names: Sequence[str]
    ) -> None:
        self._name, self._normalizer = name, normalizer
        given = len(names) == normalizer.size
        self._names = list(names) if given else list(map(str, range(normalizer.size)))
        self._told: set[int] = set()

    def check(self, observation: TensorDictBase) -> None:
        value = observation.get(_KEYS[self._name], None)
        if value is None or value.shape[-1] != self._normalizer.size:
            return  # the policy itself says what is wrong
        rows = value.detach().reshape(-1, value.shape[-1])
        if not is_finite(rows):
            index = int((~rows.isfinite()).any(0).nonzero()[0])
            number = rows[:, index][~rows[:, index].isfinite()][0]
            raise DataError(
                f"observation.{self._name} is {float(number)} under "
                f"{self._names[index]!r}; the policy would answer with an action that "
                "means nothing: stop the robot, and see to the sensor."
            )
        self._warn(rows)

    def _warn(self, rows: torch.Tensor) -> None:
        low, high = self._normalizer.low, self._normalizer.high
        if bool((low == -1).all() and (high == 1).all()):
            return  # never fixed by data
        distance = ((2 * rows - low - high) / (high - low)).abs()
        worst, row = distance.max(0)
        found = [
            index
            for index in (worst > FAR).nonzero().flatten().tolist()
            if index not in self._told
        ]
        if not found:
            return
        self._told |= set(found)
        listed = "; ".join(
            f"{self._names[i]} is {float(rows[row[i], i]):.4g}, data "
            f"{float(low[i]):.4g} to {float(high[i]):.4g}"
            for i in found
        )
        log.warning(
            "observation.%s is far from the data that the policy was trained on (%s); "
            "compare units and order. Said once for each number.",
            self._name,
            listed,
        )
