"""Two processes that learn together, started once for all tests of a module."""

from __future__ import annotations

import multiprocessing
import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
import torch.multiprocessing as mp

Found = list[dict[str, Any]]


def in_two_ranks(
    work: Callable[..., dict[str, Any]], folder: Path, *given: Any, groups: int = 1
) -> Found:
    """Run a function in two processes, as torchrun starts them; return what each gives.

    Args:
        work: Of a module, so that another process can import it.
        folder: For what the processes return.
        *given: Its arguments.
        groups: How often the processes connect with each other, see `next_group`.
    """
    free = [socket.socket() for _ in range(groups)]
    for one in free:
        one.bind(("127.0.0.1", 0))
    ports = [one.getsockname()[1] for one in free]
    for one in free:
        one.close()
    # Processes that are copied from one that has imported everything start at once.
    multiprocessing.set_forkserver_preload(["rlco.training.learner", work.__module__])
    mp.start_processes(
        _one, (work, given, ports, folder), nprocs=2, start_method="forkserver"
    )
    return [torch.load(folder / f"{rank}.pt", weights_only=False) for rank in range(2)]


def _one(
    rank: int,
    work: Callable[..., dict[str, Any]],
    given: tuple[Any, ...],
    ports: list[int],
    folder: Path,
) -> None:
    os.environ |= {
        "TORCHELASTIC_RUN_ID": "test",
        "RANK": str(rank),
        "WORLD_SIZE": "2",
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORTS": " ".join(map(str, ports)),
        "GLOO_SOCKET_IFNAME": "lo",
    }
    next_group()
    torch.set_num_threads(1)
    torch.save(work(*given), folder / f"{rank}.pt")


def next_group() -> None:
    """Let the processes meet at a port of their own when they connect again."""
    first, *others = os.environ["MASTER_PORTS"].split()
    os.environ |= {"MASTER_PORT": first, "MASTER_PORTS": " ".join(others)}
