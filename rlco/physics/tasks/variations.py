"""Unseen variations, common to all four tasks.

``shapes`` and ``colours`` change the objects. ``initial_states`` draws initial states
from ranges outside those of training. ``distractors`` adds objects that policies do not
observe. ``camera`` moves the camera, in images and in reported positions alike.
``lights`` changes the light, in images alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rlco.errors import RlcoError, UnknownNameError
from rlco.physics.spec.domain import Domain
from rlco.physics.spec.look import Light, Look
from rlco.physics.spec.task import Array, InitialState, Task

VARIATIONS = (
    "shapes",
    "colours",
    "initial_states",
    "distractors",
    "camera",
    "lights",
)
CAMERA_YAW = 0.10  # added to the domain's own [rad]
CAMERA_SHIFT = (0.02, -0.02)  # added to the domain's own [m]
# A tin and a box: name, half height [m], colour.
DISTRACTORS = {
    "tin": (0.03, (0.55, 0.25, 0.62, 1.0)),
    "box": (0.035, (0.95, 0.72, 0.15, 1.0)),
}
# Shades that still match the names in the instructions.
UNSEEN_COLOURS = {
    "red": (0.55, 0.05, 0.20, 1.0),
    "green": (0.60, 0.80, 0.20, 1.0),
    "blue": (0.35, 0.70, 0.90, 1.0),
}
# An evening: a desk lamp opposite the robot, 21 degrees above the table, with the warm
# light of 2700 K, and hardly any from elsewhere. No light of random looks is coloured,
# or as low.
UNSEEN_LIGHTS = (
    Light(
        direction=(-0.85, 0.4, -0.36),
        ambient=(0.1, 0.08, 0.05),
        diffuse=(1.0, 0.78, 0.5),
        specular=(0.3, 0.23, 0.15),
    ),
)
UNSEEN_HEADLIGHT = Light(
    ambient=(0.08, 0.08, 0.08), diffuse=(0.1, 0.1, 0.1), specular=(0.0, 0.0, 0.0)
)
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
        >>> from rlco.physics.tasks.make_task import make_task
        >>> check_variation_of(make_task("push_cube"), "camera")
    """
    if variation is not None and variation not in task.variations:
        raise UnknownNameError("variation", variation, task.variations or ("none",))


def check_variation_images(variation: str | None, image_size: object) -> None:
    """Refuse a variation of images alone where none are drawn.

    Args:
        variation: Its name, or None.
        image_size: Of the images that are drawn; None where there are none.

    Raises:
        RlcoError: It is ``lights``, and there are none.
    """
    if variation == "lights" and image_size is None:
        raise RlcoError(
            "variation=lights changes images alone, but none are drawn; leave it out, "
            "or give what reads images."
        )


def domain_in(domain: Domain, variation: str | None) -> Domain:
    """Return the domain under a variation: another camera, or other lights.

    Raises:
        RlcoError: The domain draws its lights by itself, which ``lights`` sets.

    Example:
        >>> from rlco.physics.spec.domain import SIM
        >>> domain_in(SIM, "camera").sensors.camera_yaw
        0.1
        >>> domain_in(SIM, "colours") == SIM
        True
    """
    if variation == "lights":
        return _lit_otherwise(domain)
    if variation != "camera":
        return domain
    sensors = domain.sensors
    x, y = sensors.camera_shift
    moved = replace(
        sensors,
        # Farther in the direction in which the stand-in's camera is already off.
        camera_yaw=sensors.camera_yaw + CAMERA_YAW,
        camera_shift=(x + CAMERA_SHIFT[0], y + CAMERA_SHIFT[1]),
    )
    return replace(domain, sensors=moved)


def _lit_otherwise(domain: Domain) -> Domain:
    """Return the domain with unseen lights, and the rest of its look as it is."""
    if not isinstance(domain.look, Look):
        raise RlcoError(
            "variation=lights sets the lights, but look=random draws them in each "
            "episode; leave one of them out."
        )
    lit = replace(domain.look, lights=UNSEEN_LIGHTS, headlight=UNSEEN_HEADLIGHT)
    return replace(domain, look=lit)


def make_distractors() -> list[object]:
    """Return the objects that ``distractors`` adds, each with a free joint."""
    from rlco.physics.robosuite.robosuite_api import BoxObject, CylinderObject

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
    """Return an initial state with the distractors placed upright on the table.

    Args:
        start: The initial state without them.
        rng: Draws their positions.
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
    """Return a random number with a magnitude between the two, of either sign."""
    return float(rng.choice([-1.0, 1.0]) * rng.uniform(inner, outer))


def yaw_quaternion(yaw: Array | float) -> Array:
    """Return quaternions (w, x, y, z) of rotations about z, (...) -> (..., 4).

    Example:
        >>> yaw_quaternion(0.0).tolist()
        [1.0, 0.0, 0.0, 0.0]
    """
    half = np.asarray(yaw, dtype=float) / 2
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)
