"""Strength and direction of the anchor: both gradients on the shared actor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import nn

from rlco.keys import REAL, SIM
from rlco.losses.co_training import CoTrainingLoss


def gradient_agreement(loss: CoTrainingLoss, batch: TensorDictBase) -> dict[str, float]:
    r"""Compare the gradients of both terms on the parameters of the shared actor.

    With :math:`g_{sim}, g_{real}` the gradients of each root's summed ``loss_*``
    outputs, already weighted by their coefficients, it returns

    - ``grad_norm_sim`` and ``grad_norm_real``, their Euclidean norms;
    - ``grad_norm_ratio``, :math:`|g_{real}| / |g_{sim}|`: the strength of the anchor,
      which depends on the scale of the imitation loss and cannot be read off
      ``real_coeff``;
    - ``grad_cosine``, their cosine: below 0 the terms pull against each other.

    Ratio and cosine are NaN where a norm they divide by is 0. Nothing changes: neither
    ``.grad`` nor buffers nor the state of the caller's random generators.

    Args:
        loss: the co-training loss.
        batch: the input of ``loss``.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from rlco.losses import ImitationLoss
        >>> from rlco.policies import GaussianPolicy
        >>> actor = GaussianPolicy(1, chunk=1, action_size=1, hidden=(4,))
        >>> def demos(target):
        ...     return TensorDict(
        ...         {"observation": {"state": torch.ones(1, 1)},
        ...          "vla_action": {"chunk": torch.full((1, 1, 1), target)}}, [1])
        >>> loss = CoTrainingLoss(
        ...     ImitationLoss(actor), ImitationLoss(actor),
        ...     sim_coeff=0.5, real_coeff=0.5)
        >>> found = gradient_agreement(
        ...     loss, TensorDict({"sim": demos(5.0), "real": demos(-5.0)}))
        >>> round(found["grad_cosine"], 3)
        -1.0
    """
    parameters = loss.shared_parameters()
    with untouched(loss), torch.enable_grad():
        terms = loss.terms(batch)
        sim = gradient_of(terms.get(SIM, {}), parameters)
        real = gradient_of(terms.get(REAL, {}), parameters)
    norm_sim, norm_real = _dot(sim, sim) ** 0.5, _dot(real, real) ** 0.5
    dot = _dot(sim, real)
    product = norm_sim * norm_real
    return {
        "grad_norm_sim": norm_sim,
        "grad_norm_real": norm_real,
        "grad_norm_ratio": norm_real / norm_sim if norm_sim else float("nan"),
        "grad_cosine": dot / product if product else float("nan"),
    }


def gradient_of(
    named: dict[str, Any], parameters: list[nn.Parameter]
) -> Sequence[torch.Tensor]:
    """Return the gradient of the summed terms, a tensor for each parameter."""
    terms = [value for name, value in named.items() if name.startswith("loss_")]
    total = torch.stack(terms).sum() if terms else torch.zeros(())
    if not total.requires_grad:
        return [torch.zeros_like(parameter) for parameter in parameters]
    return torch.autograd.grad(total, parameters, materialize_grads=True)


def _dot(one: Sequence[torch.Tensor], other: Sequence[torch.Tensor]) -> float:
    """Return the inner product in float64, without a copy of all gradients at once."""
    products = (
        torch.dot(a.flatten().double(), b.flatten().double())
        for a, b in zip(one, other, strict=True)
    )
    return float(sum(products, start=torch.zeros(())))


@contextmanager
def untouched(loss: CoTrainingLoss) -> Iterator[None]:
    """Undo what a forward pass does to buffers and random number generators.

    KLPENPPOLoss adapts its coefficient and normalisation layers their statistics.
    """
    buffers = list(loss.buffers())
    before = [buffer.clone() for buffer in buffers]
    cuda = {p.device.index for p in loss.parameters() if p.device.type == "cuda"}
    with torch.random.fork_rng(devices=sorted(cuda)):
        try:
            yield
        finally:
            with torch.no_grad():
                for buffer, value in zip(buffers, before, strict=True):
                    buffer.copy_(value)
