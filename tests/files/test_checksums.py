"""Files of ours: a flipped bit anywhere in them is noticed; those of before load."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from rlco.errors import CheckpointError
from rlco.files.checksums import verify
from rlco.policies import load_policy, make_policy, save_policy
from rlco.runs.state_files import load_state, save_state

STATE = {"w": torch.arange(12.0), "steps": 3, "names": ["a", "checksum"], "x": 0.25}


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    save_state(tmp_path / "state.safetensors", STATE)
    return tmp_path / "state.safetensors"


def test_no_byte_of_a_state_changes_unnoticed(saved: Path) -> None:
    whole = saved.read_bytes()
    for place in range(len(whole)):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << place % 8
        saved.write_bytes(flipped)
        with pytest.raises(CheckpointError, match=r"damaged|not written by this vers"):
            load_state(saved)


def test_a_state_cut_off_anywhere_is_no_state(saved: Path) -> None:
    whole = saved.read_bytes()
    for size in range(0, len(whole), 7):
        saved.write_bytes(whole[:size])
        with pytest.raises(CheckpointError, match="damaged"):
            load_state(saved)


def test_flipped_weights_of_a_policy_are_not_loaded(tmp_path: Path) -> None:
    save_policy(make_policy("gaussian", state_size=3, chunk=2, hidden=[4]), tmp_path)
    file = tmp_path / "policy.safetensors"
    whole = file.read_bytes()
    for place in range(len(whole) - 128, len(whole)):  # of weights: a number changes
        flipped = bytearray(whole)
        flipped[place] ^= 1
        file.write_bytes(flipped)
        with pytest.raises(CheckpointError, match="does not match its checksum"):
            load_policy(tmp_path)
    file.write_bytes(whole)
    load_policy(tmp_path)


def test_a_changed_description_of_a_policy_is_not_loaded(tmp_path: Path) -> None:
    save_policy(make_policy("gaussian", state_size=3, chunk=2, hidden=[4]), tmp_path)
    file = tmp_path / "policy.json"
    text = file.read_text()
    for old, new in (
        ('"chunk": 2', '"chunk": 3'),
        ('"rlco"', '"rlcp"'),
        ('"checksum": "', '"checksum": "0'),
        ('"checksum"', '"chacksum"'),
    ):
        assert text.count(old) == 1
        file.write_text(text.replace(old, new))
        with pytest.raises(CheckpointError, match=r"policy\.json"):
            load_policy(tmp_path)
    file.write_text(text.replace("\n", "").replace(" ", ""))  # its layout is free
    load_policy(tmp_path)


def test_files_of_before_have_no_checksum_and_are_read(saved: Path) -> None:
    with safe_open(saved, framework="pt") as file:
        metadata = dict(file.metadata())
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    assert metadata.pop("checksum")
    save_file(tensors, saved, metadata=metadata)
    loaded = load_state(saved)
    assert torch.equal(loaded.pop("w"), STATE["w"])
    assert loaded == {k: v for k, v in STATE.items() if k != "w"}


def test_a_policy_of_before_is_read(tmp_path: Path) -> None:
    policy = make_policy("gaussian", state_size=3, chunk=2)
    save_policy(policy, tmp_path)
    save_file(policy.state_dict(), tmp_path / "policy.safetensors")
    loaded, _ = load_policy(tmp_path)
    for name, value in policy.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], value)


@pytest.mark.parametrize(
    "structure",
    ["", "3", "[1]", '["dict", 5]', '["tensor", "9"]', '["?", "0"]', "[" * 5000],
)
def test_a_structure_that_is_none(tmp_path: Path, structure: str) -> None:
    """Crafted, so the checksum is right or missing."""
    file = tmp_path / "state.safetensors"
    metadata = {"format": "rlco-state-1", "structure": structure}
    save_file({"0": torch.ones(1)}, file, metadata=metadata)
    if structure == "3":
        assert load_state(file) == 3  # a number is a state
        return
    with pytest.raises(CheckpointError, match="damaged"):
        load_state(file)


def test_a_header_that_declares_more_than_any(tmp_path: Path) -> None:
    file = tmp_path / "state.safetensors"
    file.write_bytes((2**62).to_bytes(8, "little") + b"{}")
    with pytest.raises(CheckpointError, match="damaged"):
        verify(file)
