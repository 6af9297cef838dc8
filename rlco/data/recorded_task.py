"""What data sets say of the task that they were recorded in, where none is given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from rlco.errors import DataError
from rlco.lerobot_files import LeRobotFolder, check_stored_sizes

_STATE = "observation.state"
_ENVIRONMENT_STATE = "observation.environment_state"
_ACTION = "action"


@dataclass(frozen=True)
class RecordedTask:
    """A robot and its task as data sets describe them; no simulator knows it.

    Attributes:
        name: What policies are filed under.
        instructions: Every instruction of the data.
        control_frequency: Frames a second [1/s].
        state_names: One name a number of the state.
        environment_state_names: The same for the environment's state.
        action_names: The same for the action, which has no limits: it is in whatever
            unit the robot takes.
    """

    name: ClassVar[str] = "recorded"
    action_limit: ClassVar[float | None] = None
    instructions: tuple[str, ...]
    control_frequency: float
    state_names: tuple[str, ...]
    environment_state_names: tuple[str, ...]
    action_names: tuple[str, ...]

    def description(self) -> dict[str, Any]:
        """Return what a policy's user must know of it, in types of JSON."""
        return {
            "task": None,
            "instructions": list(self.instructions),
            "control_frequency": self.control_frequency,
            "state_names": list(self.state_names),
            "environment_state_names": list(self.environment_state_names),
            "action_names": list(self.action_names),
        }


def recorded_task(folders: Mapping[str, LeRobotFolder]) -> RecordedTask:
    """Return the task of data sets that are to be trained on together.

    Args:
        folders: What `read_folder` returned, by the name of the option that gave it.

    Raises:
        DataError: A feature is missing, or two data sets are of different robots:
            other numbers of states or actions, or another rate.
    """
    option, first = next(iter(folders.items()))
    used = [_STATE, _ACTION]
    if all(_ENVIRONMENT_STATE in folder.features for folder in folders.values()):
        used.append(_ENVIRONMENT_STATE)
    for other, folder in folders.items():
        compared = {"frames per second": (first.fps, folder.fps)}
        for name in used:
            sizes = first.feature(name).size, folder.feature(name).size
            compared[f"numbers in {name!r}"] = sizes
        for what, (one, two) in compared.items():
            if one != two:
                raise DataError(
                    f"{option} has {one:g} {what} and {other} has {two:g}; train on "
                    "one of them alone, or give data sets of the same robot."
                )
    for folder in folders.values():
        check_stored_sizes(folder, used)
    texts = [text for f in folders.values() for _, text in sorted(f.tasks.items())]
    poses = _names(first, _ENVIRONMENT_STATE) if _ENVIRONMENT_STATE in used else ()
    return RecordedTask(
        instructions=tuple(dict.fromkeys(texts)),
        control_frequency=first.fps,
        state_names=_names(first, _STATE),
        environment_state_names=poses,
        action_names=_names(first, _ACTION),
    )


def _names(folder: LeRobotFolder, name: str) -> tuple[str, ...]:
    """Return the names of a feature's numbers, or count them where it gives none."""
    feature = folder.feature(name)
    return feature.names or tuple(f"{name}.{i}" for i in range(feature.size))
