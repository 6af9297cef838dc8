"""Two losses on one actor that stay on one actor, whatever is done to them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tensordict import NestedKey, TensorDict
from tensordict.nn import TensorDictParams
from torch import nn
from torchrl.objectives import LossModule

from rlco.errors import CheckpointError, ConfigError


class ActorPair(LossModule):
    """Base of a loss around two others that were built from the same actor.

    The actor's parameters count once in ``parameters()`` and in the state dict, also
    after a deep copy, pickling, ``.to()`` and loading. What trainers ask a PPO loss for
    is answered by ``sim_loss`` where there is one, else by ``real_loss``.
    """

    def __init__(
        self, sim_loss: LossModule | None, real_loss: LossModule | None
    ) -> None:
        super().__init__()
        self.sim_loss, self.real_loss = sim_loss, real_loss
        self.register_load_state_dict_post_hook(_reunite)
        if sim_loss is not None and real_loss is not None:
            tie_actor(sim_loss, real_loss)

    # -- What trainers ask for -------------------------------------------------

    # A public name that ends in "loss" would be wrapped by LossModule's metaclass.
    @property
    def _main(self) -> LossModule:
        return self.real_loss if self.sim_loss is None else self.sim_loss

    @property
    def functional(self) -> bool:
        """Whether the parameters of every loss live outside its networks."""
        losses = (self.sim_loss, self.real_loss)
        return all(loss.functional for loss in losses if loss is not None)

    @property
    def actor_network(self) -> Any:
        """The shared actor."""
        return self._main.actor_network

    @property
    def critic_network(self) -> Any:
        """The critic of ``sim_loss``; None where it has none."""
        return getattr(self._main, "critic_network", None)

    def shared_parameters(self) -> list[nn.Parameter]:
        """Return the shared actor's parameters that are trained."""
        parameters = actor_parameters(self._main).values()
        return [parameter for parameter in parameters if parameter.requires_grad]

    def make_value_estimator(
        self, value_type: Any = None, **hyperparams: Any
    ) -> ActorPair:
        """Set the value estimator of ``sim_loss``; ``forward`` never runs it."""
        self._main.make_value_estimator(value_type, **hyperparams)
        return self

    @property
    def value_estimator(self) -> Any:
        """The value estimator of ``sim_loss``, to run on whole rollouts."""
        return self._main.value_estimator

    def reset_parameters_recursive(self) -> None:
        """Draw the parameters of the actor and of all other networks anew."""
        for loss in (self.sim_loss, self.real_loss):
            if loss is not None:
                reset_parameters(loss)

    # -- One actor, whatever is done to this module ----------------------------

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)  # Worlds and unpickled losses come this way.
        _reunite(self)

    def _apply(self, fn: Any) -> ActorPair:
        super()._apply(fn)
        _reunite(self)
        return self

    def state_dict(self, *args: Any, prefix: str = "", **kwargs: Any) -> dict[str, Any]:
        """Return the state with the shared actor once, under ``sim_loss``."""
        state: dict[str, Any] = super().state_dict(*args, prefix=prefix, **kwargs)
        for twin, _ in self._twins(state, prefix):
            state.pop(twin, None)
        return state

    def _load_from_state_dict(
        self, state: dict[str, Any], prefix: str, *args: Any
    ) -> None:
        for twin, original in self._twins(state, prefix):
            state.setdefault(twin, state[original])
        *_, missing, _unexpected, _errors = args
        for name, value in self.state_dict(prefix=prefix).items():
            # TensorDictParams loads what it finds and says nothing of the rest.
            if "_params." not in name:
                continue
            if name not in state:
                missing.append(name)
            elif state[name].shape != value.shape:
                raise CheckpointError(
                    f"{name} has shape {tuple(state[name].shape)} in the checkpoint, "
                    f"expected {tuple(value.shape)}; load it with the options that it "
                    "was trained with."
                )
        super()._load_from_state_dict(state, prefix, *args)

    def _twins(self, state: dict[str, Any], prefix: str) -> list[tuple[str, str]]:
        """Pair the names of the actor's entries under both losses."""
        if self.sim_loss is None or self.real_loss is None:
            return []
        real = f"{prefix}real_loss.{actor_prefix(self.real_loss)}"
        sim = f"{prefix}sim_loss.{actor_prefix(self.sim_loss)}"
        return [(real + k[len(sim) :], k) for k in state if k.startswith(sim)]


def actor_parameters(loss: LossModule) -> dict[NestedKey, nn.Parameter]:
    """Return the parameters of the loss's actor by name."""
    params = loss.actor_network_params if loss.functional else _parameters_of(loss)
    return {
        name: value
        for name, value in params.items(include_nested=True, leaves_only=True)
        if isinstance(value, nn.Parameter)
    }


def _parameters_of(loss: LossModule) -> TensorDictParams:
    return TensorDict.from_module(loss.actor_network, as_module=True)


def actor_problems(option: str, loss: object) -> list[str]:
    """Return what a loss lacks to be trained beside another on one actor.

    Args:
        option: what it was given as, for the message.
        loss: the loss.
    """
    name = type(loss).__name__
    if not isinstance(loss, LossModule):
        return [
            f"{option} is a {name}, but a torchrl.objectives.LossModule is needed: "
            "subclass that, as docs/own_loss.md shows"
        ]
    if getattr(loss, "actor_network", None) is None:
        return [
            f"{option}, a {name}, has no actor_network that could be shared; in its "
            "constructor call self.convert_to_functional(actor, 'actor_network')"
        ]
    if loss.functional and getattr(loss, "actor_network_params", None) is None:
        return [
            f"{option}, a {name}, has functional=True but no actor_network_params; "
            "call self.convert_to_functional(actor, 'actor_network') where it keeps "
            "its actor, or let its property functional return False"
        ]
    return _key_problems(f"{option}, a {name},", loss)


def _key_problems(loss_is: str, loss: LossModule) -> list[str]:
    """Return what is wrong with the names of what a loss reads and returns."""
    lacking = [
        name
        for name in ("in_keys", "out_keys")
        if not isinstance(getattr(loss, name, None), Sequence)
    ]
    if lacking:
        return [
            f"{loss_is} has no {' and no '.join(lacking)}; list the entries that it "
            "reads and those that it returns"
        ]
    if not any(str(key).startswith("loss_") for key in loss.out_keys):
        return [
            f"{loss_is} returns {', '.join(map(str, loss.out_keys)) or 'nothing'} by "
            "its out_keys and no term loss_*, so that nothing of it would be trained; "
            "name its term loss_SOMETHING, there and in what forward returns"
        ]
    return []


def check_same_actor(sim_loss: LossModule, real_loss: LossModule) -> None:
    """Check that two losses train the very same parameters.

    Raises:
        ConfigError: they were built from two actors.
    """
    sim, real = actor_parameters(sim_loss), actor_parameters(real_loss)
    if sim.keys() != real.keys() or any(sim[name] is not real[name] for name in sim):
        raise ConfigError(
            [
                "sim_loss and real_loss do not share an actor; build both from the "
                "same policy object"
            ]
        )


def _reunite(pair: ActorPair, _incompatible: object = None) -> None:
    """Make both losses hold one actor again, after whatever may have split it."""
    losses = [loss for loss in (pair.sim_loss, pair.real_loss) if loss is not None]
    if len(losses) == 2:
        tie_actor(*losses)
    for loss in losses:
        restore_networks(loss)


def tie_actor(sim_loss: LossModule, real_loss: LossModule) -> None:
    """Keep the parameters of the shared actor in one container.

    Two containers of the same parameters come apart on a deep copy; one container, or
    one anew from the actor where only one of the losses is functional, does not.
    """
    if sim_loss.functional and real_loss.functional:
        real_loss.actor_network_params = sim_loss.actor_network_params
    elif real_loss.functional:
        real_loss.actor_network_params = _parameters_of(sim_loss)
    elif sim_loss.functional:
        sim_loss.actor_network_params = _parameters_of(real_loss)


def restore_networks(loss: LossModule) -> None:
    """Give the networks of a copied functional loss the parameters that it trains."""
    if not loss.functional:
        return
    # The actor last: a critic on the actor's layers may hold them without gradient.
    for name in ("critic_network", "actor_network"):
        params = getattr(loss, f"{name}_params", None)
        if params is not None:
            params.to_module(getattr(loss, name))


def actor_prefix(loss: LossModule) -> str:
    """Return how the names of the actor's entries in the state dict begin."""
    return "actor_network_params." if loss.functional else "actor_network."


def reset_parameters(loss: LossModule) -> None:
    """Draw the parameters of all the loss's networks anew."""
    if loss.functional:
        loss.reset_parameters_recursive()
        return
    for network in loss.children():
        network.reset_parameters_recursive()
