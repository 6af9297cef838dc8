"""A cluster that starts too slowly is started again, a few times."""

from __future__ import annotations

import logging
import socket
from typing import Any

import pytest

from rlco.errors import ConfigError, LostProcessError
from rlco.runs.ray_cluster import check_ray, connect, import_ray

SLOW = "The current node timed out during startup. This could happen because ..."


class Starts:
    """In place of Ray's own start, which is late or not as machines happen to be."""

    def __init__(self, *ends: str | None) -> None:
        self.ends, self.count = ends, 0

    def __call__(self, **options: Any) -> None:
        end = self.ends[self.count]
        self.count += 1
        if end is not None:
            raise Exception(end)  # as Ray does


def start(monkeypatch: pytest.MonkeyPatch, *ends: str | None) -> Starts:
    starts = Starts(*ends)
    ray = import_ray()
    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray, "init", starts)
    monkeypatch.setattr(ray, "shutdown", lambda: None)
    return starts


def test_a_start_that_took_too_long_is_tried_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    starts = start(monkeypatch, SLOW, SLOW, None)
    with caplog.at_level(logging.WARNING, "rlco.runs"):
        assert connect(None, 2)
    assert starts.count == 3
    assert [one.message.count("tried again") for one in caplog.records] == [1, 1]


def test_a_start_that_is_always_late_ends_with_what_to_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    starts = start(monkeypatch, SLOW, SLOW, SLOW)
    with pytest.raises(LostProcessError, match="`ray start --head`"):
        connect(None, 2)
    assert starts.count == 3


def test_another_failure_is_not_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    starts = start(monkeypatch, "no such device", None)
    with pytest.raises(Exception, match="no such device"):
        connect(None, 2)
    assert starts.count == 1


def test_an_address_at_which_nothing_answers_is_told_at_once() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        check_ray(f"127.0.0.1:{port}")
        check_ray(f"ray://localhost:{port}")
    with pytest.raises(ConfigError, match=r"leads to no Ray cluster \(.*refused"):
        check_ray(f"ray://127.0.0.1:{port}")


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("node7", "is no address of a Ray cluster; give auto, HOST:PORT"),
        ("node7:", "is no address"),
        ("http://node7:6379/", "is no address"),
        ("127.0.0.1:99999", "leads to no Ray cluster"),
    ],
)
def test_what_is_no_address_is_told(address: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        check_ray(address)
