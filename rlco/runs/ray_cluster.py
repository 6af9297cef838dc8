"""A Ray cluster: one of this machine alone, or one that is there."""

from __future__ import annotations

import importlib.util
import logging
import os
import re
import socket
from typing import Any

from rlco.errors import ConfigError, LostProcessError
from rlco.files import shown

log = logging.getLogger("rlco.runs")

#: Ray's uv hook may start workers on another Python; nobody is told of a run; and a
#: worker is as nice as the process that started its cluster, not by 15 more.
_SETTINGS = {
    "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0",
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_worker_niceness": "0",
}
#: Of a local cluster, for rollouts on their way and for weights [bytes].
_STORE = 512 * 2**20
_ATTEMPTS = 3
_ADDRESS = re.compile(r"(ray://)?\[?(?P<host>[^\[\]/]+?)\]?:(?P<port>\d{1,9})")
_PATIENCE = 10.0  # until something answers there [s]
#: What Ray says of a start that took too long.
_SLOW = "timed out during startup"


def check_ray(address: str | None = None) -> None:
    """Check that Ray is installed, and that something answers where a cluster should.

    Args:
        address: As `connect` takes it.

    Raises:
        ConfigError: It is not, or nothing does.
    """
    if importlib.util.find_spec("ray") is None:
        raise ConfigError(
            [
                "launch=ray needs Ray, which is not installed; install rlco[ray], in a "
                "checkout by: uv sync --extra ray"
            ]
        )
    if address in (None, "auto"):
        return
    place = _ADDRESS.fullmatch(address or "")
    if place is None:
        raise ConfigError(
            [
                f"ray_address={shown(address)} is no address of a Ray cluster; give "
                "auto, HOST:PORT or ray://HOST:PORT"
            ]
        )
    try:
        # Ray itself waits for minutes, and prints lines of its own.
        socket.create_connection((place["host"], int(place["port"])), _PATIENCE).close()
    except (OSError, OverflowError) as error:  # a port beyond the last one
        raise _no_cluster(address, error) from error


def _no_cluster(address: str | None, error: Exception) -> ConfigError:
    return ConfigError(
        [
            f"ray_address={shown(address)} leads to no Ray cluster ({_first(error)}); "
            "start one with `ray start --head`, or leave it out for one of this machine"
        ]
    )


def import_ray() -> Any:
    """Return the module ``ray``, with its settings made before it reads them."""
    check_ray()
    for name, value in _SETTINGS.items():
        os.environ.setdefault(name, value)
    import ray
    from ray._private import ray_constants

    # TorchRL has imported Ray before, which reads this variable as it is imported.
    ray_constants.RAY_ENABLE_UV_RUN_RUNTIME_ENV = False
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
        LostProcessError: The cluster's own processes did not start in time, though it
            was tried three times.
    """
    ray = import_ray()
    if ray.is_initialized():
        return False
    shared = {"log_to_driver": False, "logging_level": logging.ERROR}
    if address is None:
        _start(num_cpus=processors, **shared)
        return True
    try:
        ray.init(address=address, **shared)
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise _no_cluster(address, error) from error
    return True


def _start(**options: Any) -> None:
    """Start a cluster here, again where one of its processes was too slow.

    Ray gives each 15 s and cannot be told to wait longer. Its first start on a machine
    compiles a thousand modules meanwhile, the second finds them compiled.
    """
    ray = import_ray()
    for attempt in range(_ATTEMPTS):
        try:
            ray.init(
                address="local",
                include_dashboard=False,
                object_store_memory=_STORE,
                **options,
            )
        except Exception as error:  # Ray's own class of this one
            if _SLOW not in str(error):
                raise
            ray.shutdown()
            if attempt == _ATTEMPTS - 1:
                raise LostProcessError(
                    f"Ray did not start in {_ATTEMPTS} attempts ({_first(error)}); "
                    "this machine has too much else to do: try again when it has less, "
                    "or start a cluster with `ray start --head` and give "
                    "ray_address=auto."
                ) from error
            log.warning("Ray did not start in time; it is tried again")
        else:
            return


def disconnect() -> None:
    """Leave the cluster; one that `connect` started ends."""
    import_ray().shutdown()


def _first(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[0].rstrip(".")[:200] if lines else type(error).__name__
