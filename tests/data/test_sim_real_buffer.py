"""The mix of sim and real: exact ratio, exact passes, exact resuming."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from torchrl.data import (
    LazyMemmapStorage,
    LazyTensorStorage,
    ReplayBuffer,
    SamplerWithoutReplacement,
    TensorDictReplayBuffer,
)

from rlco.data import SimRealReplayBuffer
from rlco.errors import CheckpointError, ConfigError


def rows(start: int, n: int) -> TensorDict:
    """Rows numbered from ``start``; sim and real keep different keys and shapes."""
    ids = torch.arange(start, start + n)
    if start >= 1000:
        return TensorDict({"id": ids, "chunk": ids[:, None].expand(n, 3).float()}, [n])
    return TensorDict({"id": ids, "advantage": ids[:, None].float()}, [n])


def member(start: int, n: int, **options: Any) -> ReplayBuffer:
    options.setdefault("storage", LazyTensorStorage(max(n, 1)))
    buffer = TensorDictReplayBuffer(**options)
    if n:
        buffer.extend(rows(start, n))
    return buffer


def mixed(
    n_sim: int = 100, n_real: int = 30, *, seed: int = 0, **options: Any
) -> SimRealReplayBuffer:
    sampler = SamplerWithoutReplacement()
    return SimRealReplayBuffer(
        member(0, n_sim, sampler=sampler),
        member(1000, n_real),
        generator=torch.Generator().manual_seed(seed),
        **({"sim_ratio": 0.7, "batch_size": 16} | options),
    )


def ids(batch: TensorDict) -> tuple[list[int], list[int]]:
    return batch["sim", "id"].tolist(), batch["real", "id"].tolist()


@settings(max_examples=25, deadline=None)
@given(
    ratio=st.fractions("1/20", "19/20", max_denominator=20),
    batch_sizes=st.lists(st.integers(20, 70), min_size=1, max_size=12),
)
def test_sampled_share_is_exact_for_any_batches(ratio: Any, batch_sizes: Any) -> None:
    buffer = mixed(sim_ratio=float(ratio), batch_size=20)
    n_sim = n_real = 0
    for batch_size in batch_sizes:
        batch = buffer.sample(batch_size)
        assert batch.batch_size == ()
        assert len(batch["sim"]) + len(batch["real"]) == batch_size
        n_sim, n_real = n_sim + len(batch["sim"]), n_real + len(batch["real"])
    assert n_sim == int(ratio * sum(batch_sizes))


def test_roots_keep_their_own_keys_and_rows() -> None:
    batch = mixed().sample()
    # 0.7 * 16 = 11.2: 11 rows of sim, 5 of real.
    assert batch["sim"].batch_size == (11,)
    assert batch["real"].batch_size == (5,)
    assert "advantage" in batch["sim"]
    assert "chunk" in batch["real"]
    assert (batch["sim", "id"] < 1000).all()
    assert (batch["real", "id"] >= 1000).all()


@settings(max_examples=25, deadline=None)
@given(
    n_sim=st.integers(1, 150),
    ratio=st.sampled_from([0.1, 0.25, 0.5, 0.7, 0.8, 0.95]),
    batch_size=st.integers(20, 64),
)
def test_a_pass_shows_each_sim_row_once(
    n_sim: int, ratio: float, batch_size: int
) -> None:
    buffer = mixed(n_sim, sim_ratio=ratio, batch_size=batch_size)
    buffer.sample()  # A pass starts anew wherever sampling stands.
    for _ in range(2):
        batches = list(buffer)
        seen = [i for batch in batches for i in batch["sim", "id"].tolist()]
        assert sorted(seen) == list(range(n_sim))
        for batch in batches[:-1]:
            assert len(batch["sim"]) + len(batch["real"]) == batch_size
        last = batches[-1]
        assert 1 <= len(last["sim"]) + len(last["real"]) <= batch_size
        assert len(last["real"]) >= 1


def test_pass_with_256_sim_and_64_real_rows_a_minibatch() -> None:
    buffer = mixed(600, 30, sim_ratio=0.8, batch_size=320)
    sizes = [(len(b["sim"]), len(b["real"])) for b in buffer]
    # 600 = 256 + 256 + 88, and 88 sim rows go with 88 / 0.8 - 88 = 22 real ones.
    assert sizes == [(256, 64), (256, 64), (88, 22)]


def test_share_stays_exact_over_passes_with_short_batches() -> None:
    buffer = mixed(10, sim_ratio=0.7, batch_size=4)
    n_sim = n_real = 0
    for _ in range(70):
        for batch in buffer:
            n_sim, n_real = n_sim + len(batch["sim"]), n_real + len(batch["real"])
    assert n_sim == 700
    # 700 sim rows go with 300 real ones; less than one row is carried.
    assert n_real in (300, 301)


def test_passes_differ_in_order_and_real_rows_are_fresh() -> None:
    buffer = mixed(64, sim_ratio=0.5, batch_size=32)
    first, second = list(buffer), list(buffer)
    assert [ids(b)[0] for b in first] != [ids(b)[0] for b in second]
    real = [tuple(ids(b)[1]) for b in first + second]
    assert len(set(real)) == len(real)


def test_refilling_sim_each_iteration() -> None:
    buffer = mixed(40, sim_ratio=0.5, batch_size=20)
    list(buffer)
    buffer.empty()
    assert len(buffer) == 30
    with pytest.raises(ConfigError, match="no sim rows to pass over"):
        next(iter(buffer))
    with pytest.raises(ConfigError, match="the sim buffer is empty"):
        buffer.sample()
    rollout = rows(500, 40)
    buffer.extend(rollout)
    assert set(rollout.keys()) == {"id", "advantage"}  # Not written to.
    seen = [i for batch in buffer for i in ids(batch)[0]]
    assert sorted(seen) == list(range(500, 540))


def test_refilling_during_a_pass_is_noticed() -> None:
    buffer = mixed(40, sim_ratio=0.5, batch_size=20)
    batches = iter(buffer)
    next(batches)
    buffer.empty()
    with pytest.raises(RuntimeError, match="refilled during a pass"):
        next(batches)


def test_samplers_that_end_a_pass_early_still_give_all_rows() -> None:
    """At the end of 10 rows, SamplerWithoutReplacement gives 1 where 3 are wanted."""
    buffer = mixed(10, sim_ratio=0.5, batch_size=6)
    drawn = [ids(buffer.sample())[0] for _ in range(10)]
    assert all(len(batch) == 3 for batch in drawn)
    # 30 draws without replacement are exactly three passes over 10 rows.
    flat = [i for batch in drawn for i in batch]
    for start in (0, 10, 20):
        assert sorted(flat[start : start + 10]) == list(range(10))


def test_ratio_zero_and_one_leave_a_root_out() -> None:
    real_only = SimRealReplayBuffer(None, member(1000, 5), sim_ratio=0, batch_size=4)
    batch = real_only.sample()
    assert list(batch.keys()) == ["real"]
    assert len(batch["real"]) == 4
    with pytest.raises(ConfigError, match="no sim rows"):
        next(iter(real_only))
    with pytest.raises(ConfigError, match="built without sim"):
        real_only.extend(rows(0, 3))
    sim_only = SimRealReplayBuffer(member(0, 7), None, sim_ratio=1, batch_size=4)
    assert list(sim_only.sample().keys()) == ["sim"]
    assert [len(batch["sim"]) for batch in sim_only] == [4, 3]


def test_memory_map_equals_memory(tmp_path: Path) -> None:
    def build(storage: type, **options: Any) -> SimRealReplayBuffer:
        sim = member(0, 50, storage=storage(50, **options.get("sim", {})))
        real = member(1000, 30, storage=storage(30, **options.get("real", {})))
        generator = torch.Generator().manual_seed(3)
        return SimRealReplayBuffer(
            sim, real, sim_ratio=0.6, batch_size=10, generator=generator
        )

    in_memory = build(LazyTensorStorage)
    mapped = build(
        LazyMemmapStorage,
        sim={"scratch_dir": str(tmp_path / "sim")},
        real={"scratch_dir": str(tmp_path / "real")},
    )
    assert [ids(in_memory.sample()) for _ in range(5)] == [
        ids(mapped.sample()) for _ in range(5)
    ]
    assert [ids(batch) for batch in in_memory] == [ids(batch) for batch in mapped]


def future(buffer: SimRealReplayBuffer) -> list[tuple[list[int], list[int]]]:
    """What the buffer gives from now on: samples, passes, and a refilled pass."""
    given = [ids(buffer.sample()) for _ in range(3)]
    given += [ids(batch) for batch in buffer]
    buffer.empty()
    buffer.extend(rows(200, 50))
    return given + [ids(batch) for batch in buffer] + [ids(buffer.sample())]


def test_same_seed_same_batches_and_other_seed_others() -> None:
    assert future(mixed(seed=4)) == future(mixed(seed=4))
    assert future(mixed(seed=4)) != future(mixed(seed=5))
    buffer = mixed(seed=5)
    buffer.sample()
    buffer.empty()
    buffer.extend(rows(0, 100))
    buffer.seed(4)
    assert future(buffer) == future(mixed(seed=4))


def test_torchs_seed_decides_where_no_generator_is_given() -> None:
    def build() -> SimRealReplayBuffer:
        torch.manual_seed(1)
        sim, real = member(0, 50), member(1000, 50)
        return SimRealReplayBuffer(sim, real, sim_ratio=0.5, batch_size=10)

    assert future(build()) == future(build())


@pytest.mark.parametrize("way", ["state_dict", "state_dict without rows", "dumps"])
def test_resumed_buffer_equals_an_uninterrupted_one(way: str, tmp_path: Path) -> None:
    buffer = mixed(seed=1)
    for _ in range(3):
        buffer.sample()
    list(buffer)
    buffer.sample()  # Leaves a remainder and a half-used sampler behind.
    # Other draws before loading, and other rows where those are saved too.
    with_rows = way != "state_dict without rows"
    resumed = mixed(seed=99)
    if with_rows:
        resumed = mixed(100, 30, seed=99)
        resumed.sim["id"].zero_()
    resumed.sample()
    if way == "dumps":
        buffer.dumps(tmp_path / "saved")
        resumed.loads(tmp_path / "saved")
    else:
        stream = io.BytesIO()
        torch.save(buffer.state_dict(rows=with_rows), stream)
        stream.seek(0)
        resumed.load_state_dict(torch.load(stream, weights_only=True))
    assert future(resumed) == future(buffer)


def test_state_of_another_mix_is_refused(tmp_path: Path) -> None:
    state = mixed(sim_ratio=0.5).state_dict()
    with pytest.raises(CheckpointError, match=r"by sim_ratio=1/2, this one .* by 7/10"):
        mixed().load_state_dict(state)
    mixed(sim_ratio=0.5).dumps(tmp_path / "saved")
    with pytest.raises(CheckpointError, match="build it as the saved one"):
        mixed().loads(tmp_path / "saved")
    with pytest.raises(CheckpointError, match="holds no sim-real buffer"):
        mixed().loads(tmp_path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sim_ratio": 1.2}, r"sim_ratio=1.2, but a share lies in \[0, 1\]"),
        ({"sim_ratio": float("nan")}, "sim_ratio=nan"),
        ({"sim_ratio": 0.9, "batch_size": 9}, "at least 10 rows are needed"),
        ({"sim_ratio": 0.05, "batch_size": 19}, "at least 20 rows are needed"),
        ({"sim_ratio": 1.0, "batch_size": 0}, "at least 1 rows"),
    ],
)
def test_options_that_cannot_be(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        mixed(**options)


def test_members_that_cannot_be_mixed() -> None:
    stacked = TensorDictReplayBuffer(storage=LazyTensorStorage(10, ndim=2))
    with pytest.raises(ConfigError) as error:
        SimRealReplayBuffer(stacked, None, sim_ratio=0.5, batch_size=1)
    needed, small, flat = error.value.problems
    assert "needs real, which is None" in needed
    assert "too small" in small
    assert "ndim=1" in flat
    prefetching = member(1000, 5, batch_size=4, prefetch=1)
    buffer = SimRealReplayBuffer(None, prefetching, sim_ratio=0, batch_size=4)
    buffer.sample()
    with (
        pytest.warns(UserWarning, match="conflicting batch_sizes"),
        pytest.raises(ConfigError, match="2 rows more than asked for"),
    ):
        buffer.sample(2)
    with pytest.raises(ConfigError, match="too small"):
        mixed().sample(2)
