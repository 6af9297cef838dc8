"""Small policies of every kind, observations for them, and their gradient checks."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase

from rlco.policies import make_policy

STATE = 3


def tiny(kind: str, **options: Any) -> Any:
    """Return a policy of 3 states, 2 instructions; H = 2, A = 2 unless given."""
    small: dict[str, Any] = {"state_size": STATE, "chunk": 2, "action_size": 2}
    small |= {"num_instructions": 2, "hidden": (8,)}
    if kind == "token":
        small |= {"width": 8, "heads": 2, "bins": 6}
    policy = make_policy(kind, **(small | options))
    # Heads start near zero: what depends on them would hardly show.
    for module in policy.modules():
        if hasattr(module, "gain"):
            torch.nn.init.normal_(module.weight, 0.0, 0.5)
    if kind == "token":
        torch.nn.init.normal_(policy.network.head, 0.0, 1.0)
    return policy


def observations(*batch: int, dtype: torch.dtype = torch.float32) -> TensorDictBase:
    content = {
        "observation": {"state": torch.randn(*batch, STATE, dtype=dtype)},
        "instruction_id": torch.randint(2, batch),
    }
    return TensorDict(content, batch)


def demonstrations(policy: Any, *batch: int, **options: Any) -> TensorDictBase:
    td = observations(*batch, **options)
    size = (*batch, policy.chunk, policy.action_size)
    td["vla_action", "chunk"] = torch.rand(size, **options) * 2 - 1
    return td


def gradients_are_right(policy: Any, compute: Callable[[Any], torch.Tensor]) -> bool:
    """Compare autograd with finite differences, float64.

    Along random directions of the outputs and of every parameter's numbers, which a
    wrong number shows in, at a hundredth of the cost of one number after the other.
    """
    names = [name for name, _ in policy.named_parameters()]

    class Called(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.policy = copy.deepcopy(policy)

        def forward(self) -> torch.Tensor:
            return compute(self.policy)

    called = Called()

    def function(*values: torch.Tensor) -> torch.Tensor:
        given = {f"policy.{n}": v for n, v in zip(names, values, strict=True)}
        return torch.func.functional_call(called, given, ())

    values = [p.detach().clone().requires_grad_() for p in policy.parameters()]
    return torch.autograd.gradcheck(function, values, fast_mode=True)
