"""Whether a policy's actions have the units that an environment takes."""

from __future__ import annotations

from typing import Any

from torchrl.data import Bounded
from torchrl.envs import TransformedEnv

from rlco.errors import RlcoError
from rlco.physics.spec.actions import TOLERANCE


def check_action_units(policy: Any, env: Any) -> None:
    """Check that a policy acts in the units of an environment, where both say so.

    A policy says so by its ``action_limit``: None is its robot's own units, such as
    degrees, a number L is [-L, L]. An environment says by ``scales_actions`` whether it
    maps [-1, 1] to a range of its own, as rlco's environments do, and those of
    `from_gymnasium` and `canonical` with ``scale_actions=True``.

    Call it before playing a policy in an environment by a loop of your own;
    `rlco.evaluation.evaluate` and `RolloutCollector` call it.

    Args:
        policy: Any policy; one without ``action_limit`` is not checked.
        env: Any environment; one without ``scales_actions`` is not checked.

    Raises:
        RlcoError: The policy's own units would be scaled, or the policy is clipped to
            a smaller range than the environment takes.

    Example:
        >>> from rlco.envs import make_env
        >>> from rlco.policies import GaussianPolicy
        >>> env = make_env("push_cube", num_envs=2, chunk=4)
        >>> check_action_units(GaussianPolicy(7, chunk=4), env)
        >>> check_action_units(GaussianPolicy(7, chunk=4, action_limit=None), env)
        Traceback (most recent call last):
        ...
        rlco.errors.RlcoError: the policy acts in its robot's own units ...
    """
    scales = _scales_actions(env)
    if scales is None or not hasattr(policy, "action_limit"):
        return
    limit: float | None = policy.action_limit
    if limit is None:
        if scales:
            raise RlcoError(
                "the policy acts in its robot's own units (action_limit=None), but "
                "this environment maps actions in [-1, 1] to its own range; build it "
                "with from_gymnasium(..., scale_actions=False), or train the policy on "
                "actions in [-1, 1]."
            )
        return
    spec = env.action_spec
    if scales or not isinstance(spec, Bounded):
        return
    low, high = float(spec.low.min()), float(spec.high.max())
    if max(-low, high) > limit + TOLERANCE:
        raise RlcoError(
            f"the policy's actions are clipped to [-{limit:g}, {limit:g}] "
            f"(action_limit={limit:g}), but this environment takes its own units, "
            f"{low:g} to {high:g}; build it with scale_actions=True, or train the "
            "policy on the robot's own units (task=null, action_limit=None)."
        )


def _scales_actions(env: Any) -> bool | None:
    """Return what an environment says, or the one that it wraps; None: nothing."""
    # Not by getattr: batched environments that are not started recurse without end.
    while "scales_actions" not in vars(env) and isinstance(env, TransformedEnv):
        env = env.base_env
    default = getattr(type(env), "scales_actions", None)
    said: bool | None = vars(env).get("scales_actions", default)
    return said
