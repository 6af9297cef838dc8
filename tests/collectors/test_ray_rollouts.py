"""Rollouts over Ray: the episodes that one process plays, whatever becomes of it."""

from __future__ import annotations

import logging
import os
import signal
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch

from rlco.collectors import RolloutCollector, patience, ray_rollouts
from rlco.collectors.ray_rollouts import RayWorkers
from rlco.envs import make_env
from rlco.errors import ConfigError, NonFiniteError
from rlco.losses import log_probs
from rlco.policies import GaussianPolicy, ValueNetwork
from rlco.runs.ray_cluster import connect
from rlco.training.distributed.ranks import Ranks

pytestmark = pytest.mark.slow

SIZES: dict[str, Any] = {
    "environment_state_size": 12,
    "num_instructions": 3,
    "hidden": (8,),
}
ENV = partial(make_env, "push_cube", chunk=4, horizon=8, seed=3)
POSE = ("observation", "environment_state")


def collector(num_envs: int, **options: Any) -> RolloutCollector:
    torch.manual_seed(0)
    policy, critic = GaussianPolicy(7, chunk=4, **SIZES), ValueNetwork(7, **SIZES)
    return RolloutCollector(ENV(num_envs=num_envs), policy, critic, **options)


@pytest.fixture(scope="module")
def remote(ray_cluster: None) -> Iterator[RolloutCollector]:
    workers = RayWorkers(2, partial(ENV, num_envs=2), seed=7)
    found = collector(2, workers=workers)
    yield found
    found.close()


def workers_of(remote: RolloutCollector) -> list[Any]:
    rollouts: Any = remote._rollouts
    found: list[Any] = rollouts._collector.remote_collectors
    return found


def test_two_workers_play_the_episodes_of_one_process(remote: RolloutCollector) -> None:
    local = collector(4)
    played, here = remote.collect(1), local.collect(1)
    assert played.shape == here.shape == (4, 2)
    assert remote.frames == local.frames == 32
    torch.testing.assert_close(played[POSE][:, 0], here[POSE][:, 0])
    entries = {str(key) for key in here.keys(True, True) if "collector" not in str(key)}
    assert entries <= {str(key) for key in played.keys(True, True)}
    # Normalised over both workers, as over one process.
    assert played["advantage"].mean().abs() < 1e-5
    # Each explores by itself.
    assert not torch.equal(played["action"][:2], played["action"][2:])


def test_workers_act_by_the_weights_of_now(remote: RolloutCollector) -> None:
    policy: Any = remote._rollouts._policy  # type: ignore[attr-defined]
    before = remote.collect(2)
    with torch.no_grad():
        for weights in policy.parameters():
            weights.add_(0.1)
    after = remote.collect(2)
    assert not torch.equal(before["action"], after["action"])
    gap = log_probs(policy, after) - after["vla_action", "log_probs"]
    assert gap.abs().max() < 1e-4


@pytest.mark.thorough
def test_a_killed_worker_is_started_again_and_its_rollout_is_the_same(
    remote: RolloutCollector, caplog: pytest.LogCaptureFixture
) -> None:
    import ray

    expected = remote.collect(3)
    ended = workers_of(remote)[1]
    process = ray.get(ended.__ray_call__.remote(lambda worker: os.getpid()))
    os.kill(process, signal.SIGKILL)
    again = remote.collect(3)
    assert torch.equal(again["action"], expected["action"])
    (record,) = caplog.records
    assert "a worker has ended" in record.message
    assert "rollout 3 is played again" in record.message


def test_a_worker_that_hangs_is_reported_with_its_process(
    remote: RolloutCollector,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    tmp_path: Path,
) -> None:
    import ray

    expected = remote.collect(6)
    reported = tmp_path / "reported"

    def hang(worker: Any) -> int:
        env = worker.env.base_env
        step = env._step

        def until_reported(tensordict: Any) -> Any:
            for _ in range(3000):  # half a minute, should nobody report it
                if reported.exists():
                    break
                time.sleep(0.01)
            return step(tensordict)

        env._step = until_reported
        return os.getpid()

    class Heard(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            reported.touch()

    process = ray.get(workers_of(remote)[1].__ray_call__.remote(hang))
    monkeypatch.setattr(patience, "PATIENCE", 0.1)
    monkeypatch.setattr(ray_rollouts, "_SLOWER", 0)
    handler = Heard()
    patience.log.addHandler(handler)
    try:
        again = remote.collect(6)
    finally:
        patience.log.removeHandler(handler)
    (record,) = caplog.records
    assert f"rollout 6: not ended after 0.1 s by worker 1 (process {process} on" in (
        record.message
    )
    assert "worker 0" not in record.message
    assert torch.equal(again["action"], expected["action"])


def test_what_is_not_finite_in_a_worker_is_said_as_in_this_process(
    remote: RolloutCollector,
) -> None:
    import ray

    def break_it(worker: Any) -> None:
        worker.env.base_env._seen = lambda: {
            "state": torch.full((2, 7), torch.nan),
            "environment_state": torch.zeros(2, 12),
        }

    ray.get(workers_of(remote)[0].__ray_call__.remote(break_it))
    with pytest.raises(NonFiniteError, match="2 of 2 environments, first in") as caught:
        remote.collect(4)
    assert "rollout 4" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_more_workers_than_processors_are_refused_not_waited_for(
    ray_cluster: None,
) -> None:
    workers = RayWorkers(1000, partial(ENV, num_envs=2), seed=7)
    with pytest.raises(ConfigError, match=r"each of 1000 workers takes one"):
        collector(2, workers=workers)


def test_ranks_play_other_episodes_that_one_would_play_alone() -> None:
    alone = collector(4).collect(5)
    parts = []
    for rank in range(2):
        one = collector(2, ranks=Ranks(rank, 2), advantage="mc", group_size=2)
        one.env.start_in_groups(1)
        parts.append(one.collect(5)[POSE][:, 0])
    torch.testing.assert_close(torch.cat(parts), alone[POSE][:, 0])


def test_an_address_without_a_cluster_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import ray

    def fail(**given: Any) -> None:
        raise ConnectionError("Could not find any running Ray instance. Start one.")

    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray, "init", fail)
    with pytest.raises(ConfigError, match="'auto' leads to no Ray cluster") as caught:
        connect("auto", 2)
    assert "ray start --head" in str(caught.value)
