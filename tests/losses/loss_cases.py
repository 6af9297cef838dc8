"""Small actors, critics and two-rooted batches for the tests of the losses."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase

from rlco.policies import GaussianPolicy, ValueNetwork

STATE, CHUNK, ACTION = 3, 2, 2


def make_networks(**options: Any) -> tuple[GaussianPolicy, ValueNetwork]:
    """Return a policy and a value network of 3 states, chunks of 2 x 2 numbers."""
    policy = GaussianPolicy(
        STATE,
        chunk=CHUNK,
        action_size=ACTION,
        num_instructions=2,
        hidden=(8,),
        activation="tanh",
        **options,
    )
    # The head starts at 0.01; a larger one gives gradients of all layers some size.
    policy.network.head.weight.data.normal_(0, 0.3)
    return policy, ValueNetwork(STATE, num_instructions=2, hidden=(8,))


def observations(rows: int) -> TensorDictBase:
    """Return random observations of ``rows`` decisions."""
    content = {
        "observation": {"state": torch.randn(rows, STATE)},
        "instruction_id": torch.randint(2, (rows,)),
    }
    return TensorDict(content, [rows])


def demonstrations(rows: int) -> TensorDictBase:
    """Return observations with random chunks, the last step of the last row padded."""
    td = observations(rows)
    td["vla_action", "chunk"] = torch.rand(rows, CHUNK, ACTION) * 2 - 1
    td["action_is_pad"] = torch.zeros(rows, CHUNK, dtype=torch.bool)
    td["action_is_pad"][-1, -1] = True
    return td


def rollout(policy: GaussianPolicy, rows: int) -> TensorDictBase:
    """Return decisions of ``policy`` with advantages, its log-probabilities shifted."""
    with torch.no_grad():
        td = policy(observations(rows))
    td["vla_action", "log_probs"] = td["vla_action", "log_probs"] + 0.1 * torch.randn(
        rows
    )
    for name in ("advantage", "value_target", "state_value"):
        td[name] = torch.randn(rows, 1)
    return td


def make_batch(policy: GaussianPolicy) -> TensorDictBase:
    """Return a batch with 6 decisions in ``sim`` and 4 demonstrations in ``real``."""
    return TensorDict({"sim": rollout(policy, 6), "real": demonstrations(4)})


def total(out: TensorDictBase) -> torch.Tensor:
    """Return the sum of all terms, as trainers form it."""
    return torch.stack([v for k, v in out.items() if k.startswith("loss")]).sum()


def gradients(
    parameters: list[torch.nn.Parameter], loss: torch.Tensor
) -> list[torch.Tensor]:
    """Return d loss / d parameters, zeros where there is no path."""
    return list(torch.autograd.grad(loss, parameters, materialize_grads=True))


def largest_error(found: list[torch.Tensor], expected: list[torch.Tensor]) -> float:
    """Return the largest difference, relative to the largest expected entry."""
    scale = max(float(value.abs().max()) for value in expected)
    errors = [(a - b).abs().max() for a, b in zip(found, expected, strict=True)]
    return float(torch.stack(errors).max()) / scale


def assert_same_outputs(found: TensorDictBase, expected: TensorDictBase) -> None:
    """Compare two outputs of a loss, key by key."""
    assert set(found.keys()) == set(expected.keys())
    for name, value in expected.items():
        torch.testing.assert_close(found[name], value)
