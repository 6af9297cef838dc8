"""How far Stage II moves a policy from what it did on held-out demonstrations."""

from __future__ import annotations

from typing import Any, Protocol

import torch
from tensordict import TensorDictBase

from rlco import keys
from rlco.training.imitation_errors import fixed_imitation_error, likely_chunks


class Demonstrated(Protocol):
    """Demonstrations, such as those of `rlco.data.load_demos`."""

    def frames(self) -> TensorDictBase:
        """Return every frame in order, with chunks and which steps pad them."""


class HeldOut:
    """What a policy does on held-out demonstrations, and how far that has moved.

    Unlike the imitation error, which rises with success, too, the drift is 0 at the
    start and grows with any change of what the policy does where the robot was shown
    what to do.

    Args:
        policy: A policy of this package, as it is before Stage II.
        demos: Held-out demonstrations; None where there are none.
    """

    def __init__(self, policy: Any, demos: Demonstrated | None) -> None:
        self._demos = demos
        self._before = None if demos is None else _likely(policy, demos)

    def measure(self, policy: Any) -> dict[str, float]:
        """Return ``imitation_error_heldout`` and ``drift_heldout``, if there are any.

        The first is `imitation_error`, by the same random numbers at each call, as all
        else here: training goes on as if nothing had been measured. The second is the
        root mean square of how far the most likely actions have moved: 1 is half of
        the range that the policy's normalisation maps to [-1, 1]. Steps beyond an
        episode's end are left out.
        """
        if self._demos is None or self._before is None:
            return {}
        error = fixed_imitation_error(policy, self._demos.frames())
        moved = _likely(policy, self._demos) - self._before
        real = ~self._demos.frames()[keys.IS_PAD]
        drift = float(moved[real].pow(2).mean().sqrt())
        return {"imitation_error_heldout": error, "drift_heldout": drift}


def _likely(policy: Any, demos: Demonstrated) -> torch.Tensor:
    """Return the most likely chunk at each frame, normalised, (frames, chunk, A)."""
    actions: torch.Tensor = policy.action_normalizer(
        likely_chunks(policy, demos.frames())
    )
    return actions
