"""AdamW for weights of 16 bits: it adds up, in 32, what they are too coarse to hold."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.optim import AdamW

NARROW = (torch.bfloat16, torch.float16)


class MasterWeightAdamW(AdamW):
    """AdamW that keeps a float32 copy of every weight of 16 bits, its master.

    Next to a bfloat16 weight of 0.02 the nearest others are 1e-4 away: a step of 4e-6
    rounds to nothing, and the same the next time, so that such a weight never moves.
    Here the step is added to the master, and the weight is the master rounded
    (Micikevicius et al., arXiv 1710.03740, section 3.1). The moments are float32 too.
    Weights of 32 bits are trained as by :class:`torch.optim.AdamW`.

    A master costs 4 bytes a trained weight, the moments 8. ``state_dict`` holds all
    three. A weight that something else has changed starts a new master.

    Example:
        >>> weight = torch.nn.Parameter(torch.ones(1, dtype=torch.bfloat16))
        >>> optimizer = MasterWeightAdamW([weight], lr=1e-3, weight_decay=0.0)
        >>> for _ in range(8):  # neighbours of 1 are 4e-3 below and 8e-3 above
        ...     weight.grad = torch.ones_like(weight)
        ...     optimizer.step()
        >>> weight.data
        tensor([0.9922], dtype=torch.bfloat16)
    """

    def step(self, closure: Callable[[], float] | None = None) -> Any:
        """Follow the gradients once; those and the weights keep their precision."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        narrow = [
            (parameter, parameter.data, parameter.grad)
            for group in self.param_groups
            for parameter in group["params"]
            if parameter.dtype in NARROW and parameter.grad is not None
        ]
        for parameter, weight, gradient in narrow:
            # A gradient must be of its weight's type: take it off before, back after.
            parameter.grad = None
            parameter.data = self._master(parameter, weight)
            parameter.grad = gradient.float()
        super().step()
        for parameter, weight, gradient in narrow:
            self.state[parameter]["master"] = parameter.data
            weight.copy_(parameter.data)
            parameter.grad = None
            parameter.data = weight
            parameter.grad = gradient
        return loss

    def _master(self, parameter: Tensor, weight: Tensor) -> Tensor:
        """Return the float32 weights that ``weight`` is the rounded form of."""
        held = self.state[parameter].pop("master", None)
        wide = weight.float()
        if held is None:
            return wide
        return torch.where(held.to(weight.dtype) == weight, held, wide)

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on from a state, also one of AdamW; what is float32 here stays it."""
        super().load_state_dict(state_dict)
        # torch has rounded it to the weights' type.
        names, held = (
            [one for group in groups for one in group["params"]]
            for groups in (state_dict["param_groups"], self.param_groups)
        )
        for name, parameter in zip(names, held, strict=True):
            if parameter.dtype not in NARROW:
                continue
            for key, value in state_dict["state"].get(name, {}).items():
                if key != "step":
                    self.state[parameter][key] = value.to(
                        parameter.device, torch.float32, copy=True
                    )
