"""A Ray cluster: one of this machine alone, or one that is there."""

from __future__ import annotations

import importlib.util
import logging
import os
from typing import Any

from rlco.errors import ConfigError

#: Ray's uv hook may start workers on another Python; nobody is told of a run; and a
#: worker is as nice as the process that started its cluster, not by 15 more.
_SETTINGS = {
    "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0",
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_worker_niceness": "0",
}
#: Of a local cluster, for rollouts on their way and for weights [bytes].
_STORE = 512 * 2**20


def check_ray() -> None:
    """Check that Ray is installed.

    Raises:
        ConfigError: It is not.
    """
    if importlib.util.find_spec("ray") is None:
        raise ConfigError(
            [
                "launch=ray needs Ray, which is not installed; install rlco[ray], in a "
                "checkout by: uv sync --extra ray"
            ]
        )


def import_ray() -> Any:
    """Return the module ``ray``, with its settings made before it reads them."""
    check_ray()
    for name, value in _SETTINGS.items():
        os.environ.setdefault(name, value)
    import ray

    return ray


def connect(address: str | None, processors: int) -> bool:
    """Connect to a cluster, unless this process is connected already.

    Args:
        address: ``auto``, ``HOST:PORT`` or ``ray://HOST:PORT``; None starts one here,
            without a dashboard, that ends with this process.
        processors: Of the one that is started, however many this machine has: as many
            workers as are asked for start.

    Returns:
        Whether this call connected it; then `disconnect` ends that.

    Raises:
        ConfigError: There is no cluster at the address.
    """
    ray = import_ray()
    if ray.is_initialized():
        return False
    shared = {"log_to_driver": False, "logging_level": logging.ERROR}
    if address is None:
        ray.init(
            address="local",
            num_cpus=processors,
            include_dashboard=False,
            object_store_memory=_STORE,
            **shared,
        )
        return True
    try:
        ray.init(address=address, **shared)
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise ConfigError(
            [
                f"ray_address={address!r} leads to no Ray cluster ({_first(error)}); "
                "start one with `ray start --head`, or leave it out for one of this "
                "machine"
            ]
        ) from error
    return True


def disconnect() -> None:
    """Leave the cluster; one that `connect` started ends."""
    import_ray().shutdown()


def _first(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[0].rstrip(".")[:200] if lines else type(error).__name__
