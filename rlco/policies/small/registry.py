"""The kinds of policies by name."""

from __future__ import annotations

from typing import Any

from rlco.errors import UnknownNameError
from rlco.policies.small.chunk_policy import ChunkPolicy
from rlco.policies.small.flow import FlowPolicy
from rlco.policies.small.gaussian import GaussianPolicy
from rlco.policies.small.token import TokenPolicy

_KINDS: dict[str, type[ChunkPolicy]] = {
    policy.kind: policy for policy in (GaussianPolicy, TokenPolicy, FlowPolicy)
}


def make_policy(kind: str, **arguments: Any) -> Any:
    """Build a policy by its kind's name.

    Args:
        kind: "gaussian", "token" or "flow".
        **arguments: the constructor's.

    Raises:
        UnknownNameError: no such kind.

    Example:
        >>> make_policy("gaussian", state_size=3, chunk=4).chunk
        4
    """
    if kind not in _KINDS:
        raise UnknownNameError("policy", kind, sorted(_KINDS))
    return _KINDS[kind](**arguments)
