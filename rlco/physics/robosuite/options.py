"""Options of robosuite's own environments, checked before one is built."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.robosuite.robosuite_api import (
    ROBOT_CLASS_MAPPING,
    TwoArmEnv,
    robosuite,
)

PREFIX = "robosuite:"
# Options that rlco sets itself.
FIXED: dict[str, Any] = {
    "has_renderer": False,
    "has_offscreen_renderer": False,
    "use_camera_obs": False,
    "hard_reset": False,
    "ignore_done": True,
    "renderer": "mujoco",
}
DEFAULTS: dict[str, Any] = {"robots": "Panda"}


def environment_class(name: str) -> Any:
    """Return robosuite's class of that name.

    Raises:
        UnknownNameError: If robosuite has no such environment.

    Example:
        >>> environment_class("Lift").__name__
        'Lift'
    """
    known = sorted(robosuite.ALL_ENVIRONMENTS)
    if name not in known:
        raise UnknownNameError("robosuite environment", name, known)
    return robosuite.environments.REGISTERED_ENVS[name]


def option_names(kind: type) -> tuple[str, ...]:
    """Return the keyword arguments of an environment's constructor.

    Where it accepts arbitrary ones, those of its base classes are included.
    """
    names: list[str] = []
    for base in kind.__mro__:
        if "__init__" not in vars(base):
            continue
        parameters = list(inspect.signature(base).parameters.values())
        names += [p.name for p in parameters if p.kind not in _COLLECTING]
        if not any(p.kind in _COLLECTING for p in parameters):
            break
    return tuple(dict.fromkeys(names))


_COLLECTING = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)


def check_options(name: str, options: Mapping[str, Any]) -> None:
    """Check the options of an environment, and the names of robots.

    Args:
        name: robosuite's name of the environment.
        options: Its constructor's, by name.

    Raises:
        UnknownNameError: If an option, or a robot, is unknown.
        RlcoError: If rlco sets an option itself, or robots are not names.

    Example:
        >>> check_options("Lift", {"robots": "UR5e"})
    """
    known = option_names(environment_class(name))
    for option, value in options.items():
        if option in FIXED and value != FIXED[option]:
            raise RlcoError(
                f"{option}={value!r} is not allowed for {PREFIX}{name}; "
                f"leave it out, it is {FIXED[option]!r}."
            )
        if option not in known:
            raise UnknownNameError(f"option of robosuite's {name}", option, known)
    robots = options.get("robots", DEFAULTS["robots"])
    for robot in robots if isinstance(robots, list | tuple) else [robots]:
        if not isinstance(robot, str):
            raise RlcoError(
                f"robots={robots!r} is not allowed; give a name, or a list of names."
            )
        if robot not in ROBOT_CLASS_MAPPING:
            raise UnknownNameError("robot", robot, sorted(ROBOT_CLASS_MAPPING))


def check_one_arm(name: str) -> None:
    """Refuse a robosuite environment that needs two arms.

    Raises:
        UnknownNameError: If robosuite has no such environment.
        RlcoError: If the environment needs two arms.

    Example:
        >>> check_one_arm("Lift")
    """
    if issubclass(environment_class(name), TwoArmEnv):
        raise two_arms(name)


def two_arms(name: str) -> RlcoError:
    """Return the error for an environment with more than one arm."""
    return RlcoError(
        f"{PREFIX}{name} has more than one arm, and no backend commands and observes "
        f"more than one; give a task and a robot with one, such as {PREFIX}Lift."
    )
