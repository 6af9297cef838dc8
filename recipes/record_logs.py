"""Record logs of a simulated arm to practise find_gap on, and the arm's known model.

    uv run recipes/record_logs.py domain=robot.yaml out=logs model=arm.xml
    uv run recipes/find_gap.py model=arm.xml data=logs out=gap_report

The arm of a task moves freely in `domain`. Its logs hold joint positions and torques;
`model` is the arm as `known` has it, without what `domain` adds. With a robot at hand,
log its own motion instead.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

from rlco.run import run_recipe
from rlco.runs.config import LAST_SEED, REQUIRED, option
from rlco.training.options.limits import LONGEST_RECORDING, MOST_RECORDINGS

log = logging.getLogger("rlco.record_logs")


@dataclass
class Config:
    """Options of record_logs.py."""

    out: str = option(REQUIRED, "new folder for the recordings")
    model: str | None = option(
        None, "MJCF file to write the known model into; null: none"
    )
    task: str = option("push_cube", "name of the task whose arm moves")
    domain: str = option(
        "stand_in",
        "where it moves: sim, stand_in, MODULE:NAME, or the path of an effects.yaml",
    )
    known: str = option("sim", "the domain that the model has")
    recordings: int = option(
        6, "recordings of the arm", minimum=2, maximum=MOST_RECORDINGS
    )
    seconds: float = option(
        10.0, "length of a recording [s]", minimum=4, maximum=LONGEST_RECORDING
    )
    seed: int = option(
        0, "seed of postures, motions and noise", minimum=0, maximum=LAST_SEED
    )
    effects_code: str | None = option(
        None, "Python file that registers effects of your own"
    )


def main(config: Config) -> None:
    """Record, then say what was recorded."""
    from rlco.errors import ConfigError
    from rlco.files import shown
    from rlco.gap.practice_arm import record_arm, write_known_model
    from rlco.physics.effects import load_code
    from rlco.physics.spec.domain import make_domain
    from rlco.runs.whole_files import check_new_file

    load_code(config.effects_code)
    known = make_domain(config.known)
    if config.model is not None:
        check_new_file(Path(config.model), "model")
        if Path(config.out).absolute().is_relative_to(Path(config.model).absolute()):
            raise ConfigError(
                [
                    f"model={shown(config.model)} and out={shown(config.out)} would be "
                    "a file and a folder of one name; give another model=FILE"
                ]
            )
    record_arm(
        config.out,
        config.task,
        config.domain,
        recordings=config.recordings,
        seconds=config.seconds,
        seed=config.seed,
    )
    log.info(
        "recorded %d times %g s of the arm of %s in %s: %s",
        config.recordings,
        config.seconds,
        config.task,
        config.domain,
        config.out,
    )
    if config.model is not None:
        write_known_model(config.model, config.task, known)
        log.info("the model as %s has it: %s", config.known, config.model)


if __name__ == "__main__":
    run_recipe(main, Config)
