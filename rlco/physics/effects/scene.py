"""Factors that a task reads while its scene and controller are built.

A task's scene has objects, a table and fixtures, which a compiled model does not
distinguish. These effects therefore change no model: rlco's tasks read them from their
domain. A search for what a model lacks does not use them.
"""

from __future__ import annotations

import mujoco

from rlco.physics.effects.effect import Effect, Parameter


def _nothing(model: mujoco.MjModel) -> tuple[str | None, ...]:
    return ()


FACTOR = Parameter("factor", "", 0.05, 20.0, 1.0, (0.5, 2.0))


def _factor(model: mujoco.MjModel, target: str | None) -> tuple[Parameter, ...]:
    return (FACTOR,)


def _of_task(name: str, summary: str, signature: str) -> Effect:
    return Effect(
        name=name,
        summary=summary,
        signature=signature,
        confused_with=(),
        targets=_nothing,
        parameters=_factor,
        of_task=True,
        candidate=False,
    )


SCENE_FRICTION = _of_task(
    "scene_friction",
    "The sliding friction of a task's objects, table and handles, times a factor.",
    "Objects slide further, or less far, wherever they are pushed.",
)
SCENE_MASS = _of_task(
    "scene_mass",
    "The mass of a task's objects and of what its fixtures move, times a factor.",
    "Objects gather speed more slowly, or faster, in pushes and lifts.",
)
FIXTURE_FRICTION = _of_task(
    "fixture_friction",
    "The friction of fixtures' joints, such as a drawer's runners, times a factor.",
    "A drawer needs more, or less, force to move.",
)
CONTROLLER_STIFFNESS = _of_task(
    "controller_stiffness",
    "The stiffness of the arm's controller, times a factor; its damping follows.",
    "The arm follows its goals more slowly, or faster, in all directions alike.",
)
