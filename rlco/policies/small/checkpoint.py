"""Policies in two files: weights as safetensors, the rest as JSON; no pickle."""

from __future__ import annotations

import importlib.metadata
import os
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import nn

from rlco.errors import CheckpointError, RlcoError
from rlco.files import read_json, reading, shown
from rlco.files.checksums import KEY, content_checksum, verify
from rlco.files.reading import FOREIGN, reason
from rlco.finite import check_loaded, check_saved
from rlco.policies.small.chunk_policy import ChunkPolicy
from rlco.policies.small.observation_check import check_observations
from rlco.policies.small.registry import make_policy
from rlco.runs.state_files import save_tensors
from rlco.runs.whole_files import write_json

WEIGHTS = "policy.safetensors"
DESCRIPTION = "policy.json"
_FIELDS = ("kind", "arguments", "rlco", "extra")
#: What building raises where arguments are of any type and size.
_UNBUILT: tuple[type[Exception], ...] = (RlcoError, *FOREIGN)
#: Numbers in a description that are no sizes of weights, such as draws, are below it.
_MOST_OTHERS = 10**6


def save_policy(
    policy: ChunkPolicy,
    folder: str | os.PathLike[str],
    *,
    extra: dict[str, Any] | None = None,
) -> None:
    """Write a policy to ``folder``, which is made where it does not exist.

    Each file appears whole or not at all, also where the process is killed.

    Args:
        policy: what to save; its normalisation is among its buffers.
        folder: where to.
        extra: what else a user of the policy must know (task, instructions, state
            names), in types that JSON holds.

    Raises:
        NonFiniteError: a weight is NaN or infinite; what is in the folder stays.

    Example:
        >>> import tempfile
        >>> policy = make_policy("gaussian", state_size=3, chunk=4)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     save_policy(policy, folder, extra={"task": "push_cube"})
        ...     loaded, extra = load_policy(folder)
        >>> extra["task"], loaded.arguments == policy.arguments
        ('push_cube', True)
    """
    path = Path(folder)
    check_saved(f"the policy {str(path)!r}", policy.state_dict().items())
    path.mkdir(parents=True, exist_ok=True)
    description = {
        "kind": policy.kind,
        "arguments": policy.arguments,
        "rlco": importlib.metadata.version("rlco"),
        "extra": extra or {},
    }
    description[KEY] = content_checksum(description)
    weights = {
        name: tensor.detach().cpu().contiguous()
        for name, tensor in policy.state_dict().items()
    }
    save_tensors(path / WEIGHTS, weights, {})
    write_json(path / DESCRIPTION, description)


def load_policy(
    folder: str | os.PathLike[str],
) -> tuple[ChunkPolicy, dict[str, Any]]:
    """Return the policy in ``folder``, and the ``extra`` that was saved with it.

    Called with an observation it refuses NaN and infinity, and warns of numbers far
    from those of its training data, see `rlco.policies.check_observations`.

    Raises:
        CheckpointError: a file is missing or damaged, the two do not belong together,
            or a weight is NaN or infinite.
    """
    policy, extra = load_unchecked(folder)
    names = {
        name: extra.get(f"{name}_names") or ()
        for name in ("state", "environment_state")
    }
    check_observations(policy, names)
    return policy, extra


def load_unchecked(
    folder: str | os.PathLike[str],
) -> tuple[ChunkPolicy, dict[str, Any]]:
    """Load as `load_policy` does; the policy does not look at its observations.

    For training and evaluation in a simulator, which check whole rollouts.
    """
    path = Path(folder)
    description = _read_description(path / DESCRIPTION)
    weights = _read_weights(path / WEIGHTS)
    _check_sizes(description["arguments"], weights, path)
    # Without memory first: a description of a few bytes may ask for any of it.
    with torch.device("meta"):
        outline = _build(description, path)
    _check_architecture(outline, weights, path / WEIGHTS)
    policy = _build(description, path)
    _fill(policy, weights, path / WEIGHTS)
    extra: dict[str, Any] = description["extra"]
    return policy, extra


def load_weights(policy: nn.Module, folder: str | os.PathLike[str]) -> None:
    """Copy the weights in ``folder`` into ``policy``, which keeps its own dtype.

    Raises:
        CheckpointError: the file is missing, damaged, not what was written (its
            checksum differs), of another architecture, or holds NaN or infinity; the
            policy is then as it was.
    """
    path = Path(folder) / WEIGHTS
    _fill(policy, _read_weights(path), path)


def _read_weights(path: Path) -> dict[str, torch.Tensor]:
    advice = f"give the folder of a saved policy, with {WEIGHTS} and {DESCRIPTION}"
    with reading(
        path,
        SafetensorError,
        what="file of weights",
        advice=advice,
        error=CheckpointError,
    ):
        found = load_file(path)
    verify(path)
    return found


def _check_sizes(
    arguments: dict[str, Any], weights: dict[str, torch.Tensor], folder: Path
) -> None:
    """Refuse sizes beyond the weights, of which even an outline would be too large."""
    count = max(_MOST_OTHERS, sum(value.numel() for value in weights.values()))
    for name, value in arguments.items():
        most = len(weights) if name == "layers" else count
        if isinstance(value, int) and value > most:
            raise CheckpointError(
                f"{name!r} of {str(folder / DESCRIPTION)!r} is {shown(value)}, and "
                f"{WEIGHTS} beside it has weights for at most {most}; copy the folder "
                "again, both files."
            )


def _build(description: dict[str, Any], folder: Path) -> ChunkPolicy:
    try:
        policy: ChunkPolicy = make_policy(
            description["kind"], **description["arguments"]
        )
    except _UNBUILT as error:
        said = str(error) if isinstance(error, RlcoError) else reason(error)
        raise CheckpointError(
            f"{folder / DESCRIPTION} describes no policy that rlco "
            f"{importlib.metadata.version('rlco')} can build (it was written by rlco "
            f"{description['rlco']}): {said}"
        ) from error
    return policy


def _fill(policy: nn.Module, weights: dict[str, torch.Tensor], path: Path) -> None:
    _check_architecture(policy, weights, path)
    check_loaded(str(path), weights.items())
    policy.load_state_dict(weights)


def _check_architecture(
    policy: nn.Module, weights: dict[str, torch.Tensor], path: Path
) -> None:
    differences = _differences(policy.state_dict(), weights)
    if differences:
        more = f" (and {len(differences) - 3} more)" if len(differences) > 3 else ""
        raise CheckpointError(
            f"{str(path)!r} is of another architecture: "
            f"{'; '.join(differences[:3])}{more}; load it with the options that it was "
            "trained with."
        )


def _read_description(path: Path) -> dict[str, Any]:
    fields = read_json(
        path,
        advice=f"give the folder of a saved policy, with {WEIGHTS} and {DESCRIPTION}"
        f"{_nearby(path.parent)}",
        error=CheckpointError,
    )
    found = set(fields.content)
    if not set(_FIELDS) <= found <= {*_FIELDS, KEY}:
        raise CheckpointError(
            f"{str(path)!r} is not a description of a policy; it must hold "
            f"{', '.join(_FIELDS)}, and nothing else but a {KEY}."
        )
    # Those from before have none.
    if fields.text(KEY, None) not in (None, content_checksum(fields.content)):
        raise CheckpointError(
            f"{str(path)!r} does not match its checksum, so something changed it after "
            f"it was written; copy it again, or take its {KEY!r} out if you changed it."
        )
    return {
        "kind": fields.text("kind"),
        "arguments": fields.mapping("arguments"),
        "rlco": fields.text("rlco"),
        "extra": fields.mapping("extra"),
    }


def _nearby(folder: Path) -> str:
    """Name the policies that were meant by a run's folder, or by one of their files."""
    if folder.is_file():
        found = [folder.parent / DESCRIPTION]
    else:
        found = []
        for depth in ("*", "*/*", "*/*/*"):
            found += sorted(folder.glob(f"{depth}/{DESCRIPTION}"))
    shown = [repr(str(file.parent)) for file in found if file.is_file()]
    return f", such as {' or '.join(shown[:3])}" if shown else ""


def _differences(
    expected: dict[str, torch.Tensor], found: dict[str, torch.Tensor]
) -> list[str]:
    """Say in which entries two sets of weights differ, in the policy's order."""
    differences = []
    for name in [*expected, *sorted(found.keys() - expected.keys())]:
        if name not in found:
            differences.append(f"{name} is missing")
        elif name not in expected:
            differences.append(f"{name} is not expected")
        elif expected[name].shape != found[name].shape:
            differences.append(
                f"{name} has shape {tuple(found[name].shape)}, expected "
                f"{tuple(expected[name].shape)}"
            )
    return differences
