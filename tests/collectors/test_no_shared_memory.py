"""A container without /dev/shm: worlds are stepped in threads, of one memory."""

from __future__ import annotations

import _posixshmem
import multiprocessing.synchronize
from typing import Any

import pytest
import torch
from test_rollouts import make_collector


def test_no_shared_memory_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(_posixshmem, "shm_open", refuse)
    monkeypatch.setattr(torch.UntypedStorage, "share_memory_", refuse)
    monkeypatch.setattr(multiprocessing.synchronize.SemLock, "__init__", refuse)
    collector, *_ = make_collector(threads=2)
    assert collector.collect(0)["next", "reward"].isfinite().all()
    with pytest.raises(OSError, match="not implemented"):
        multiprocessing.Lock()
