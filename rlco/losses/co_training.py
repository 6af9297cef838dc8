"""Reinforcement learning in the simulator, anchored to real demonstrations."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, is_tensor_collection
from tensordict.nn import dispatch
from torchrl.objectives import LossModule

from rlco.errors import ConfigError, DataError, UnknownNameError
from rlco.keys import REAL, SIM
from rlco.losses import ppo_keys
from rlco.losses.actor_pair import ActorPair, actor_problems, check_same_actor

_ROOTS = (SIM, REAL)
_COEFFICIENTS = ("sim_coeff", "real_coeff")


class CoTrainingLoss(ActorPair):
    r"""Two losses of one actor, the first on simulated, the second on real data.

    .. math:: L = c_{sim} L_{sim}(\theta; D_{sim}) + c_{real} L_{real}(\theta; D_{real})

    Stage II of RL-Co (arXiv 2602.12628): a PPO loss and an imitation loss, with
    ``real_coeff`` = beta. Stage I: two imitation losses, ``sim_coeff`` = alpha and
    ``real_coeff`` = 1 - alpha, the expectation of drawing each sample from the
    simulation with probability alpha. Each term is a mean over its own data: how many
    rows a root has changes the variance, never the weight.

    It reads a batch with two roots, ``sim`` and ``real``, each with a batch size of its
    own, and returns the outputs of ``sim_loss`` as they are named and those of
    ``real_loss`` with ``_real`` appended. What starts with ``loss_`` is weighted and
    differentiable: sum it up and call ``backward``. All else is detached.

    A coefficient of 0 at construction is fixed: its root may be absent, its loss may be
    None and is never computed, so that ``real_coeff=0`` is reinforcement learning alone
    and ``sim_coeff=0`` imitation of real data alone. Other coefficients are buffers and
    can be scheduled (``loss.real_coeff = 0.1``), also to 0.

    Any PPO and any imitation loss of TorchRL will do, functional or not, provided that
    both were built from the same actor object. Parameters count once, also in the state
    dict and in copies. Target parameters (``delay_actor=True``) belong to ``sim_loss``:
    ``SoftUpdate(loss.sim_loss, eps=...)``. Advantages must be in the batch, computed
    over the whole rollout; nothing is estimated from a shuffled minibatch.

    Args:
        sim_loss: the loss on the root ``sim``, with reduction "mean" or "sum".
        real_loss: the loss on the root ``real``, likewise.
        sim_coeff: weight of the first.
        real_coeff: weight of the second.

    Keys, for ``set_keys``: ``sim`` and ``real``, the roots. Other keys are those of
    ``sim_loss`` (of ``real_loss`` where there is no ``sim_loss``) and are handed on.

    Raises:
        ConfigError: two actors, a loss that is missing, is no LossModule or shows no
            actor, a reduction that keeps rows, coefficients that are negative or both
            0, or output names that collide; in ``forward``, a loss of which nothing
            is trained.
        DataError: in ``forward``, a root, its advantages or what a loss reads are
            missing.

    Example:
        >>> import torch
        >>> from rlco.losses import ImitationLoss
        >>> from rlco.policies import GaussianPolicy
        >>> actor = GaussianPolicy(3, chunk=2, action_size=1)
        >>> def demos(rows, target):
        ...     return TensorDict(
        ...         {"observation": {"state": torch.zeros(rows, 3)},
        ...          "vla_action": {"chunk": torch.full((rows, 2, 1), target)}}, [rows])
        >>> loss = CoTrainingLoss(
        ...     ImitationLoss(actor), ImitationLoss(actor),
        ...     sim_coeff=0.8, real_coeff=0.2)
        >>> out = loss(TensorDict({"sim": demos(8, 1.0), "real": demos(2, 0.5)}))
        >>> {name: round(value.item(), 2) for name, value in out.items()}
        {'loss_bc': 0.8, 'loss_bc_real': 0.05}
    """

    @dataclass
    class _AcceptedKeys:
        sim: NestedKey = SIM
        real: NestedKey = REAL

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys
    _schedulable_buffers = frozenset(_COEFFICIENTS)

    def __init__(
        self,
        sim_loss: LossModule | None,
        real_loss: LossModule | None,
        *,
        sim_coeff: float = 1.0,
        real_coeff: float = 0.2,
    ) -> None:
        losses = {SIM: sim_loss, REAL: real_loss}
        coefficients = {SIM: float(sim_coeff), REAL: float(real_coeff)}
        _check(losses, coefficients)
        super().__init__(sim_loss, real_loss)
        self._active = tuple(root for root in _ROOTS if coefficients[root] != 0)
        for root in _ROOTS:
            # A fixed 0 is not part of the state: other values must not load.
            self.register_buffer(
                f"{root}_coeff",
                torch.tensor(coefficients[root]),
                persistent=root in self._active,
            )
        self._in_keys: list[NestedKey] | None = None
        self._out_keys: list[NestedKey] | None = None
        if len(set(self.out_keys)) < len(self.out_keys):
            raise ConfigError([_collision(self.out_keys)])

    # -- The computation -------------------------------------------------------

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return the weighted terms, and what both losses report beside them."""
        outputs: dict[str, Any] = {}
        for named in self.terms(tensordict).values():
            if any(name in outputs for name in named):
                raise ConfigError([_collision([*outputs, *named])])
            outputs.update(named)
        return TensorDict(outputs)

    def terms(self, tensordict: TensorDictBase) -> dict[str, dict[str, Any]]:
        """Return what ``forward`` returns, apart by root ("sim", "real").

        Raises:
            DataError: a root is missing, or the advantages of a PPO loss.
        """
        return {root: self.terms_of(root, tensordict) for root in self._active}

    def terms_of(self, root: str, tensordict: TensorDictBase) -> dict[str, Any]:
        """Return the terms of one root ("sim" or "real"), the other may be missing.

        Raises:
            DataError: the root is missing, or the advantages of a PPO loss.
        """
        loss, coefficient = self._loss_on(root), getattr(self, f"{root}_coeff")
        suffix = "_real" if root == REAL else ""
        named: dict[str, Any] = {}
        data = self._data(root, loss, tensordict)
        try:
            returned = loss(data)
        except (AttributeError, KeyError, TypeError) as error:
            key = getattr(self.tensor_keys, root)
            if problem := _missing(f"the root {key!r}", loss, data):
                raise DataError(problem) from error
            raise
        _check_terms(root, loss, returned)
        for name, value in returned.items():
            if name.startswith("loss_"):
                named[name + suffix] = coefficient * value
            elif name.startswith("loss"):
                raise ConfigError(
                    [f"{type(loss).__name__} returns {name!r}, {_SUMMED}"]
                )
            else:
                named[name + suffix] = value.detach()
        return named

    def _data(
        self, root: str, loss: LossModule, tensordict: TensorDictBase
    ) -> TensorDictBase:
        key = getattr(self.tensor_keys, root)
        data: TensorDictBase | None = tensordict.get(key, None)
        if data is None or not is_tensor_collection(data):
            raise DataError(
                f"the batch has no root {key!r}; give it {root} data, or build the "
                f"loss with {root}_coeff=0."
            )
        for needed in ppo_keys.precomputed_keys(loss):
            if data.get(needed, None) is None:
                raise DataError(
                    f"the root {key!r} has no {needed!r}; run an advantage estimator "
                    "(torchrl.objectives.value.GAE) on the whole rollout before "
                    "drawing minibatches."
                )
        return data

    @property
    def roots(self) -> tuple[str, ...]:
        """The roots whose loss is computed: those without a coefficient fixed at 0."""
        return self._active

    def _loss_on(self, root: str) -> LossModule:
        return self.sim_loss if root == SIM else self.real_loss

    # -- Keys ------------------------------------------------------------------

    @property
    def in_keys(self) -> list[NestedKey]:
        """What is read: each key under its root."""
        if self._in_keys is not None:
            return self._in_keys
        keys: list[NestedKey] = []
        for root in self._active:
            path = _as_tuple(getattr(self.tensor_keys, root))
            inner = ppo_keys.input_keys(self._loss_on(root))
            keys += [path + _as_tuple(key) for key in inner]
        return keys

    @in_keys.setter
    def in_keys(self, keys: list[NestedKey]) -> None:
        self._in_keys = keys

    @property
    def out_keys(self) -> list[NestedKey]:
        """What is returned: the keys of ``sim_loss``, then those of ``real_loss``."""
        if self._out_keys is not None:
            return self._out_keys
        keys: list[NestedKey] = []
        for root in self._active:
            suffix = "_real" if root == REAL else ""
            keys += [key + suffix for key in ppo_keys.output_keys(self._loss_on(root))]
        return keys

    @out_keys.setter
    def out_keys(self, keys: list[NestedKey]) -> None:
        self._out_keys = keys

    def set_keys(self, **kwargs: Any) -> None:
        """Set the roots' names; other keys are set on ``sim_loss``.

        Raises:
            UnknownNameError: neither has such a key.
        """
        own = self._AcceptedKeys.__dataclass_fields__
        inner = self._main._AcceptedKeys.__dataclass_fields__
        for name in kwargs:
            if name not in own and name not in inner:
                raise UnknownNameError("key", name, [*own, *inner])
        super().set_keys(**{k: v for k, v in kwargs.items() if k in own})
        handed_on = {k: v for k, v in kwargs.items() if k not in own}
        if handed_on:
            self._main.set_keys(**handed_on)

    def _forward_value_estimator_keys(self, **kwargs: Any) -> None:
        del kwargs  # The roots' names concern no value estimator.

    def __setattr__(self, name: str, value: Any) -> None:
        root = name.removesuffix("_coeff")
        if name in _COEFFICIENTS and (problem := _coefficient_problem(name, value)):
            raise ConfigError([problem])
        if (
            name in _COEFFICIENTS
            and root not in self.__dict__.get("_active", _ROOTS)
            and float(value) != 0
        ):
            raise ConfigError(
                [
                    f"{name} was fixed at 0 when the loss was built, {value} would "
                    "have no effect; build it with another value, then schedule it"
                ]
            )
        super().__setattr__(name, value)


def _coefficient_problem(name: str, value: Any) -> str | None:
    number = float(value)
    if math.isfinite(number) and number >= 0:
        return None
    return f"{name}={number} must be finite and >= 0"


def _missing(where: str, loss: LossModule, data: TensorDictBase) -> str | None:
    """Say which entry a loss reads that its data lack; None if they have all."""
    held = ", ".join(map(repr, data.keys(include_nested=True, leaves_only=True)))
    for key in ppo_keys.input_keys(loss):
        value = data.get(key, None)
        if value is None:
            return (
                f"{where} has no {key!r}, which {type(loss).__name__} reads; it has "
                f"{held}."
            )
        if is_tensor_collection(value):
            return (
                f"{where} has entries under {key!r}, where {type(loss).__name__} reads "
                f"a tensor; it has {held}: give the one that is meant that name."
            )
    return None


def _check_terms(root: str, loss: LossModule, returned: Any) -> None:
    """Check that something of what a loss returned can be trained.

    Raises:
        ConfigError: There is no term, one is not a single number, or none depends on
            a parameter that is trained.
    """
    name = f"{root}_loss, a {type(loss).__name__},"
    terms = {key: value for key, value in returned.items() if key.startswith("loss_")}
    if not terms:
        raise ConfigError(
            [
                f"{name} returned {', '.join(returned.keys()) or 'nothing'} and no "
                "term loss_*, so that nothing of it is trained; name its term "
                "loss_SOMETHING"
            ]
        )
    for key, value in terms.items():
        if value.numel() != 1:
            raise ConfigError(
                [
                    f"{name} returned {key} of shape {tuple(value.shape)}, but a term "
                    "is one number; take its mean over rows and steps"
                ]
            )
    if (
        torch.is_grad_enabled()
        and not any(value.requires_grad for value in terms.values())
        and any(parameter.requires_grad for parameter in loss.parameters())
    ):
        raise ConfigError(
            [
                f"{name} returned {', '.join(terms)} without a gradient, so that "
                "nothing of it is trained; compute it from the actor's output, without "
                "detach() or no_grad()"
            ]
        )


_SUMMED = "which trainers would add to the loss; a term is named loss_*"


def _as_tuple(key: NestedKey) -> tuple[str, ...]:
    return (key,) if isinstance(key, str) else tuple(key)


def _collision(names: list[str]) -> str:
    twice = sorted({name for name in names if names.count(name) > 1})
    return f"sim_loss and real_loss both return {', '.join(twice)} (after '_real')"


def _check(
    losses: dict[str, LossModule | None], coefficients: dict[str, float]
) -> None:
    problems = []
    for root, coefficient in coefficients.items():
        loss = losses[root]
        if problem := _coefficient_problem(f"{root}_coeff", coefficient):
            problems.append(problem)
        if loss is None and coefficient != 0:
            problems.append(
                f"{root}_loss is None but {root}_coeff={coefficient}; give a loss or "
                f"{root}_coeff=0"
            )
        if loss is not None:
            problems += actor_problems(f"{root}_loss", loss)
        reduction = getattr(loss, "reduction", "mean")
        if reduction not in ("mean", "sum"):
            problems.append(
                f"{root}_loss has reduction={reduction!r}; it must be 'mean' or 'sum'"
            )
    if not any(coefficients.values()):
        problems.append("sim_coeff and real_coeff are both 0: nothing is trained")
    if problems:
        raise ConfigError(problems)
    sim, real = losses[SIM], losses[REAL]
    if sim is not None and real is not None:
        check_same_actor(sim, real)
