"""Trained LeRobot policies, written as LeRobot's own checkpoints."""

from __future__ import annotations

import copy
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from lerobot.common.train_utils import save_checkpoint, update_last_checkpoint
from lerobot.configs.default import DatasetConfig, JobConfig, WandBConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.optim.optimizers import AdamWConfig

from rlco.errors import CheckpointError
from rlco.files.checksums import seal_folder
from rlco.finite import check_loaded, check_saved, named_tensors
from rlco.policies.vla.lerobot.checkpoint import LeRobotCheckpoint
from rlco.policies.vla.lora import has_lora, merged_state, without_lora
from rlco.runs.state_files import load_state, save_state
from rlco.runs.whole_files import sync_folder, sync_tree

#: Beside ``pretrained_model``: what LeRobot has no place for.
BESIDE = "rlco_state"


def save_lerobot(
    checkpoint: LeRobotCheckpoint,
    folder: str | os.PathLike[str],
    *,
    step: int,
    data: str | os.PathLike[str] | None = None,
    rename: Mapping[str, str] | None = None,
    optimizer: torch.optim.Optimizer | None = None,
    beside: Mapping[str, Any] | None = None,
) -> Path:
    """Write a checkpoint that ``lerobot-eval`` runs and ``lerobot-train`` resumes.

    LeRobot itself writes it: its configuration, whose type stays what it was, the
    weights with adapters merged in, the processors with the statistics that the policy
    was trained with, and the training's state. ``model.safetensors`` holds nothing
    else. A checkpoint that is there is whole: it is written beside its place, then
    renamed.

    Args:
        checkpoint: what was loaded, trained since.
        folder: of the run; the checkpoint goes into ``checkpoints/STEP`` below it.
        step: updates done.
        data: the data set that ``lerobot-train --resume`` goes on with, a local
            folder; None: the one of the checkpoint, if it names one.
        rename: what the policy calls entries of ``data``, where it calls them
            otherwise, for example ``{"observation.images.top":
            "observation.images.front"}``.
        optimizer: AdamW over ``policy.parameters()``, for resuming; None: a fresh one.
        beside: what else resuming needs (critic, noise, adapters), by name; each goes
            into a file of its own in ``rlco_state``.

    Returns:
        The folder ``pretrained_model``, for ``--policy.path``.

    Raises:
        CheckpointError: the folder holds a checkpoint of this step already.
        NonFiniteError: something is NaN or infinite; nothing is written.
    """
    policy = checkpoint.model.policy
    _check_finite(checkpoint, optimizer, beside or {}, step)
    config = _train_config(checkpoint, Path(folder), step, data, rename)
    if optimizer is not None:
        config.optimizer = _adamw(optimizer, config.optimizer.grad_clip_norm)
    target = Path(folder) / "checkpoints" / f"{step:06d}"
    if target.exists():
        raise CheckpointError(
            f"{str(target)!r} exists and is not overwritten; give another folder."
        )
    # With adapters, what was optimised is not what is written.
    if optimizer is None or has_lora(policy):
        optimizer = config.optimizer.build(without_lora(policy))
    state = merged_state(policy) if has_lora(policy) else None
    for left in target.parent.glob("*.partial"):  # by a save that was interrupted
        shutil.rmtree(left)
    partial = target.with_name(f"{target.name}.partial")
    save_checkpoint(
        partial,
        step,
        config,
        policy,
        optimizer,
        preprocessor=checkpoint.preprocessor,
        postprocessor=checkpoint.postprocessor,
        num_processes=1,
        batch_size=config.batch_size,
        model_state_dict=state,
    )
    seal_folder(partial / "pretrained_model")
    (partial / BESIDE).mkdir()
    for name, value in (beside or {}).items():
        save_state(partial / BESIDE / f"{name}.safetensors", value)
    sync_tree(partial)
    partial.rename(target)
    sync_folder(target.parent)
    update_last_checkpoint(target)
    return target / "pretrained_model"


def _check_finite(
    checkpoint: LeRobotCheckpoint,
    optimizer: torch.optim.Optimizer | None,
    beside: Mapping[str, Any],
    step: int,
) -> None:
    """Check what training can have spoiled; the rest was checked when it was loaded."""
    policy = checkpoint.model.policy
    # These need not have come from a file: they hold whatever memory held.
    unused = checkpoint.model.unused_modules()
    left_out = {id(weights) for part in unused for weights in part.parameters()}
    trained = {
        name: weights
        for name, weights in policy.named_parameters()
        if weights.requires_grad and id(weights) not in left_out
    }
    state = {
        "policy": trained | dict(policy.named_buffers()),
        "optimizer": {} if optimizer is None else optimizer.state_dict()["state"],
        **beside,
    }
    check_saved(f"the checkpoint of iteration {step}", named_tensors(state))


def _adamw(optimizer: torch.optim.Optimizer, grad_clip_norm: float) -> AdamWConfig:
    """Return the configuration of the optimiser whose state is written."""
    options = {name: optimizer.defaults[name] for name in ("lr", "eps", "weight_decay")}
    betas = tuple(optimizer.defaults["betas"])
    return AdamWConfig(**options, betas=betas, grad_clip_norm=grad_clip_norm)


def load_beside(folder: str | os.PathLike[str], name: str) -> Any | None:
    """Return what :func:`save_lerobot` wrote beside a ``pretrained_model``, or None.

    Raises:
        CheckpointError: it is damaged, or holds NaN or infinity.
    """
    path = Path(folder).resolve().parent / BESIDE / f"{name}.safetensors"
    if not path.is_file():
        return None
    state = load_state(path)
    check_loaded(str(path), named_tensors(state))
    return state


def _train_config(
    checkpoint: LeRobotCheckpoint,
    folder: Path,
    step: int,
    data: str | os.PathLike[str] | None,
    rename: Mapping[str, str] | None,
) -> TrainPipelineConfig:
    """Return the configuration that ``--resume`` reads."""
    policy = copy.copy(checkpoint.config)
    if checkpoint.training is not None:
        config = copy.deepcopy(checkpoint.training)
        config.policy = policy
    else:
        config = TrainPipelineConfig(
            dataset=DatasetConfig(repo_id="local/none"), policy=policy
        )
    if data is not None:
        root = Path(data).resolve()
        config.dataset = DatasetConfig(repo_id=f"local/{root.name}", root=str(root))
        config.rename_map = dict(rename or {})
        # What these name is of the other data set.
        config.eval_steps, config.sample_weighting = 0, None
    config.output_dir = folder.resolve()
    config.steps = max(config.steps, step)
    if config.optimizer is None:
        preset = policy.get_optimizer_preset()
        config.optimizer = preset if isinstance(preset, AdamWConfig) else AdamWConfig()
    # The schedule's own state would be of another training. Without one LeRobot insists
    # on its presets; of a resumed training it takes none.
    config.scheduler = None
    config.use_policy_training_preset = True
    # Nor may it go on in another run's log or repository.
    config.wandb, config.job = WandBConfig(), JobConfig()
    config.save_checkpoint_to_hub = policy.push_to_hub = False
    config.resume = False
    return config
