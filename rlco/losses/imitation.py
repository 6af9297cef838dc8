"""Imitation of demonstrated action chunks, padding left out."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any, Literal

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictParams, dispatch
from torchrl.objectives import LossModule

from rlco.errors import ConfigError, DataError
from rlco.keys import CHUNK, IS_PAD


class ImitationLoss(LossModule):
    """Mean of the actor's per-step imitation loss over what is not padding.

    With ``l`` [B, H] = ``actor.imitation_loss(td)`` and ``p`` [B, H] = the padding,
    ``loss_bc = sum(l where not p) / count(not p)``. A padded step may hold anything,
    NaN included: it is replaced before the actor sees it and left out of the sum, so
    that neither value nor gradient depends on it. A batch of padding alone gives 0.

    Functional (TorchRL's default): the parameters live in ``actor_network_params``;
    move the actor to its device before building the loss. Otherwise the actor is a
    submodule, as DDP and FSDP want it. ``loss.train()`` and ``.eval()`` reach the
    actor only in the second case.

    Args:
        actor: a policy with ``imitation_loss``, see :class:`rlco.policies.Actor`.
        functional: whether the actor is made functional.
        reduction: "mean" or "sum" over the steps that are not padded.

    Keys, for ``set_keys``: ``chunk`` ``("vla_action", "chunk")`` [B, H, A], raw units;
    ``is_pad`` ``"action_is_pad"`` [B, H], optional.

    Raises:
        ConfigError: the actor has no ``imitation_loss``, or an unknown reduction.
        DataError: no chunk in the batch, or a mask of another shape than the loss.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from rlco.policies import GaussianPolicy
        >>> loss = ImitationLoss(GaussianPolicy(3, chunk=2, action_size=1))
        >>> td = TensorDict(
        ...     {"observation": {"state": torch.zeros(1, 3)},
        ...      "vla_action": {"chunk": torch.tensor([[[0.5], [torch.nan]]])},
        ...      "action_is_pad": torch.tensor([[False, True]])}, [1])
        >>> round(loss(td)["loss_bc"].item(), 2)  # the mean starts near 0: 0.5 ** 2
        0.25
    """

    @dataclass
    class _AcceptedKeys:
        chunk: NestedKey = CHUNK
        is_pad: NestedKey = IS_PAD

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys
    actor_network: Any
    actor_network_params: TensorDictParams | None
    target_actor_network_params: TensorDictParams | None

    def __init__(
        self,
        actor: Any,
        *,
        functional: bool = True,
        reduction: Literal["mean", "sum"] = "mean",
    ) -> None:
        super().__init__()
        if not callable(getattr(actor, "imitation_loss", None)):
            raise ConfigError(
                [
                    f"{type(actor).__name__} has no imitation_loss(td); use a policy "
                    "of rlco.policies, or TorchRL's BCLoss as the imitation loss"
                ]
            )
        if reduction not in ("mean", "sum"):
            raise ConfigError(
                [f"unknown reduction {reduction!r}; known: 'mean', 'sum'"]
            )
        self._functional = functional
        self._in_keys: list[NestedKey] | None = None
        self._out_keys: list[NestedKey] = ["loss_bc"]
        self.reduction = reduction
        if functional:
            self.convert_to_functional(actor, "actor_network")
        else:
            self.actor_network = actor
            self.actor_network_params = None

    @property
    def functional(self) -> bool:
        """Whether the parameters live outside the actor."""
        return self._functional

    @property
    def in_keys(self) -> list[NestedKey]:
        """What is read; the padding mask may be absent."""
        if self._in_keys is not None:
            return self._in_keys
        keys = self.tensor_keys
        return [*self.actor_network.in_keys, keys.chunk, keys.is_pad]

    @in_keys.setter
    def in_keys(self, keys: list[NestedKey]) -> None:
        self._in_keys = keys

    @property
    def out_keys(self) -> list[NestedKey]:
        """What is returned: ``loss_bc``."""
        return self._out_keys

    @out_keys.setter
    def out_keys(self, keys: list[NestedKey]) -> None:
        self._out_keys = keys

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return ``loss_bc``, a scalar; ``tensordict`` is left as it is."""
        data, is_pad = self._without_padding(tensordict)
        with self._parameters_in_place():
            steps = self.actor_network.imitation_loss(data)
        if is_pad is not None and is_pad.shape != steps.shape:
            raise DataError(
                f"{self.tensor_keys.is_pad!r} has shape {tuple(is_pad.shape)}, the "
                f"imitation loss {tuple(steps.shape)}; give one flag a step."
            )
        mask = None if is_pad is None else ~is_pad
        loss = self._reduce_loss(steps, data, mask=mask)
        return TensorDict({"loss_bc": loss})

    def _without_padding(
        self, tensordict: TensorDictBase
    ) -> tuple[TensorDictBase, torch.Tensor | None]:
        """Return a shallow copy whose padded steps are 0, and the padding mask."""
        keys = self.tensor_keys
        chunk = tensordict.get(keys.chunk, None)
        if chunk is None:
            raise DataError(
                f"the batch has no {keys.chunk!r} to imitate; demonstrations hold it."
            )
        is_pad = tensordict.get(keys.is_pad, None)
        data = tensordict.copy()
        if is_pad is not None:
            # Selected, not multiplied: 0 * NaN is NaN, in the gradient too.
            chunk = torch.where(is_pad.unsqueeze(-1), torch.zeros_like(chunk), chunk)
        data.set(CHUNK, chunk)
        return data, is_pad

    def _parameters_in_place(self) -> contextlib.AbstractContextManager[Any]:
        params = self.actor_network_params
        if params is None:
            return contextlib.nullcontext()
        swapped: contextlib.AbstractContextManager[Any] = params.to_module(
            self.actor_network, preserve_module_state=False
        )
        return swapped

    def _forward_value_estimator_keys(self, **kwargs: Any) -> None:
        del kwargs  # There is no value estimator.

    def reset_parameters_recursive(self) -> None:
        """Draw the actor's parameters anew."""
        if self.functional:
            super().reset_parameters_recursive()
        else:
            self.actor_network.reset_parameters_recursive()
