"""Ranges from which each episode draws a look of its own: domain randomisation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields

import numpy as np

from rlco.errors import RlcoError
from rlco.physics.spec.look import PLAIN, RGB, Light, Look, Surface, View

Range = tuple[float, float]


@dataclass(frozen=True)
class LookRanges:
    """Ranges of looks; each number is drawn uniformly and independently of all others.

    The defaults are ``look="random"``: around ``sim``, as wide as rooms and cameras
    differ. No texture is one that ``stand_in`` or ``locked`` adds.

    Attributes:
        textures: By part, the textures that it may have; None stands for that of
            ``sim``.
        brightness: Factor of a part's colours.
        tint: Further factor of each of red, green and blue.
        saturation: See `Surface`; of objects and robot.
        elevation: Height of the light above the horizon [rad].
        azimuth: Its direction around the table [rad].
        diffuse: Its strength.
        ambient: Light that reaches every surface alike.
        headlight: Diffuse light from where the camera is.
        shift: Of each camera's position along each of its axes [m].
        turn: Of each camera about each of its axes [rad].
        crop: See `View`.
        sensor_shift: See `View`; of each of both numbers.
        exposure: See `Look` [stops].
        white_balance: See `Look`; of each of both numbers.
        vignette: See `Look`.
        blur: See `Look`.
        noise: See `Look`.
        cameras: By name of each camera that differs, the vertical angle of its lens
            [degrees].
        around: By name, where a camera stands and what its lens is, if not as in
            ``sim``. Shifts, turns and sensor shifts are added to it, the crop is a
            factor of it, and so is the lens's angle over the middle of its range.
            `rlco.physics.spec.domain.with_look` takes these from the domain's look.

    Raises:
        RlcoError: If a range's ends are in the wrong order, or a look with one of them
            would be refused.

    Example:
        >>> look = LookRanges().draw(np.random.default_rng(0))
        >>> look.changes_scene, 0.0 <= look.vignette <= 0.35
        (True, True)
    """

    textures: Mapping[str, tuple[str | None, ...]] = field(
        default_factory=lambda: {
            "table": (
                None,
                PLAIN,
                "cream-plaster",
                "dark-wood",
                "wood-tiles",
                "wood-varnished-panels",
                "yellow-plaster",
            ),
            "floor": (None, PLAIN, "light-gray-floor-tile", "wood-varnished-panels"),
            "walls": (None, PLAIN, "cream-plaster", "white-plaster"),
        }
    )
    brightness: Range = (0.6, 1.0)
    tint: Range = (0.85, 1.0)
    saturation: Range = (0.6, 1.1)
    elevation: Range = (math.radians(25.0), math.radians(85.0))
    azimuth: Range = (-math.pi, math.pi)
    diffuse: Range = (0.4, 1.0)
    ambient: Range = (0.1, 0.35)
    headlight: Range = (0.05, 0.5)
    shift: Range = (-0.02, 0.02)
    turn: Range = (-0.03, 0.03)
    crop: Range = (1.0, 1.0)
    sensor_shift: Range = (-0.02, 0.02)
    exposure: Range = (-0.4, 0.8)
    white_balance: Range = (0.8, 1.25)
    vignette: Range = (0.0, 0.35)
    blur: Range = (0.0, 0.012)
    noise: Range = (0.0, 0.025)
    cameras: Mapping[str, Range] = field(
        default_factory=lambda: {
            "agentview": (41.0, 49.0),
            "robot0_eye_in_hand": (68.0, 82.0),
        }
    )
    around: Mapping[str, View] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for one in fields(self):
            given = getattr(self, one.name)
            if isinstance(given, Mapping):
                continue
            if len(given) != 2 or not given[0] <= given[1]:
                raise RlcoError(
                    f"{one.name}={given} of a look's ranges is no range; give its "
                    "least and its greatest value."
                )
        self._look(lambda given: given[0], lambda names: names[0])
        self._look(lambda given: given[1], lambda names: names[-1])

    def draw(self, rng: np.random.Generator) -> Look:
        """Return a look."""
        return self._look(
            lambda given: float(rng.uniform(*given)),
            lambda names: names[int(rng.integers(len(names)))],
        )

    def all_textures(self) -> dict[str, tuple[str, ...]]:
        """Return the textures that a scene needs for all of its looks, by part."""
        return {
            part: tuple(n for n in names if n is not None and n != PLAIN)
            for part, names in self.textures.items()
        }

    def _look(
        self,
        number: Callable[[Range], float],
        choice: Callable[[Sequence[str | None]], str | None],
    ) -> Look:
        """Return the look whose numbers and textures are drawn by two functions."""

        def colour() -> RGB:
            light = number(self.brightness)
            red, green, blue = (light * number(self.tint) for _ in range(3))
            return red, green, blue

        textured = {
            part: Surface(texture=choice(names), colour=colour())
            for part, names in sorted(self.textures.items())
        }
        plain = {
            part: Surface(colour=colour(), saturation=number(self.saturation))
            for part in ("objects", "robot")
        }
        up, around = number(self.elevation), number(self.azimuth)
        lamp = Light(
            direction=(
                -math.cos(up) * math.cos(around),
                -math.cos(up) * math.sin(around),
                -math.sin(up),
            ),
            ambient=(number(self.ambient),) * 3,
            diffuse=(number(self.diffuse),) * 3,
        )

        def view(name: str) -> View:
            base = self.around.get(name, View())
            right, up, back = (at + number(self.shift) for at in base.shift)
            pitch, yaw, roll = (at + number(self.turn) for at in base.turn)
            angle = base.field_of_view
            if name in self.cameras:
                drawn, middle = number(self.cameras[name]), sum(self.cameras[name]) / 2
                angle = drawn if angle is None else angle * drawn / middle
            return View(
                shift=(right, up, back),
                turn=(pitch, yaw, roll),
                field_of_view=angle,
                crop=base.crop * number(self.crop),
                sensor_shift=(
                    base.sensor_shift[0] + number(self.sensor_shift),
                    base.sensor_shift[1] + number(self.sensor_shift),
                ),
            )

        # Those that only a domain knows come last: the others keep their numbers.
        others = self.around.keys() - self.cameras.keys()
        cameras = {
            name: view(name) for name in (*sorted(self.cameras), *sorted(others))
        }
        ambient = (0.1, 0.1, 0.1)  # as in ``sim``
        return Look(
            surfaces={**plain, **textured},
            lights=(lamp,),
            headlight=Light(
                ambient=ambient,
                diffuse=(number(self.headlight),) * 3,
                specular=(0.0, 0.0, 0.0),
            ),
            cameras=cameras,
            exposure=number(self.exposure),
            white_balance=(number(self.white_balance), number(self.white_balance)),
            vignette=number(self.vignette),
            blur=number(self.blur),
            noise=number(self.noise),
        )
