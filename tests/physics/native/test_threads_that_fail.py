"""What raises in a thread that steps reaches whoever called, when all have ended."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import pytest

from rlco.physics.native.worlds import Worlds


def test_an_exception_in_one_thread_is_raised_when_the_others_have_ended() -> None:
    worlds: Any = SimpleNamespace(_pool=ThreadPoolExecutor(2), threads=2)
    raised, stepped = threading.Event(), []

    def kernel(first: int, last: int) -> None:
        if first == 0:
            raised.set()
            raise ZeroDivisionError("in world 0")
        raised.wait()
        stepped.extend(range(first, last))

    with pytest.raises(ZeroDivisionError, match="in world 0"):
        Worlds.run_over(worlds, kernel, 8)
    assert sorted(stepped) == list(range(1, 8))  # none is stepped behind our back
    stepped.clear()
    Worlds.run_over(worlds, lambda first, last: stepped.extend((first, last)), 8)
    assert len(stepped) == 16  # the threads are there for the next step
