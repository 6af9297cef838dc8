"""Looks: how a scene is drawn and photographed, as data.

A `Look` holds what two photographs of the same scene may differ in: surfaces, lights,
where the camera is and what its lens and sensor do. Nothing of it moves anything: a
look changes images alone. `LookRanges` draws a new one for each episode, see
`rlco.physics.spec.look_ranges`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from rlco.errors import RlcoError

RGB = tuple[float, float, float]
#: Parts of every scene; a task's objects have names of their own beside them.
PARTS = ("table", "table_legs", "floor", "walls", "robot", "objects")
#: Parts whose surface may have a texture.
TEXTURED = ("table", "table_legs", "floor", "walls")
MOST_LIGHTS = 4  # OpenGL draws eight, of which robosuite's and the headlight are two
PLAIN = "none"  # the name of no texture


def check_number(name: str, value: float, low: float, high: float) -> None:
    """Refuse a number of a look that is out of its range.

    Raises:
        RlcoError: If it is, or is NaN.
    """
    if not low <= value <= high:
        raise RlcoError(
            f"{name}={value} of a look is out of range; give {low:g} to {high:g}."
        )


def check_rgb(name: str, value: RGB, most: float) -> None:
    """Refuse red, green and blue of which one is not in [0, most].

    Raises:
        RlcoError: If one is not.
    """
    for part in value:
        check_number(name, part, 0.0, most)


@dataclass(frozen=True)
class Surface:
    """What one part of a scene is made of.

    Attributes:
        texture: Name of one of robosuite's textures (``light-wood``), ``none`` for
            plain colour; None: as in ``sim``. Of `TEXTURED` parts.
        colour: Factor of its red, green and blue, of colours and textures alike.
        saturation: Distance of its colours from grey, as a share of that in ``sim``.
            Textures keep theirs.
        gloss: Specular reflection, a share of light; None: as in ``sim``. Of parts that
            may have a texture, and of the robot.

    Raises:
        RlcoError: If a number is out of range.
    """

    texture: str | None = None
    colour: RGB = (1.0, 1.0, 1.0)
    saturation: float = 1.0
    gloss: float | None = None

    def __post_init__(self) -> None:
        check_rgb("colour", self.colour, 2.0)
        check_number("saturation", self.saturation, 0.0, 2.0)
        if self.gloss is not None:
            check_number("gloss", self.gloss, 0.0, 1.0)


@dataclass(frozen=True)
class Light:
    """One source of light.

    Attributes:
        direction: Where it shines, in the world; any length but 0.
        position: Where it is [m]; None: so far away that its rays are parallel. OpenGL
            computes light at corners alone, so that a lamp near a large flat surface
            looks other than by rlco's own renderer.
        ambient: Light that reaches every surface alike.
        diffuse: Light that a surface scatters which faces it.
        specular: Light that a glossy surface mirrors.

    Raises:
        RlcoError: If a number is out of range.
    """

    direction: RGB = (0.0, 0.0, -1.0)
    position: RGB | None = None
    ambient: RGB = (0.0, 0.0, 0.0)
    diffuse: RGB = (0.7, 0.7, 0.7)
    specular: RGB = (0.3, 0.3, 0.3)

    def __post_init__(self) -> None:
        for name in ("ambient", "diffuse", "specular"):
            check_rgb(name, getattr(self, name), 2.0)
        for name in ("direction", "position"):
            for value in getattr(self, name) or ():
                check_number(name, value, -100.0, 100.0)
        if not any(self.direction):
            raise RlcoError("direction=(0, 0, 0) of a light has no direction.")


@dataclass(frozen=True)
class View:
    """How one camera differs from the same camera in ``sim``.

    Attributes:
        shift: Its position, along its own axes: right, up, back [m].
        turn: Its rotation about these axes, applied one after the other [rad].
        field_of_view: Vertical angle of its lens [degrees]; None: as in ``sim``.
        crop: Share of the sensor's height that is read out, around its centre.
        sensor_shift: Where the lens's axis meets the sensor: right and down of the
            frame's centre, shares of the frame's height.

    Raises:
        RlcoError: If a number is out of range.
    """

    shift: RGB = (0.0, 0.0, 0.0)
    turn: RGB = (0.0, 0.0, 0.0)
    field_of_view: float | None = None
    crop: float = 1.0
    sensor_shift: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for value in self.shift:
            check_number("shift", value, -1.0, 1.0)
        for value in self.turn:
            check_number("turn", value, -math.pi, math.pi)
        if self.field_of_view is not None:
            check_number("field_of_view", self.field_of_view, 5.0, 150.0)
        check_number("crop", self.crop, 0.1, 1.0)
        for value in self.sensor_shift:
            check_number("sensor_shift", value, -0.5, 0.5)


@dataclass(frozen=True)
class Look:
    """How a scene is drawn and photographed; what is left out is as in ``sim``.

    Attributes:
        surfaces: By part: one of `PARTS`, or the name of one of a task's objects, which
            counts for it instead of ``objects``.
        lights: The sources of light; None: those of ``sim``.
        headlight: Light from where the camera is; None: that of ``sim``.
        cameras: By name.
        exposure: Light that the sensor gathers, as a power of two [stops].
        white_balance: Factors of red and of blue light against green.
        vignette: Share of light that a corner of the frame loses; it grows with the
            square of the distance from the lens's axis.
        blur: Standard deviation of what a point becomes, a share of the frame's height.
        noise: Standard deviation of a pixel's value, a share of white.

    Raises:
        RlcoError: If a number is out of range.

    Example:
        >>> warm = Look(white_balance=(1.1, 0.9), noise=0.01)
        >>> warm.changes_frames, warm.changes_scene
        (True, False)
    """

    surfaces: Mapping[str, Surface] = field(default_factory=dict)
    lights: tuple[Light, ...] | None = None
    headlight: Light | None = None
    cameras: Mapping[str, View] = field(default_factory=dict)
    exposure: float = 0.0
    white_balance: tuple[float, float] = (1.0, 1.0)
    vignette: float = 0.0
    blur: float = 0.0
    noise: float = 0.0

    def __post_init__(self) -> None:
        check_number("exposure", self.exposure, -4.0, 4.0)
        for value in self.white_balance:
            check_number("white_balance", value, 0.25, 4.0)
        check_number("vignette", self.vignette, 0.0, 1.0)
        check_number("blur", self.blur, 0.0, 0.05)
        check_number("noise", self.noise, 0.0, 0.5)
        if len(self.lights or ()) > MOST_LIGHTS:
            raise RlcoError(
                f"a look has {len(self.lights or ())} lights; give at most "
                f"{MOST_LIGHTS}."
            )
        for part, surface in self.surfaces.items():
            if surface.texture is not None and part not in TEXTURED:
                raise RlcoError(
                    f"texture={surface.texture!r} of {part!r} cannot be drawn; only "
                    f"{', '.join(TEXTURED)} have textures, so give a colour."
                )
            if surface.gloss is not None and part not in (*TEXTURED, "robot"):
                raise RlcoError(
                    f"gloss={surface.gloss} of {part!r} cannot be drawn; only "
                    f"{', '.join(TEXTURED)} and robot have one, so leave it out."
                )

    @property
    def changes_scene(self) -> bool:
        """Whether the scene or a camera differs from ``sim``."""
        lit = self.lights is not None or self.headlight is not None
        return bool(self.surfaces or self.cameras or lit)

    @property
    def changes_frames(self) -> bool:
        """Whether a frame differs from what was drawn of the scene."""
        return (self.exposure, self.white_balance) != (0.0, (1.0, 1.0)) or any(
            (self.vignette, self.blur, self.noise)
        )
