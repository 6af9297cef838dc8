"""State files: nested state as one safetensors file, nothing pickled.

The tensors and arrays lie in the file as safetensors; the nesting around them and
all plain values lie in its header as JSON. A file is written beside its place,
then renamed, so a file that exists is whole.
"""

from __future__ import annotations

import json
import os
import random
import re
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from rlco.errors import CheckpointError
from rlco.files import reading, shown
from rlco.files.checksums import KEY, UNKNOWN, seal, verify
from rlco.runs.whole_files import put_in_place

_FORMAT = "rlco-state-1"
_TAGS = ("dict", "list", "tuple", "tensor", "array", "scalar")
_METADATA = {"format", "structure", KEY}
#: A GPU's random state: seed and offset, 8 bytes each.
_CUDA_STATE = (16,)


def save_state(path: str | Path, state: Any) -> None:
    """Write nested state, whole or not at all.

    Args:
        path: The file; an existing one is replaced.
        state: Dicts (keys: text, numbers), lists and tuples of tensors, NumPy
            arrays, numbers, text, flags and None. Tensors are stored from the CPU.

    Raises:
        TypeError: Something else is in it; its place is named.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "state.safetensors"
        >>> save_state(file, {"w": torch.ones(2), "steps": (1, 2.5, None)})
        >>> load_state(file)
        {'w': tensor([1., 1.]), 'steps': (1, 2.5, None)}
    """
    path = Path(path)
    tensors: dict[str, Tensor] = {}
    structure = json.dumps(_encode(state, tensors, "state"))
    save_tensors(path, tensors, {"format": _FORMAT, "structure": structure})


def save_tensors(
    path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]
) -> None:
    """Write a safetensors file with a checksum, whole or not at all.

    Args:
        path: The file; an existing one is replaced.
        tensors: On the CPU, contiguous, none in another's memory.
        metadata: Texts in its header.
    """
    part = path.with_name(f".{path.name}.part")
    part.touch()  # what the system says of it, safetensors does not pass on
    try:
        save_file(dict(tensors), part, metadata={**metadata, KEY: UNKNOWN})
    except SafetensorError as error:
        number = re.search(r"os error (\d+)", str(error))
        if number is None:
            raise
        code = int(number[1])
        raise OSError(code, os.strerror(code), str(part)) from error
    seal(part)
    put_in_place(part, path)


def load_state(path: str | Path) -> Any:
    """Read what :func:`save_state` wrote, with equal types and values, on the CPU.

    Raises:
        CheckpointError: The file is missing, cut off, of another kind, or not what was
            written: its checksum differs.
    """
    if not Path(path).is_file():
        raise CheckpointError(f"checkpoint {str(path)!r} does not exist.")
    verify(Path(path))
    with _reading(path), safe_open(path, framework="pt") as file:
        metadata = file.metadata() or {}
        names = file.keys()
        tensors = {name: file.get_tensor(name) for name in names}
    if metadata.get("format") != _FORMAT or not set(metadata) <= _METADATA:
        raise CheckpointError(
            f"checkpoint {str(path)!r} was not written by this version of rlco "
            f"(format {metadata.get('format')!r}, expected {_FORMAT!r})."
        )
    with _reading(path):
        return _decode(json.loads(metadata["structure"]), tensors)


def _reading(path: str | Path) -> AbstractContextManager[None]:
    return reading(
        path,
        SafetensorError,
        what="checkpoint",
        advice="give one that rlco wrote",
        error=CheckpointError,
    )


def rng_state() -> dict[str, Any]:
    """Return the state of Python's, NumPy's and torch's global random numbers."""
    return {
        "python": random.getstate(),
        "numpy": np.random.get_state(legacy=False),
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state_all(),
    }


def set_rng_state(state: Mapping[str, Any]) -> None:
    """Put the global random numbers back to where :func:`rng_state` saw them."""
    random.setstate(state["python"])
    np.random.set_state(state["numpy"])
    torch.set_rng_state(state["torch"])
    torch.cuda.set_rng_state_all(state["cuda"][: torch.cuda.device_count()])


def check_rng_state(path: str | Path, state: Any) -> None:
    """Check that :func:`set_rng_state` can take a state; no random number changes.

    Args:
        path: The checkpoint that holds it, for messages.
        state: What stands where :func:`rng_state` returned it.

    Raises:
        CheckpointError: It is no state of random numbers.
    """
    with reading(
        path,
        what="random state of checkpoint",
        advice="take the file away to resume from the one before, if there is one",
        error=CheckpointError,
    ):
        random.Random().setstate(state["python"])
        numpy_state = np.random.RandomState()
        numpy_state.set_state(state["numpy"])
        position = numpy_state.get_state(legacy=False)["state"]["pos"]
        if not 0 <= position <= len(state["numpy"]["state"]["key"]):
            # NumPy takes it, and reads beyond its table then.
            raise ValueError(f"position {position} of NumPy's random numbers")
        torch.Generator().set_state(state["torch"])
        if not isinstance(state["cuda"], list):
            raise TypeError(f"{shown(state['cuda'])} as the GPUs' states")
        for one in state["cuda"]:
            if one.dtype != torch.uint8 or one.shape != _CUDA_STATE:
                raise ValueError(f"{one.dtype} {tuple(one.shape)} as a GPU's state")


def seed_everything(seed: int) -> None:
    """Seed Python's, NumPy's and torch's global random numbers, on every device.

    Example:
        >>> seed_everything(3)
        >>> first = torch.rand(2), np.random.rand(), random.random()
        >>> seed_everything(3)
        >>> torch.equal(first[0], torch.rand(2)), first[2] == random.random()
        (True, True)
    """
    random.seed(seed)
    np.random.seed(seed % 2**32)
    torch.manual_seed(seed)


def _encode(value: Any, tensors: dict[str, Tensor], where: str) -> Any:
    """Turn state into JSON; what is not a plain value becomes [tag, content]."""
    # Exactly these types: a subclass would come back as something else.
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, Mapping):
        return [
            "dict",
            [
                [_encode_key(k, where), _encode(v, tensors, f"{where}[{k!r}]")]
                for k, v in value.items()
            ],
        ]
    if isinstance(value, list | tuple):
        items = [_encode(v, tensors, f"{where}[{i}]") for i, v in enumerate(value)]
        return ["list" if isinstance(value, list) else "tuple", items]
    tag = {Tensor: "tensor", nn.Parameter: "tensor", np.ndarray: "array"}.get(
        type(value)
    )
    if tag is None and isinstance(value, np.generic):
        tag, value = "scalar", np.asarray(value)
    if tag is None:
        raise TypeError(f"{where} is a {type(value).__name__}: cannot be saved")
    name = str(len(tensors))
    tensor = value if tag == "tensor" else torch.from_numpy(np.array(value))
    # A clone of its own: safetensors refuses tensors that share memory.
    tensors[name] = tensor.detach().cpu().contiguous().clone()
    return [tag, name]


def _encode_key(key: Any, where: str) -> Any:
    if type(key) not in (bool, int, float, str):
        raise TypeError(f"{where} has the key {key!r}: only text and numbers can be")
    return key


def _decode(value: Any, tensors: Mapping[str, Tensor]) -> Any:
    if not isinstance(value, list):
        return value
    tag, content = value
    if tag not in _TAGS:
        raise ValueError(f"unknown tag {tag!r}")
    if tag == "dict":
        return {key: _decode(item, tensors) for key, item in content}
    if tag in ("list", "tuple"):
        items = [_decode(item, tensors) for item in content]
        return items if tag == "list" else tuple(items)
    if tag == "tensor":
        return tensors[content]
    array = tensors[content].numpy()
    return array if tag == "array" else array[()]
