"""The looks of rlco's own domains, and looks by name.

``stand_in`` and ``locked`` are looks of a photograph of a table. Each number was fixed
by what is known of rooms, lenses and sensors, before any policy read an image of them;
docs/domains.md has the reasons. They are not tuned to results.
"""

from __future__ import annotations

from rlco.errors import UnknownNameError
from rlco.physics.spec.look import Light, Look, Surface, View
from rlco.physics.spec.look_ranges import LookRanges

GivenLook = str | Look | LookRanges
RANDOM = "random"

STAND_IN_LOOK = Look(
    surfaces={
        # A beech or birch top, as a workshop's table has, instead of white ceramic.
        "table": Surface(texture="light-wood", gloss=0.1),
        # A painted screed.
        "floor": Surface(texture="gray-plaster", colour=(0.8, 0.8, 0.8)),
        "walls": Surface(colour=(0.95, 0.93, 0.9)),
        # Paint and plastic mirror the room, which lightens and dulls their colours.
        "objects": Surface(saturation=0.8, colour=(0.9, 0.9, 0.9)),
        "robot": Surface(colour=(0.92, 0.92, 0.9)),
    },
    # A window on the robot's left: a cloudy sky half way up, and what the room
    # scatters of it.
    lights=(
        Light(
            direction=(-0.3, -0.8, -0.75),
            ambient=(0.12, 0.12, 0.12),
            diffuse=(0.62, 0.62, 0.62),
            specular=(0.2, 0.2, 0.2),
        ),
    ),
    # No light at the camera; ceiling lamps reach what is seen from above.
    headlight=Light(
        ambient=(0.12, 0.12, 0.12), diffuse=(0.22, 0.22, 0.22), specular=(0.0, 0.0, 0.0)
    ),
    cameras={
        # A RealSense D435's colour sensor: 42 degrees high; its axis is off the centre
        # by some 6 pixels of 480. Levelled by eye, to about half a degree.
        "agentview": View(
            field_of_view=42.0, turn=(0.008, 0.0, -0.008), sensor_shift=(0.012, -0.008)
        ),
        # The same camera on the wrist, without the wide lens of the model.
        "robot0_eye_in_hand": View(field_of_view=69.0, sensor_shift=(-0.01, 0.012)),
    },
    exposure=0.15,  # an automatic exposure has little to do: wood is middle grey
    # Fixed for a light that is a little bluer than the room's: it comes out warm.
    white_balance=(1.08, 0.9),
    vignette=0.2,  # of a small lens, after its own correction
    blur=0.004,  # 2 pixels of 480: demosaicing and focus
    noise=0.008,  # 2 of 255, in the room's light
)

LOCKED_LOOK = Look(
    surfaces={
        # A dark grey bench mat, as on an electronics bench.
        "table": Surface(texture="gray-plaster", colour=(0.55, 0.58, 0.6), gloss=0.0),
        "floor": Surface(texture="none", colour=(0.45, 0.44, 0.42)),
        "walls": Surface(texture="white-bricks", colour=(0.9, 0.9, 0.92)),
        # Brighter paint than in `stand_in`, a robot that has been used.
        "objects": Surface(saturation=0.9),
        "robot": Surface(colour=(0.85, 0.86, 0.88)),
    },
    # A row of LED panels on the robot's right; the room is dark.
    lights=(
        Light(
            direction=(0.2, 0.7, -0.7),
            ambient=(0.06, 0.06, 0.06),
            diffuse=(0.75, 0.75, 0.75),
        ),
    ),
    headlight=Light(
        ambient=(0.1, 0.1, 0.1), diffuse=(0.15, 0.15, 0.15), specular=(0.0, 0.0, 0.0)
    ),
    cameras={
        # A webcam of 48 degrees, levelled by eye to the other side.
        "agentview": View(
            field_of_view=48.0, turn=(-0.012, 0.0, 0.012), sensor_shift=(-0.015, 0.01)
        ),
        # The wide lens of an action camera.
        "robot0_eye_in_hand": View(field_of_view=80.0, sensor_shift=(0.012, 0.01)),
    },
    exposure=1.0,  # an automatic exposure lifts a dark mat, not all the way
    # Fixed for lamps that are warmer than these panels: it comes out cold.
    white_balance=(0.92, 1.1),
    vignette=0.3,  # of a cheaper lens, without correction
    blur=0.006,  # 3 pixels of 480
    noise=0.014,  # 3.6 of 255: a higher gain in less light
)

LOOKS: dict[str, Look | LookRanges] = {
    "sim": Look(),
    "stand_in": STAND_IN_LOOK,
    "locked": LOCKED_LOOK,
    RANDOM: LookRanges(),
}


def make_look(look: GivenLook) -> Look | LookRanges:
    """Return the look of that name; a look is returned as it is.

    Args:
        look: ``sim``, ``stand_in``, ``locked``, or ``random``, which draws one for each
            episode.

    Raises:
        UnknownNameError: If there is no look of that name.

    Example:
        >>> make_look("stand_in").vignette
        0.2
    """
    if isinstance(look, Look | LookRanges):
        return look
    if look not in LOOKS:
        raise UnknownNameError("look", str(look), tuple(LOOKS))
    return LOOKS[look]
