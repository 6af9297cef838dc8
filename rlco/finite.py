"""Checks that a training's numbers are finite: steps, and what is saved and loaded.

NaN is checked for where it arises, because everything later hides it: a weight that is
NaN makes the next loss NaN, and from then on every weight.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.utils import get_total_norm

from rlco.errors import CheckpointError, NonFiniteError

Named = Iterable[tuple[str, Tensor]]


def is_finite(tensor: Tensor) -> bool:
    """Return whether a tensor is free of NaN and infinity; integers always are.

    Example:
        >>> is_finite(torch.tensor([1.0, torch.inf])), is_finite(torch.arange(3))
        (False, True)
    """
    if not (tensor.is_floating_point() or tensor.is_complex()):
        return True
    # The sum needs no copy. It may overflow: what it does not clear is looked at again.
    return bool(tensor.detach().sum().isfinite()) or bool(tensor.isfinite().all())


def named_tensors(state: Any, where: str = "") -> Iterator[tuple[str, Tensor]]:
    """Yield the tensors of nested dicts, lists and tuples with their dotted places.

    Example:
        >>> [name for name, _ in named_tensors({"optimizer": [torch.ones(1), 3]})]
        ['optimizer.0']
    """
    if isinstance(state, Tensor):
        yield where, state
    elif isinstance(state, Mapping):
        for key, value in state.items():
            yield from named_tensors(value, f"{where}.{key}" if where else str(key))
    elif isinstance(state, list | tuple):
        yield from named_tensors(dict(enumerate(state)), where)


def gradient_norm(parameters: Iterable[nn.Parameter]) -> Tensor:
    """Return the norm of all gradients together, as `clip_grad_norm_` computes it."""
    norm: Tensor = get_total_norm([p.grad for p in parameters if p.grad is not None])
    return norm


def check_step(
    update: str,
    terms: Named,
    norms: Sequence[Tensor],
    modules: Mapping[str, nn.Module],
) -> None:
    """Check a loss and its gradient before an optimiser follows them.

    Args:
        update: What it is called in messages, "update 17".
        terms: The loss's terms, scalars.
        norms: Norms of the gradients, unclipped: clipping spreads a NaN to all of them.
        modules: What is trained, by name.

    Raises:
        NonFiniteError: One is NaN or infinite; what became so first is named.
    """
    terms = list(terms)
    numbers = [*norms, *(value.detach() for _, value in terms)]
    # One comparison, and so one wait for the device.
    together = torch.stack([number.to(numbers[0].device) for number in numbers])
    if not bool(together.isfinite().all()):
        raise NonFiniteError(_first(update, terms, modules))


def check_weights(update: str, modules: Mapping[str, nn.Module]) -> None:
    """Check the trained weights after an optimiser's step.

    Raises:
        NonFiniteError: One is NaN or infinite; it is named.
    """
    named = list(_trained(modules))
    if bool(get_total_norm([weights for _, weights in named]).isfinite()):
        return
    if problems := _problems(named):
        raise NonFiniteError(
            f"{_listed(problems)} after {update}: the step was too large; "
            f"{_advice(problems[0])}."
        )


def check_saved(what: str, named: Named) -> None:
    """Check tensors before anything of them is written.

    Args:
        what: What they are, for the message.
        named: The tensors by name.

    Raises:
        NonFiniteError: One holds NaN or infinity.
    """
    if problems := _problems(named, masks=True):
        raise NonFiniteError(
            f"{what} is not written, as {_listed(problems)}: training diverged; "
            f"{_advice(problems[0])}."
        )


def check_loaded(
    source: str, named: Named, *, advice: str = "give one from before that"
) -> None:
    """Check tensors that were read from a file.

    Args:
        source: The file, for the message.
        named: The tensors by name.
        advice: What to do about it.

    Raises:
        CheckpointError: One holds NaN or infinity.
    """
    if problems := _problems(named, masks=True):
        raise CheckpointError(
            f"{source!r} holds numbers that are not finite: {_listed(problems)}; the "
            f"training that wrote it diverged: {advice}."
        )


def _first(update: str, terms: Named, modules: Mapping[str, nn.Module]) -> str:
    """Say what became NaN first: weights before the loss, the loss before gradients."""
    if problems := _problems(_trained(modules)):
        return (
            f"{_listed(problems)} before {update}: the step before it was too large; "
            f"{_advice(problems[0])}."
        )
    for name, value in terms:
        if not bool(value.isfinite()):
            return (
                f"{name} became {float(value.detach()):g} in {update}, while all "
                "weights were finite: they have grown too large, or the batch is not "
                f"finite; {_advice(name)}, or look for such numbers in the data."
            )
    gradients = (
        (f"the gradient of {name}", weights.grad)
        for name, weights in _trained(modules)
        if weights.grad is not None
    )
    if problems := _problems(gradients):
        found = _listed(problems)
    else:
        found = "the norm of the gradient is infinite"
    return f"{found} in {update}, where the loss was finite; {_advice(found)}."


def _trained(modules: Mapping[str, nn.Module]) -> Iterator[tuple[str, Tensor]]:
    for prefix, module in modules.items():
        for name, weights in module.named_parameters():
            if weights.requires_grad:
                yield f"{prefix}.{name}", weights


def _problems(named: Named, *, masks: bool = False) -> list[str]:
    """Say of each tensor that is not finite how many of its numbers are not.

    Args:
        named: The tensors by name.
        masks: Whether additive attention masks are among them, infinite on purpose.
    """
    return [
        _problem(name, value)
        for name, value in named
        if not is_finite(value) and not (masks and _is_mask(value))
    ]


def _is_mask(value: Tensor) -> bool:
    """Return whether a tensor is made of 0 and -inf alone, as masks are."""
    zero = value == 0
    return bool(zero.any() and (zero | (value == -torch.inf)).all())


def _problem(name: str, value: Tensor) -> str:
    kind = "nan" if bool(value.isnan().any()) else "infinite"
    count = int((~value.isfinite()).sum())
    return f"{name} is {kind} ({count} of {value.numel()} numbers not finite)"


def _listed(problems: Sequence[str]) -> str:
    more = f" (and {len(problems) - 1} others)" if len(problems) > 1 else ""
    return f"{problems[0]}{more}"


def _advice(name: str) -> str:
    if ".noise." in name:  # beside a LeRobot checkpoint it learns at the critic's rate
        return "lower lr and critic_lr"
    return "lower critic_lr" if "critic" in name else "lower lr"
