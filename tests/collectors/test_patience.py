"""An environment that hangs is told, and one that is only slow is left alone."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator

import pytest
from tensordict import TensorDictBase
from test_rollouts import make_collector

from rlco.collectors import patience
from rlco.collectors.patience import impatient


class Told(logging.Handler):
    """Keeps what is told, and lets go of what waits for it."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []
        self.heard = threading.Event()

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(record.getMessage())
        self.heard.set()


@pytest.fixture
def told() -> Iterator[Told]:
    handler = Told()
    patience.log.addHandler(handler)
    yield handler
    patience.log.removeHandler(handler)


def test_an_environment_that_hangs_is_told(
    monkeypatch: pytest.MonkeyPatch, told: Told
) -> None:
    monkeypatch.setattr(patience, "PATIENCE", 0.05)
    collector, env, _ = make_collector()
    step = env._step

    def hang(tensordict: TensorDictBase) -> TensorDictBase:
        assert told.heard.wait(60.0)  # told from a thread, while it hangs
        return step(tensordict)

    monkeypatch.setattr(env, "_step", hang)
    collector.collect(7)
    (text,) = told.texts
    assert text.startswith("rollout 7: no decision has ended for 0.05 s")


def test_what_goes_on_is_not_told(monkeypatch: pytest.MonkeyPatch, told: Told) -> None:
    monkeypatch.setattr(patience, "PATIENCE", 0.01)
    asked = threading.Event()
    count = 0

    def counted() -> int:
        nonlocal count
        count += 1  # it rises each time it is looked at
        if count == 5:
            asked.set()
        return count

    with impatient(counted, "rollout 1"):
        assert asked.wait(10.0)
    assert "patience" not in {thread.name for thread in threading.enumerate()}
    assert told.texts == []
