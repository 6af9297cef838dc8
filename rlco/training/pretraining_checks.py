"""What is asked of an encoder's pretraining, checked before anything starts."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

from rlco.errors import ConfigError, DataError
from rlco.training.options.policy_options import changed

if TYPE_CHECKING:
    from rlco.training.options.stage_one_options import StageOneOptions

log = logging.getLogger("rlco.training")


def check_pretraining(options: StageOneOptions) -> None:
    """Check what the options of pretraining say of each other.

    Raises:
        ConfigError: They contradict each other; every problem is reported.
        UnknownNameError: There is no such domain.
    """
    from rlco.physics.robosuite.options import PREFIX
    from rlco.physics.spec.domain import FINAL_DOMAINS, make_domain

    problems = []
    wanted = {
        "pretrain_scenes": options.pretrain_scenes > 0,
        "position_coeff": options.position_coeff > 0,
        "image_fixed": options.image_fixed,
    }
    given = [name for name, is_wanted in wanted.items() if is_wanted]
    if given and options.image == "none":
        problems.append(f"{given[0]} belongs to images; give image=dense with it")
    if not options.pretrain_scenes:
        problems += [
            f"{given} is of labelled scenes, but pretrain_scenes=0 draws none; give "
            "pretrain_scenes=8000 with it"
            for given in changed(
                options, "pretrain_passes", "pretrain_shift", "pretrain_domain"
            )
        ]
    if options.pretrain_scenes and (
        options.task is None or options.task.startswith(PREFIX)
    ):
        problems.append(
            f"pretrain_scenes={options.pretrain_scenes} needs a task of rlco's or of "
            f"your own with an expert, but task={options.task or 'null'}; give 0"
        )
    if options.image_fixed and not options.pretrain_scenes:
        problems.append(
            "image_fixed=true leaves the encoder as it is drawn at random; give "
            "pretrain_scenes=4000 with it"
        )
    if options.image_fixed and options.position_coeff:
        problems.append(
            f"position_coeff={options.position_coeff} trains the encoder that "
            "image_fixed=true leaves as it is; give one of them"
        )
    if options.image_fixed and options.augment:
        problems.append(
            "augment=true changes images at each draw, but with image_fixed=true they "
            "are read once; give one of them"
        )
    if options.position_coeff and options.alpha == 0:
        problems.append(
            f"position_coeff={options.position_coeff} learns from simulated rows, but "
            "sim_ratio=0 leaves none; give 0"
        )
    if options.pretrain_scenes and (
        make_domain(options.pretrain_domain).name in FINAL_DOMAINS
    ):
        problems.append(
            f"pretrain_domain={options.pretrain_domain} is for final evaluations "
            "alone; give sim, or a domain of your own"
        )
    if problems:
        raise ConfigError(problems)


def say_unlabelled(options: StageOneOptions) -> None:
    """Say so where an encoder for labelled scenes learns from demonstrations alone."""
    # A policy of real demonstrations alone may have no simulator to draw scenes in.
    if options.image == "dense" and not options.pretrain_scenes and options.alpha > 0:
        log.warning(
            "image=dense learns from demonstrations alone, whose images are too few "
            "for it; give pretrain_scenes=8000 image_fixed=true, or image=conv"
        )


def check_positions(options: StageOneOptions, task: Any) -> None:
    """Check that simulated rows say where things are, if that is to be learned.

    Raises:
        DataError: They do not.
    """
    from rlco.lerobot_files import read_folder

    name, folder = "observation.environment_state", options.sim_demos
    if not options.position_coeff or folder is None:
        return
    if task.environment_state_names and name in read_folder(folder).features:
        return
    raise DataError(
        f"position_coeff={options.position_coeff} learns where things are from "
        f"{name!r} of sim_demos={folder!r}, which is not in it (with task=null: not in "
        "all data sets); give data that hold it, as record_demos writes them, or "
        "position_coeff=0."
    )
