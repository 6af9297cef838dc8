"""State files: what goes in comes out, and what cannot says so."""

from __future__ import annotations

import random
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from rlco.errors import CheckpointError
from rlco.runs.state_files import (
    load_state,
    rng_state,
    save_state,
    seed_everything,
    set_rng_state,
)

PLAIN = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False)
NESTED = st.recursive(
    PLAIN | st.text(),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.lists(inner, max_size=3).map(tuple)
        | st.dictionaries(st.text() | st.integers(), inner, max_size=3)
    ),
    max_leaves=8,
)


def same(a: Any, b: Any) -> bool:
    """Equal in value and type all the way down: True is not 1 here."""
    if type(a) is not type(b):
        return False
    if isinstance(a, dict):
        return list(a) == list(b) and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return a == b


@settings(max_examples=40, deadline=None)
@given(state=NESTED)
def test_nested_plain_values_come_back_with_their_types(state: Any) -> None:
    with TemporaryDirectory() as folder:
        save_state(f"{folder}/s.safetensors", state)
        assert same(load_state(f"{folder}/s.safetensors"), state)


@pytest.mark.parametrize(
    "dtype", [torch.bool, torch.uint8, torch.int64, torch.bfloat16, torch.float64]
)
def test_tensors_come_back_with_dtype_and_shape(dtype: torch.dtype, tmp_path) -> None:
    tensor = torch.arange(6).to(dtype).reshape(3, 2)
    # Views of one memory, one of them not contiguous; and nothing at all.
    state = [tensor, tensor[0], tensor.T, tensor[0, 1], torch.empty(0, dtype=dtype)]
    save_state(tmp_path / "s", state)
    for saved, back in zip(state, load_state(tmp_path / "s"), strict=True):
        assert back.dtype == dtype
        assert back.shape == saved.shape
        assert torch.equal(back, saved)


def test_arrays_come_back_as_arrays_and_scalars_as_scalars(tmp_path: Path) -> None:
    state = {"key": np.arange(3, dtype=np.uint32), "x": np.float32(0.1)}
    save_state(tmp_path / "s", state)
    back = load_state(tmp_path / "s")
    assert back["key"].dtype == np.uint32
    assert back["key"].tolist() == [0, 1, 2]
    assert type(back["x"]) is np.float32
    assert back["x"] == np.float32(0.1)


def test_optimiser_continues_as_if_never_saved(tmp_path: Path) -> None:
    def make() -> tuple[nn.Linear, torch.optim.Adam]:
        seed_everything(1)
        layer = nn.Linear(2, 1)
        return layer, torch.optim.Adam(layer.parameters(), lr=0.1)

    def update(layer: nn.Linear, optimiser: torch.optim.Adam) -> None:
        optimiser.zero_grad()
        layer(torch.ones(1, 2)).square().sum().backward()
        optimiser.step()

    straight, optimiser = make()
    update(straight, optimiser)
    save_state(tmp_path / "s", [straight.state_dict(), optimiser.state_dict()])
    update(straight, optimiser)

    resumed, optimiser = make()
    weights, moments = load_state(tmp_path / "s")
    resumed.load_state_dict(weights)
    optimiser.load_state_dict(moments)
    update(resumed, optimiser)
    assert torch.equal(resumed.weight, straight.weight)


def test_random_numbers_continue_where_they_were(tmp_path: Path) -> None:
    def draw() -> list[float]:
        # A normal leaves NumPy's second, cached normal in its state.
        return [random.random(), np.random.normal(), float(torch.randn(()))]

    seed_everything(0)
    draw()
    save_state(tmp_path / "s", rng_state())
    expected = draw()
    seed_everything(9)
    set_rng_state(load_state(tmp_path / "s"))
    assert draw() == expected


def test_what_cannot_be_saved_is_named_and_the_old_file_stays(tmp_path: Path) -> None:
    save_state(tmp_path / "s", {"a": 1})
    with pytest.raises(TypeError, match=r"state\['a'\]\[1\] is a set"):
        save_state(tmp_path / "s", {"a": [0, {1}]})
    with pytest.raises(TypeError, match=r"state has the key \(1, 2\)"):
        save_state(tmp_path / "s", {(1, 2): 0})
    assert load_state(tmp_path / "s") == {"a": 1}


def test_missing_cut_and_foreign_files_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with pytest.raises(CheckpointError, match="does not exist"):
        load_state(path)
    save_state(path, {"w": torch.zeros(100)})
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(CheckpointError, match="is damaged"):
        load_state(path)
    from safetensors.torch import save_file

    save_file({"w": torch.zeros(1)}, path)
    with pytest.raises(CheckpointError, match="not written by this version"):
        load_state(path)
