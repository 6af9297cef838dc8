"""Unseen variations, which all four tasks have: what they share.

``shapes`` and ``colours`` change the objects, ``initial_states`` draws starts from
ranges beside those of training, ``distractors`` adds objects that no policy is told
of, ``camera`` moves the camera, in pictures and in reported positions alike.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rlco.errors import UnknownNameError
from rlco.physics.domain import Domain
from rlco.physics.task import Array, InitialState, Task

VARIATIONS = ("shapes", "colours", "initial_states", "distractors", "camera")
CAMERA_YAW = 0.10  # added to the domain's own [rad]
CAMERA_SHIFT = (0.02, -0.02)  # added to the domain's own [m]
# A tin and a box: name, half height [m], colour.
DISTRACTORS = {
    "tin": (0.03, (0.55, 0.25, 0.62, 1.0)),
    "box": (0.035, (0.95, 0.72, 0.15, 1.0)),
}
# Shades that still bear the names of the instructions.
UNSEEN_COLOURS = {
    "red": (0.55, 0.05, 0.20, 1.0),
    "green": (0.60, 0.80, 0.20, 1.0),
    "blue": (0.35, 0.70, 0.90, 1.0),
}
JOINT_NOISE = 0.05  # of the arm at the start in ``initial_states`` [rad]
Range = tuple[float, float]


def check_variation(variation: str | None) -> None:
    """Refuse a variation that is not one of `VARIATIONS`.

    Raises:
        UnknownNameError: If the variation is unknown.
    """
    if variation is not None and variation not in VARIATIONS:
        raise UnknownNameError("variation", variation, VARIATIONS)


def check_variation_of(task: Task, variation: str | None) -> None:
    """Refuse a variation that a task does not have.

    Raises:
        UnknownNameError: If the variation is not one of the task's.

    Example:
        >>> from rlco.physics.task import make_task
        >>> check_variation_of(make_task("push_cube"), "camera")
    """
    if variation is not None and variation not in task.variations:
        raise UnknownNameError("variation", variation, task.variations or ("none",))


def domain_in(domain: Domain, variation: str | None) -> Domain:
    """Return the domain as it is in a variation: ``camera`` moves its camera.

    Example:
        >>> from rlco.physics.domain import SIM
        >>> domain_in(SIM, "camera").camera_yaw
        0.1
        >>> domain_in(SIM, "colours") == SIM
        True
    """
    if variation != "camera":
        return domain
    x, y = domain.camera_shift
    return replace(
        domain,
        # Further the way in which the stand-in's camera is already off.
        camera_yaw=domain.camera_yaw + CAMERA_YAW,
        camera_shift=(x + CAMERA_SHIFT[0], y + CAMERA_SHIFT[1]),
    )


def make_distractors() -> list[object]:
    """Return the objects that ``distractors`` adds, each with a free joint."""
    from robosuite.models.objects import BoxObject, CylinderObject

    (tin, purple), (box, yellow) = DISTRACTORS.values()
    return [
        CylinderObject(name="tin", size=[0.025, tin], rgba=purple, density=800.0),
        BoxObject(name="box", size=[0.02, 0.03, box], rgba=yellow, density=500.0),
    ]


def add_distractors(
    start: InitialState,
    rng: np.random.Generator,
    places: tuple[tuple[Range, Range], ...],
) -> InitialState:
    """Return a start with the distractors placed upright on the table.

    Args:
        start: The start without them.
        rng: Draws where they stand.
        places: A range of x and of y for each of them [m].
    """
    rows = np.zeros((len(DISTRACTORS), 7))
    heights = [half for half, _ in DISTRACTORS.values()]
    for row, height, (x, y) in zip(rows, heights, places, strict=True):
        yaw = rng.uniform(-np.pi, np.pi)
        turn = (np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2))
        row[:] = (rng.uniform(*x), rng.uniform(*y), 0.8 + height, *turn)
    return replace(start, object_pose=np.concatenate([start.object_pose, rows]))


def beside(rng: np.random.Generator, inner: float, outer: float) -> float:
    """Return a number whose size is between the two, of either sign."""
    return float(rng.choice([-1.0, 1.0]) * rng.uniform(inner, outer))


def yaw_quaternion(yaw: Array | float) -> Array:
    """Return quaternions (w, x, y, z) of turns about z, (...) -> (..., 4).

    Example:
        >>> yaw_quaternion(0.0).tolist()
        [1.0, 0.0, 0.0, 0.0]
    """
    half = np.asarray(yaw, dtype=float) / 2
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)
