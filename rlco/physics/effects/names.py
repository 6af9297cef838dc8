"""Names of joints and bodies in a model with prefixes, as in robosuite.

A log's ``joint4`` is ``robot0_joint4`` in robosuite's model, ``right_gripper`` is
``gripper0_right_right_gripper``, and ``red_cube`` is ``red_cube_main``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace

import mujoco

from rlco.errors import UnknownNameError
from rlco.physics.effects.effect import AppliedEffect
from rlco.physics.effects.targets import moving_bodies

_PREFIX = re.compile(r"^(robot\d+|gripper\d+_(right|left)|(fixed_)?(mount|base)\d+)_")
_SUFFIX = re.compile(r"_main$")


def plain_name(name: str) -> str:
    """Return a name without robosuite's prefixes and suffixes.

    Example:
        >>> plain_name("robot0_joint4"), plain_name("red_cube_main")
        ('joint4', 'red_cube')
    """
    return _SUFFIX.sub("", _PREFIX.sub("", name))


def in_model(
    effects: Iterable[AppliedEffect],
    model: mujoco.MjModel,
    names: Mapping[str, str] | None = None,
) -> list[AppliedEffect]:
    """Return effects whose targets are names in a model.

    Args:
        effects: Their targets are names in the model, or names without robosuite's
            prefixes.
        model: The model.
        names: From a target to its name in the model, where it differs.

    Raises:
        UnknownNameError: If a target matches none of the model's joints and bodies, or
            several of them.
    """
    known = [model.joint(i).name for i in range(model.njnt)]
    known += [model.body(i).name for i in range(1, model.nbody)]
    known += [model.geom(i).name for i in range(model.ngeom)]
    # Of the rest there are hundreds: every wall and every mesh.
    offered = [n for n in (*known[: model.njnt], *moving_bodies(model)) if n]
    found = []
    for effect in effects:
        target = effect.target
        if target is not None:
            target = _match((names or {}).get(target, target), known, offered)
        found.append(replace(effect, target=target))
    return found


def _match(name: str, known: list[str], offered: list[str]) -> str:
    """Return the one of the known names that is meant, or offer some."""
    if name in known:
        return name
    near = sorted({other for other in known if plain_name(other) == name})
    if len(near) != 1:
        raise UnknownNameError("target of an effect", name, near or offered)
    return near[0]
