"""OpenVLA's checkpoint folders, read and written under the published names."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from huggingface_hub.errors import StrictDataclassError
from safetensors import SafetensorError, safe_open
from transformers import initialization

from rlco.errors import CheckpointError
from rlco.files import reading
from rlco.files.checksums import verify
from rlco.files.reading import reason
from rlco.finite import check_loaded, check_saved
from rlco.policies.vla.foreign_code import no_foreign_code
from rlco.policies.vla.lora import merged_state
from rlco.policies.vla.openvla.config import read_config
from rlco.policies.vla.openvla.model import OpenVLA
from rlco.policies.vla.openvla.weight_names import (
    is_unused,
    to_native,
    to_published,
    vision_table,
)
from rlco.runs.state_files import save_tensors

_LANGUAGE = "language_model."
#: What OpenVLA's fine-tuning with regression leaves beside the weights.
_L1_HEAD = "action_head--*"
#: What transformers raises over sizes that are none. A full memory is no fault of them.
_UNBUILT = (
    *(ArithmeticError, AttributeError, ImportError, LookupError, TypeError, ValueError),
    StrictDataclassError,
)
_ADVICE = "give an earlier one, or copy it again"
_WEIGHTS = (".safetensors", ".bin", ".index.json")


@no_foreign_code()
def load_openvla(
    folder: str | os.PathLike[str],
    *,
    dtype: torch.dtype = torch.bfloat16,
    device: torch.device | str = "cpu",
) -> OpenVLA:
    """Return the model of a folder such as openvla-7b's, every weight from its files.

    The Python that is published beside the weights is never read.

    Args:
        folder: ``config.json`` and ``*.safetensors``, as published or as written by
            :func:`save_openvla`.
        dtype: of the weights.
        device: where to.

    Raises:
        CheckpointError: a file is missing or damaged; a weight is missing, unknown, of
            another shape, NaN or infinite; or the checkpoint was trained with a
            regression head, so that its language model never learned to predict action
            tokens.
    """
    path = Path(folder)
    config = read_config(path)
    refuse_l1_head(path)
    kept = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        # Every weight is about to be overwritten, or reported.
        with initialization.no_init_weights(), torch.device(device):
            model = OpenVLA(config)
    except _UNBUILT as error:
        raise CheckpointError(
            f"the sizes in {str(path / 'config.json')!r} make no model that rlco can "
            f"build ({reason(error)}); give a folder that has OpenVLA's own."
        ) from error
    finally:
        torch.set_default_dtype(kept)
    _fill(model, path)
    return model


def refuse_l1_head(folder: Path) -> None:
    """Refuse a checkpoint whose actions came from a regression head.

    Raises:
        CheckpointError: there is such a head in the folder.
    """
    heads = sorted(file.name for file in folder.glob(_L1_HEAD))
    if heads:
        raise CheckpointError(
            f"{str(folder)!r} was trained with a regression head ({heads[0]}) instead "
            "of action tokens: log-probabilities of tokens, and sampling them, would "
            "mean nothing; give a checkpoint that was trained on tokens, or train this "
            "one on them first and leave the head out of the folder."
        )


def _fill(model: OpenVLA, folder: Path) -> None:
    """Copy every published weight into the model, file by file."""
    table = vision_table(model.config)
    ours = dict(model.state_dict())
    problems, filled = [], set()
    with torch.no_grad():
        for name, value in _published(folder):
            if name.startswith(_LANGUAGE):
                parts = {name: value}
            elif name in table:
                parts = to_native(table[name], value)
            elif is_unused(name, model.config):
                continue
            else:
                parts = {name: value}
            check_loaded(str(folder), [(name, value)], advice=_ADVICE)
            for native, part in parts.items():
                if native not in ours:
                    problems.append(f"{name} is not expected")
                elif ours[native].shape != part.shape:
                    problems.append(
                        f"{name} has shape {tuple(part.shape)}, expected "
                        f"{tuple(ours[native].shape)}"
                    )
                else:
                    ours[native].copy_(part)
                    filled.add(native)
        # Masks belong to DINOv2's own training.
        mask = "dinov2.embeddings.mask_token"
        ours[mask].zero_()
        filled.add(mask)
    problems += [f"{name} is missing" for name in ours if name not in filled]
    if problems:
        more = f" (and {len(problems) - 3} more)" if len(problems) > 3 else ""
        raise CheckpointError(
            f"the weights in {str(folder)!r} are not those of its config.json: "
            f"{'; '.join(problems[:3])}{more}; copy the folder again, whole."
        )


def _published(folder: Path) -> Iterator[tuple[str, torch.Tensor]]:
    files = sorted(folder.glob("*.safetensors"))
    if not files:
        raise CheckpointError(
            f"{str(folder)!r} holds no *.safetensors file; give a folder that holds "
            "OpenVLA's config.json and its weights."
        )
    for file in files:
        verify(file)
        with (
            reading(
                file, SafetensorError, what="file of weights", error=CheckpointError
            ),
            safe_open(file, framework="pt") as weights,
        ):
            for name in weights.keys():  # noqa: SIM118 (it is no mapping)
                yield name, weights.get_tensor(name)


def save_openvla(
    model: OpenVLA,
    folder: str | os.PathLike[str],
    *,
    base: str | os.PathLike[str],
    norm_stats: Mapping[str, Any] | None = None,
) -> None:
    """Write a model's weights under their published names, beside ``base``'s files.

    What OpenVLA publishes but never computes with is copied from ``base``, so that the
    original code can load the folder too.

    Args:
        model: adapters are merged into what is written, not into the model.
        folder: where to; made where it does not exist.
        base: the folder that the model was loaded from: its configuration, statistics
            and tokenizer are kept.
        norm_stats: statistics to add, ``{name: {"action": {"q01": ..., "q99": ...}}}``.

    Raises:
        NonFiniteError: a trained weight is NaN or infinite; nothing is written.
    """
    source, target = Path(base), Path(folder)
    trained = ((k, p) for k, p in model.named_parameters() if p.requires_grad)
    check_saved(f"the model {str(target)!r}", trained)
    target.mkdir(parents=True, exist_ok=True)
    for file in source.iterdir():
        if file.is_file() and not file.name.endswith(_WEIGHTS):
            shutil.copy(file, target / file.name)
    config = json.loads((target / "config.json").read_text("utf-8"))
    config["norm_stats"] = {**(config.get("norm_stats") or {}), **(norm_stats or {})}
    (target / "config.json").write_text(json.dumps(config, indent=2) + "\n", "utf-8")
    weights = {k: v.detach().cpu() for k, v in merged_state(model).items()}
    published = {
        name: to_published(entry, weights).contiguous()
        for name, entry in vision_table(model.config).items()
    }
    published |= {
        k: v.contiguous() for k, v in weights.items() if k.startswith(_LANGUAGE)
    }
    for name, value in _published(source):
        if is_unused(name, model.config):
            published[name] = value
    save_tensors(target / "model.safetensors", published, {"format": "pt"})
