"""LeRobot's checkpoint folders: loaded whole, or not at all."""

from __future__ import annotations

import os
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from draccus.utils import ParsingError
from lerobot.configs import PreTrainedConfig
from lerobot.configs.train import TRAIN_CONFIG_NAME, TrainPipelineConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.policies.pi05.configuration_pi05 import PI05Config
from lerobot.policies.pi05.modeling_pi05 import PI05Policy
from lerobot.policies.smolvla.configuration_smolvla import SmolVLAConfig
from lerobot.processor.pipeline import ProcessorMigrationError
from lerobot.utils.import_utils import register_third_party_plugins
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import nn

from rlco.errors import CheckpointError
from rlco.files import reading
from rlco.files.checksums import verify_folder
from rlco.files.reading import check_kind
from rlco.finite import check_loaded
from rlco.policies.vla.foreign_code import no_foreign_code
from rlco.policies.vla.lerobot.flow_model import FlowModel
from rlco.policies.vla.lerobot.inputs import Stats, check_statistics, state_size_of
from rlco.policies.vla.lerobot.pi05 import Pi05Model
from rlco.policies.vla.lerobot.smolvla import SmolVLAModel, build_smolvla
from rlco.policies.vla.lerobot.steps import check_config, check_steps

WEIGHTS = "model.safetensors"
_FILE = "file of weights"


@dataclass
class LeRobotCheckpoint:
    """What a checkpoint folder holds.

    Attributes:
        folder: where it was loaded from.
        model: LeRobot's policy, in the halves that rlco trains it by.
        preprocessor: LeRobot's pipeline from raw observations to the model's input.
        postprocessor: LeRobot's pipeline from the model's actions to raw ones.
        training: LeRobot's configuration of the training behind it, where there is one.
    """

    folder: Path
    model: FlowModel
    preprocessor: Any
    postprocessor: Any
    training: TrainPipelineConfig | None = None

    @property
    def config(self) -> Any:
        """LeRobot's configuration of the policy."""
        return self.model.policy.config


@no_foreign_code()
def load_lerobot(
    folder: str | os.PathLike[str],
    *,
    action_size: int | None = None,
    state_size: int | None = None,
    tokenizer: str | os.PathLike[str] | None = None,
    stats: Stats | None = None,
    device: str | None = None,
    allow_code: Collection[str] = (),
) -> LeRobotCheckpoint:
    """Return the policy and the processors of a checkpoint of pi0.5 or SmolVLA.

    No code of the folder runs, and none that its files name, but LeRobot's own.

    Args:
        folder: LeRobot's ``pretrained_model``, with ``config.json``,
            ``model.safetensors`` and both processors.
        action_size: A, action dimensions of the robot or the task, checked.
        state_size: the same of its state, ``observation.state``.
        tokenizer: folder of the tokenizer, for machines without a network; of SmolVLA,
            the folder of its whole vision-language model's configuration.
        stats: statistics in place of the processors' own, see
            :func:`rlco.policies.vla.lerobot.inputs.dataset_stats`.
        device: where to; by default the checkpoint's own, or what there is.
        allow_code: code of your own that the folder may name: steps of its processors,
            ``"my_module.MyStep"``, and the task of its training's environment,
            ``"my_task:TASK"``. They run, so name what you trust.

    Raises:
        CheckpointError: a file is missing or damaged, or names code that is not
            allowed; the policy is of another type, action size or state size; a weight
            is missing, unknown, of another shape, NaN or infinite; statistics are
            missing; or there is no tokenizer.
    """
    path = Path(folder).resolve()
    config = lerobot_config(path)
    if device is not None:
        config.device = device
    for one in (path, path if tokenizer is None else Path(tokenizer)):
        check_kind(
            *one.glob("*"),
            advice="take it away, or copy the folder again, whole",
            error=CheckpointError,
        )
    allowed = {allow_code} if isinstance(allow_code, str) else {*allow_code}
    check_steps(path, allowed)
    verify_folder(path)
    training = _read_training(path, allowed)
    _check_actions(path, config, action_size)
    if tokenizer is not None and hasattr(config, "vlm_model_name"):
        config.vlm_model_name = str(Path(tokenizer).resolve())
    # The processors first: they are quick, and what is wrong shows in them.
    processors = _load_processors(path, config, tokenizer, stats)
    check_statistics(path, config, processors[0])
    _check_state(path, state_size_of(config, processors[0]), state_size)
    model: FlowModel
    if isinstance(config, SmolVLAConfig):
        model = SmolVLAModel(_build_smolvla(path, config))
    else:
        model = Pi05Model(get_policy_class(config.type)(config))
    _load_weights(model, path / WEIGHTS)
    model.policy.to(config.device).eval()
    return LeRobotCheckpoint(path, model, *processors, training)


@no_foreign_code()
def lerobot_config(folder: str | os.PathLike[str]) -> Any:
    """Return LeRobot's configuration of a checkpoint of pi0.5 or SmolVLA.

    Raises:
        CheckpointError: it is missing, damaged, of another type, or trusts code from
            elsewhere.
    """
    folder = Path(folder).resolve()
    file = folder / "config.json"
    if not file.is_file():
        raise CheckpointError(
            f"{str(folder)!r} has no config.json; give LeRobot's folder "
            "pretrained_model, which lies in checkpoints/LAST of a training run."
        )
    # Types of installed plugins are known only after this.
    register_third_party_plugins()
    try:
        check_config(file)
        config = PreTrainedConfig.from_pretrained(folder)
    except CheckpointError:
        raise
    except (ValueError, ParsingError) as error:
        raise CheckpointError(
            f"{str(file)!r} is not a configuration that LeRobot can read "
            f"({_first_line(error)}); write it anew with LeRobot 0.6, or install "
            "the plugin that has its type."
        ) from error
    if not isinstance(config, PI05Config | SmolVLAConfig):
        raise CheckpointError(
            f"the checkpoint {str(folder)!r} is of the type {config.type!r}, whose "
            "actions have no log-probability (they come from a regression or another "
            "sampler); rlco trains pi05 and smolvla, and OpenVLA by load_openvla."
        )
    config.pretrained_path = folder
    return config


def _read_training(
    folder: Path, allow_code: Collection[str]
) -> TrainPipelineConfig | None:
    """Return LeRobot's configuration of the training behind a checkpoint, if any."""
    file = folder / TRAIN_CONFIG_NAME
    if not file.is_file():
        return None
    try:
        check_config(file, allow_code)
        return TrainPipelineConfig.from_pretrained(folder)
    except CheckpointError:
        raise
    except (ValueError, ParsingError) as error:
        raise CheckpointError(
            f"{str(file)!r} is not a configuration that LeRobot can read "
            f"({_first_line(error)}); take the file away, and lerobot-train will go on "
            "from what is trained here with its defaults."
        ) from error


def _check_actions(folder: Path, config: Any, action_size: int | None) -> None:
    feature = config.action_feature
    if feature is None:
        raise CheckpointError(
            f"the checkpoint {str(folder)!r} has no action feature in its config.json; "
            "fine-tune it on a data set first, as the published bases need."
        )
    size = feature.shape[0]
    if action_size is not None and size != action_size:
        raise CheckpointError(
            f"the checkpoint {str(folder)!r} has {size} action dimensions, the robot "
            f"or the task {action_size}; give a checkpoint that was trained on it."
        )


def _check_state(folder: Path, found: int | None, expected: int | None) -> None:
    if None not in (found, expected) and found != expected:
        raise CheckpointError(
            f"the checkpoint {str(folder)!r} reads {found} state dimensions, the robot "
            f"or the task gives {expected}; give a checkpoint that was trained on it."
        )


def _build_smolvla(folder: Path, config: Any) -> Any:
    try:
        return build_smolvla(config)
    except (OSError, ValueError, ImportError) as error:
        raise CheckpointError(
            f"the vision-language model {config.vlm_model_name!r} of the checkpoint "
            f"{str(folder)!r} cannot be built ({_first_line(error)}); where its "
            "configuration is not on this machine, or has Python of its own, which "
            "never runs, give another folder by tokenizer=FOLDER."
        ) from error


def _load_processors(
    folder: Path,
    config: Any,
    tokenizer: str | os.PathLike[str] | None,
    stats: Stats | None,
) -> tuple[Any, Any]:
    before: dict[str, Any] = {"device_processor": {"device": config.device}}
    after: dict[str, Any] = {}
    if tokenizer is not None:
        name = str(Path(tokenizer).resolve())
        before["tokenizer_processor"] = {"tokenizer_name": name}
    if stats is not None:
        before["normalizer_processor"] = {"stats": stats}
        after["unnormalizer_processor"] = {"stats": stats}
    try:
        processors: tuple[Any, Any] = make_pre_post_processors(
            config,
            pretrained_path=str(folder),
            preprocessor_overrides=before,
            postprocessor_overrides=after,
        )
    except (FileNotFoundError, ProcessorMigrationError, KeyError) as error:
        raise CheckpointError(
            f"the checkpoint {str(folder)!r} lacks a processor ({_first_line(error)}); "
            "write it anew with LeRobot 0.6, which keeps the statistics in the "
            "processors."
        ) from error
    except (OSError, ValueError, TypeError, ImportError, SafetensorError) as error:
        raise CheckpointError(
            f"a processor of the checkpoint {str(folder)!r} cannot be built "
            f"({_first_line(error)}); where it is the tokenizer that is not on this "
            "machine, or has Python of its own, which never runs, give another folder "
            "by tokenizer=FOLDER."
        ) from error
    return processors


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0].rstrip(".") if str(error) else "no reason"


def _load_weights(model: FlowModel, file: Path) -> None:
    """Fill the policy; LeRobot's own loading prints what is missing and goes on."""
    policy = model.policy
    with reading(file, SafetensorError, what=_FILE, error=CheckpointError):
        found = load_file(file)
    ours = policy.state_dict()
    if isinstance(policy, PI05Policy) and found.keys() != ours.keys():
        # Names of openpi's own.
        found = policy._fix_pytorch_state_dict_keys(found, policy.config)
        found = {
            k if k.startswith("model.") else f"model.{k}": v for k, v in found.items()
        }
    problems = [
        f"{name} has shape {tuple(found[name].shape)}, expected {tuple(value.shape)}"
        for name, value in ours.items()
        if name in found and found[name].shape != value.shape
    ]
    needless = _names(policy, model.unused_modules())
    shared = _shared(ours, found)
    problems += [
        f"{name} is missing"
        for name in ours
        if name not in found and name not in shared and name not in needless
    ]
    problems += [f"{name} is not expected" for name in found if name not in ours]
    if problems:
        more = f" (and {len(problems) - 3} more)" if len(problems) > 3 else ""
        raise CheckpointError(
            f"the weights {str(file)!r} are not those of its config.json: "
            f"{'; '.join(problems[:3])}{more}; copy the folder again, whole."
        )
    used = ((name, value) for name, value in found.items() if name not in needless)
    check_loaded(str(file), used, advice="give an earlier one, or copy it again")
    policy.load_state_dict(found, strict=False)


def _shared(ours: dict[str, Any], found: dict[str, Any]) -> set[str]:
    """Return the names whose tensor a found name fills too."""
    filled = {ours[name].data_ptr() for name in found if name in ours}
    return {name for name, value in ours.items() if value.data_ptr() in filled}


def _names(policy: nn.Module, modules: list[nn.Module]) -> set[str]:
    """Return the names of these modules' weights in the policy."""
    wanted = {id(p) for module in modules for p in module.parameters()}
    named = policy.named_parameters(remove_duplicate=False)
    return {name for name, parameter in named if id(parameter) in wanted}
