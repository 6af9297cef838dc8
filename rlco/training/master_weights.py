"""AdamW for weights of 16 bits: it adds up, in 32, what they are too coarse to hold."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.optim import AdamW, Optimizer

NARROW = (torch.bfloat16, torch.float16)


class MasterWeightAdamW(AdamW):
    """AdamW that keeps a float32 copy of every weight of 16 bits, its master.

    Next to a bfloat16 weight of 0.02 the nearest others are 1e-4 away: a step of 4e-6
    rounds to nothing, and the same the next time, so that such a weight never moves.
    Here the step is added to the master, and the weight is the master rounded
    (Micikevicius et al., arXiv 1710.03740, section 3.1). The moments are float32 too.
    Weights of 32 bits are trained as by :class:`torch.optim.AdamW`.

    A master costs 4 bytes a trained weight, the moments 8, and each step 4 and more for
    as long as it takes, for the gradient in float32. ``state_dict`` holds masters and
    moments. A weight that something else has changed starts a new master.

    Args:
        params: as of AdamW.
        **options: as of AdamW.

    Example:
        >>> weight = torch.nn.Parameter(torch.ones(1, dtype=torch.bfloat16))
        >>> optimizer = MasterWeightAdamW([weight], lr=1e-3, weight_decay=0.0)
        >>> for _ in range(8):  # neighbours of 1 are 4e-3 below and 8e-3 above
        ...     weight.grad = torch.ones_like(weight)
        ...     optimizer.step()
        >>> weight.data
        tensor([0.9922], dtype=torch.bfloat16)
    """

    def __init__(self, params: Any, **options: Any) -> None:
        super().__init__(params, **options)
        # Before anyone else's hooks: they see the weights as they are after the step.
        self.register_step_post_hook(_round)

    def _init_group(
        self,
        group: dict[str, Any],
        params_with_grad: list[Tensor],
        grads: list[Tensor],
        exp_avgs: list[Tensor],
        exp_avg_sqs: list[Tensor],
        max_exp_avg_sqs: list[Tensor],
        state_steps: list[Tensor],
    ) -> bool:
        """Name what a step reads and changes: masters in place of narrow weights."""
        moments = {
            "exp_avg": exp_avgs,
            "exp_avg_sq": exp_avg_sqs,
            "max_exp_avg_sq": max_exp_avg_sqs,
        }
        lists = (params_with_grad, grads, *moments.values(), state_steps)
        plain: Any = super()  # torch types no part of this method
        is_complex: bool = plain._init_group(group, *lists)
        for place, weight in enumerate(params_with_grad):
            if weight.dtype not in NARROW:
                continue
            held = self.state[weight]
            for name, values in moments.items():
                if name in held:
                    held[name] = values[place] = held[name].float()
            held["master"] = _master(held.get("master"), weight.detach())
            params_with_grad[place] = held["master"]
            grads[place] = grads[place].float()
        return is_complex

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on from a state, also one of AdamW; what is float32 here stays it."""
        super().load_state_dict(state_dict)
        # torch has rounded it to the weights' type.
        names, held = (
            [one for group in groups for one in group["params"]]
            for groups in (state_dict["param_groups"], self.param_groups)
        )
        for name, weight in zip(names, held, strict=True):
            if weight.dtype not in NARROW:
                continue
            for key, value in state_dict["state"].get(name, {}).items():
                if key != "step":
                    self.state[weight][key] = value.to(
                        weight.device, torch.float32, copy=True
                    )


def _master(held: Tensor | None, weight: Tensor) -> Tensor:
    """Return the float32 weights that ``weight`` is the rounded form of."""
    wide = weight.float()
    if held is None:
        return wide
    return torch.where(held.to(weight.dtype) == weight, held, wide)


@torch.no_grad()
def _round(optimizer: Optimizer, args: Any, kwargs: Any) -> None:
    """Give the weights that took a step what their masters came to."""
    del args, kwargs
    for weight, held in optimizer.state.items():
        if weight.grad is not None and "master" in held:
            weight.copy_(held["master"])
