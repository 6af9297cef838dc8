"""Which of torch's transforms work on CoTrainingLoss around which of TorchRL's losses.

Run ``python benchmarks/loss_transforms.py`` with OMP_NUM_THREADS=1; it prints one
markdown table, some minutes. Each loss stands on ``sim``, TorchRL's BCLoss (for rows
with chunks rlco's ImitationLoss) on ``real``, on one actor. A cell says "yes" where the
transform gives what calling the loss gives, in its weighted terms and in their gradient
on every parameter, to 1e-4 of the largest:

- ``compile``: ``torch.compile(loss, fullgraph=True)``; "breaks" where only
  ``fullgraph=False`` does;
- ``functional_call``: ``torch.func.functional_call(loss, parameters, (batch,))``;
- ``to_module``: TensorDict's way to the same, ``with parameters.to_module(loss)``;
- ``vmap``: gradients of each row by ``torch.func.vmap`` over ``torch.func.grad`` of
  that, whose mean is the batch's gradient.

What fails is named by its exception. Last table (torch 2.11, TorchRL 0.14.1):

| loss on `sim` | `compile` | `functional_call` | `to_module` | `vmap` |
|---|---|---|---|---|
| PPOLoss | yes | TypeError | yes | RuntimeError |
| ClipPPOLoss | yes | TypeError | yes | RuntimeError |
| ClipPPOLoss, clip_value | breaks (Unsupported) | TypeError | yes | RuntimeError |
| KLPENPPOLoss | BackendCompilerFailed | TypeError | yes | RuntimeError |
| A2CLoss | yes | TypeError | yes | RuntimeError |
| ReinforceLoss | yes | TypeError | yes | RuntimeError |
| SACLoss | breaks (Unsupported) | TypeError | yes | RuntimeError |
| IQLLoss | yes | TypeError | yes | yes |
| TD3Loss | other numbers | TypeError | yes | other numbers |
| DDPGLoss | yes | TypeError | yes | yes |
| ClipPPOLoss, chunks | yes | TypeError | yes | RuntimeError |
| ClipPPOLoss, chunks, not functional | yes | TypeError | yes | RuntimeError |
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.func import functional_call, grad, vmap
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import (
    IndependentNormal,
    NormalParamExtractor,
    ProbabilisticActor,
    TanhNormal,
    ValueOperator,
)
from torchrl.objectives import (
    A2CLoss,
    BCLoss,
    ClipPPOLoss,
    DDPGLoss,
    IQLLoss,
    KLPENPPOLoss,
    LossModule,
    PPOLoss,
    ReinforceLoss,
    SACLoss,
    TD3Loss,
)

from rlco.losses import CoTrainingLoss, ImitationLoss
from rlco.policies import GaussianPolicy, ValueNetwork

ROWS, SEEN, ACTED = 6, 3, 2
TOLERANCE = 1e-4

Terms = dict[str, Tensor]
Case = tuple[CoTrainingLoss, TensorDictBase]


# -- Losses and batches --------------------------------------------------------


def gaussian_actor(kind: Any = IndependentNormal) -> ProbabilisticActor:
    """Return TorchRL's usual actor: a mean and a scale."""
    network = nn.Sequential(nn.Linear(SEEN, 2 * ACTED), NormalParamExtractor())
    module = TensorDictModule(network, ["observation"], ["loc", "scale"])
    return ProbabilisticActor(
        module, ["loc", "scale"], distribution_class=kind, return_log_prob=True
    )


def plain_actor() -> TensorDictModule:
    """Return a deterministic actor."""
    network = nn.Sequential(nn.Linear(SEEN, ACTED), nn.Tanh())
    return TensorDictModule(network, ["observation"], ["action"])


def value() -> ValueOperator:
    """Return a critic of states."""
    return ValueOperator(nn.Linear(SEEN, 1), ["observation"])


class Joined(nn.Module):
    """Linear in state and action."""

    def __init__(self) -> None:
        super().__init__()
        self.inner = nn.Linear(SEEN + ACTED, 1)

    def forward(self, seen: Tensor, acted: Tensor) -> Tensor:
        """Return the value (*B, 1)."""
        joined: Tensor = self.inner(torch.cat([seen, acted], -1))
        return joined


def action_value() -> ValueOperator:
    """Return a critic of states and actions."""
    return ValueOperator(Joined(), ["observation", "action"])


def transitions() -> TensorDictBase:
    """Return rows with all that any of the losses reads."""
    content = {
        "observation": torch.randn(ROWS, SEEN),
        "action": torch.rand(ROWS, ACTED) - 0.5,
        "loc": torch.randn(ROWS, ACTED),
        "scale": torch.rand(ROWS, ACTED) + 0.5,
        "action_log_prob": torch.randn(ROWS),
        "state_value": torch.randn(ROWS, 1),
        "advantage": torch.randn(ROWS, 1),
        "value_target": torch.randn(ROWS, 1),
        "next": {
            "observation": torch.randn(ROWS, SEEN),
            "reward": torch.randn(ROWS, 1),
            "done": torch.zeros(ROWS, 1, dtype=torch.bool),
            "terminated": torch.zeros(ROWS, 1, dtype=torch.bool),
        },
    }
    return TensorDict(content, [ROWS])


def beside_bc(make: Callable[[Any], LossModule], actor: Any) -> Case:
    """Return a loss beside BCLoss, with gamma for those that estimate values."""
    sim = make(actor)
    if isinstance(sim, SACLoss | TD3Loss | DDPGLoss | IQLLoss):
        sim.make_value_estimator(gamma=0.9)
    batch = TensorDict({"sim": transitions(), "real": transitions()})
    return CoTrainingLoss(sim, BCLoss(actor)), batch


def of_chunks(*, functional: bool) -> Case:
    """Return rlco's own policy in PPO and ImitationLoss."""
    policy = GaussianPolicy(SEEN, chunk=2, action_size=ACTED, hidden=(8,))
    critic = ValueNetwork(SEEN, hidden=(8,))
    seen = TensorDict({"observation": {"state": torch.randn(ROWS, SEEN)}}, [ROWS])
    with torch.no_grad():
        sim = policy(seen.clone())
    for name in ("advantage", "value_target", "state_value"):
        sim[name] = torch.randn(ROWS, 1)
    real = seen.clone().set(("vla_action", "chunk"), torch.rand(ROWS, 2, ACTED) - 0.5)
    loss = CoTrainingLoss(
        ClipPPOLoss(policy, critic, functional=functional, entropy_bonus=False),
        ImitationLoss(policy, functional=functional),
    )
    return loss, TensorDict({"sim": sim, "real": real})


CASES: dict[str, Callable[[], Case]] = {
    "PPOLoss": lambda: beside_bc(lambda a: PPOLoss(a, value()), gaussian_actor()),
    "ClipPPOLoss": lambda: beside_bc(
        lambda a: ClipPPOLoss(a, value()), gaussian_actor()
    ),
    "ClipPPOLoss, clip_value": lambda: beside_bc(
        lambda a: ClipPPOLoss(a, value(), clip_value=0.2), gaussian_actor()
    ),
    "KLPENPPOLoss": lambda: beside_bc(
        lambda a: KLPENPPOLoss(a, value()), gaussian_actor()
    ),
    "A2CLoss": lambda: beside_bc(lambda a: A2CLoss(a, value()), gaussian_actor()),
    "ReinforceLoss": lambda: beside_bc(
        lambda a: ReinforceLoss(a, value()), gaussian_actor()
    ),
    "SACLoss": lambda: beside_bc(
        lambda a: SACLoss(a, action_value(), action_spec=None, target_entropy=-2.0),
        gaussian_actor(TanhNormal),
    ),
    "IQLLoss": lambda: beside_bc(
        lambda a: IQLLoss(a, action_value(), value()), gaussian_actor()
    ),
    "TD3Loss": lambda: beside_bc(
        lambda a: TD3Loss(a, action_value(), bounds=(-1.0, 1.0)), plain_actor()
    ),
    "DDPGLoss": lambda: beside_bc(lambda a: DDPGLoss(a, action_value()), plain_actor()),
    "ClipPPOLoss, chunks": lambda: of_chunks(functional=True),
    "ClipPPOLoss, chunks, not functional": lambda: of_chunks(functional=False),
}


# -- Transforms ----------------------------------------------------------------


def terms(out: TensorDictBase) -> Terms:
    """Return the weighted terms of a loss."""
    return {name: v for name, v in out.items() if name.startswith("loss_")}


def total(out: TensorDictBase) -> Tensor:
    """Return their sum."""
    return torch.stack(list(terms(out).values())).sum()


def trained(loss: CoTrainingLoss) -> dict[str, nn.Parameter]:
    """Return the parameters that are trained, by name."""
    return {n: p for n, p in loss.named_parameters() if p.requires_grad}


def gradients(loss: CoTrainingLoss, value: Tensor) -> Terms:
    """Return the gradient of a value on each trained parameter."""
    found = torch.autograd.grad(
        value, list(trained(loss).values()), materialize_grads=True
    )
    return dict(zip(trained(loss), found, strict=True))


def called(loss: CoTrainingLoss, run: Callable[[], TensorDictBase]) -> Terms:
    """Return terms and gradients of one call, from one random state."""
    torch.manual_seed(1)
    out = run()
    return terms(out) | gradients(loss, total(out))


def by_compile(loss: CoTrainingLoss, batch: TensorDictBase, *, whole: bool) -> Terms:
    """Return the same of the compiled loss."""
    torch.compiler.reset()
    compiled = torch.compile(loss, fullgraph=whole)
    return called(loss, lambda: compiled(batch))


Given = dict[str, Tensor]
Call = Callable[[CoTrainingLoss, Given, TensorDictBase], TensorDictBase]


def by_torch(loss: CoTrainingLoss, given: Given, batch: TensorDictBase) -> Any:
    """Call the loss with given parameters, torch's way."""
    return functional_call(loss, given, (batch,))


def by_tensordict(loss: CoTrainingLoss, given: Given, batch: TensorDictBase) -> Any:
    """Call the loss with given parameters, TensorDict's way."""
    names = {id(parameter): name for name, parameter in trained(loss).items()}
    own = TensorDict.from_module(loss)
    swapped = own.apply(lambda p: given[names[id(p)]] if id(p) in names else p)
    with swapped.to_module(loss):
        return loss(batch)


def from_outside(loss: CoTrainingLoss, batch: TensorDictBase, call: Call) -> Terms:
    """Return the same, the parameters given from outside."""
    given = {n: p.detach().clone().requires_grad_() for n, p in trained(loss).items()}
    torch.manual_seed(1)
    out = call(loss, given, batch)
    found = torch.autograd.grad(
        total(out), list(given.values()), materialize_grads=True
    )
    return terms(out) | dict(zip(given, found, strict=True))


def by_vmap(loss: CoTrainingLoss, batch: TensorDictBase) -> Terms:
    """Return the mean over rows of each row's gradient."""
    rows = TensorDict(
        {root: batch[root].unsqueeze(1) for root in ("sim", "real")}, [ROWS]
    )

    def one(given: dict[str, Tensor], row: TensorDictBase) -> Tensor:
        return total(by_tensordict(loss, given, row))

    given = {n: p.detach() for n, p in trained(loss).items()}
    each = vmap(grad(one), (None, 0), randomness="different")(given, rows)
    return {name: found.mean(0) for name, found in each.items()}


Transform = Callable[[CoTrainingLoss, TensorDictBase], Terms]


def built(make: Callable[[], Case]) -> Case:
    """Return a loss and its batch, the same each time: some losses keep a state."""
    torch.manual_seed(0)
    return make()


def verdict(make: Callable[[], Case], transform: Transform) -> str:
    """Say whether a transform gives what a call gives."""
    loss, batch = built(make)
    wanted = called(loss, lambda: loss(batch))
    loss, batch = built(make)
    try:
        found = transform(loss, batch)
    # What torch raises is the result that is asked for.
    except (RuntimeError, TypeError, ValueError) as error:
        return type(error).__name__
    for name, one in found.items():
        scale = max(float(wanted[name].abs().max()), 1e-3)
        if float((one - wanted[name]).abs().max()) > TOLERANCE * scale:
            return "other numbers"
    return "yes"


def row(name: str, make: Callable[[], Case]) -> str:
    """Return a line of the table."""
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        compiled = verdict(make, partial(by_compile, whole=True))
        if compiled != "yes":
            parts = verdict(make, partial(by_compile, whole=False))
            compiled = f"breaks ({compiled})" if parts == "yes" else parts
        by_call = verdict(make, partial(from_outside, call=by_torch))
        swapped = verdict(make, partial(from_outside, call=by_tensordict))
        mapped = verdict(make, by_vmap)
    return f"| {name} | {compiled} | {by_call} | {swapped} | {mapped} |"


def main(names: list[str]) -> None:
    """Print the table."""
    sys.stdout.write(
        "| loss on `sim` | `compile` | `functional_call` | `to_module` | `vmap` |\n"
    )
    sys.stdout.write("|---|---|---|---|---|\n")
    for name in names or CASES:
        sys.stdout.write(row(name, CASES[name]) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    main(sys.argv[1:])
