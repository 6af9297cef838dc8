"""All that may differ between worlds, in one row of numbers: a frame is made of it.

A compiled function reads it from MuJoCo's own arrays at every frame. Drawing sees
nothing else of a world, so a frame cannot depend on another world, and two equal rows
give equal frames.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.physics.mj.compiling import inner
from rlco.physics.mj.copying import copy_into
from rlco.physics.mj.libmujoco import (
    address_of,
    doubles,
    flag_at,
    floats,
    integers,
    pointer_at,
)
from rlco.physics.mj.model_struct import model_type
from rlco.physics.rendering.raster.scene import CAMERA, ID, STILL, Scene
from rlco.physics.rendering.raster.scene import LIGHTS as MODEL_LIGHTS
from rlco.physics.rendering.raster.scene import MATERIAL as OWN_MATERIAL

Integers = NDArray[np.int64]
Array = NDArray[np.float64]

# Arrays of a state, by column of the table of their addresses.
STATE_ARRAYS = (
    "geom_xpos",
    "geom_xmat",
    "cam_xpos",
    "cam_xmat",
    "light_xpos",
    "light_xdir",
)
_GEOM_POS, _GEOM_MAT, _CAM_POS, _CAM_MAT, _LIGHT_POS, _LIGHT_DIR = range(6)
# Arrays of a model, by the place of their offset in its struct.
MODEL_ARRAYS = (
    "geom_rgba",
    "mat_rgba",
    "mat_emission",
    "mat_specular",
    "mat_shininess",
    "mat_texid",
    "mat_texrepeat",
    "mat_texuniform",
    "light_active",
    "light_type",
    "light_ambient",
    "light_diffuse",
    "light_specular",
    "light_attenuation",
    "light_cutoff",
    "light_exponent",
    "cam_fovy",
    "cam_sensorsize",
    "cam_intrinsic",
)
(
    _GEOM_RGBA,
    _MAT_RGBA,
    _EMISSION,
    _SPECULAR,
    _SHININESS,
    _TEXTURE,
    _REPEAT,
    _UNIFORM,
    _ACTIVE,
    _TYPE,
    _AMBIENT,
    _DIFFUSE,
    _LIGHT_SPECULAR,
    _ATTENUATION,
    _CUTOFF,
    _EXPONENT,
    _FOVY,
    _SENSOR,
    _INTRINSIC,
    _HEADLIGHT,
) = range(len(MODEL_ARRAYS) + 1)
_ROLES = int(mujoco.mjtTextureRole.mjNTEXROLE)
_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)

# Places in a row. The camera: position, rotation (world from camera), focal lengths and
# centre [pixels].
CAM_POS, CAM_MAT, FOCAL, CENTER = 0, 3, 12, 14
LIGHTS = 16  # the headlight, then the model's lights
# Of one light: whether it is on, whether it has a place, direction, position, colours,
# attenuation, the cosine of its cutoff, exponent.
(
    LIGHT_ON,
    LIGHT_PLACED,
    LIGHT_DIR,
    LIGHT_POS,
    AMBIENT,
    DIFFUSE,
    SPECULAR,
    ATTENUATION,
    CUTOFF,
    EXPONENT,
) = (0, 1, 2, 5, 8, 11, 14, 17, 20, 21)
LIGHT_SIZE = 22
# Of one geom: position, rotation, colour, material, and how a texture lies on it.
GEOM_POS, GEOM_MAT, RGBA, MATERIAL, TEXTURE, REPEAT, UNIFORM = 0, 3, 12, 16, 19, 20, 22
GEOM_SIZE = 23
# MuJoCo's colour of a geom that was given none: its material's counts then.
_UNSET = (0.5, 0.5, 0.5, 1.0)


class Sources(NamedTuple):
    """Where the rows of N worlds are read."""

    models: Integers  # addresses of the worlds' models (N,)
    states: Integers  # addresses of STATE_ARRAYS (N, 6)
    offsets: Integers  # of pointers to MODEL_ARRAYS in a model, then of the headlight


def state_addresses(data: Any) -> list[int]:
    """Return the addresses of one state's arrays that a frame is read from."""
    return [address_of(getattr(data, name)) for name in STATE_ARRAYS]


def model_offsets() -> Integers:
    """Return the offsets of what is read from the struct of a model."""
    kind = model_type()
    vis = dict(kind._fields_)["vis"]
    arrays = [getattr(kind, name).offset for name in MODEL_ARRAYS]
    headlight = kind.vis.offset + vis.headlight.offset
    return np.array([*arrays, headlight], dtype=np.int64)


def row_sizes(scene: Scene) -> Integers:
    """Return lengths of a row: before the geoms, with those that cannot move, all."""
    start = LIGHTS + LIGHT_SIZE * (1 + int(scene.numbers[MODEL_LIGHTS]))
    counts = 0, int(scene.numbers[STILL]), len(scene.geoms)
    return np.array([start + GEOM_SIZE * count for count in counts])


@inner
def read_row(
    geoms: Any,
    numbers: Any,
    model: int,
    state: Any,
    offsets: Any,
    height: int,
    width: int,
    row: Any,
) -> None:
    """Write the row of one world.

    Args:
        geoms: See `scene.Scene`.
        numbers: See `scene.Scene`.
        model: Address of its model.
        state: Addresses of its state's arrays, (6,).
        offsets: See `Sources`.
        height: Of a frame [pixels].
        width: Of a frame [pixels].
        row: Written.
    """
    _read_camera(numbers[CAMERA], model, state, offsets, height, width, row)
    at = LIGHTS + LIGHT_SIZE
    for light in range(numbers[MODEL_LIGHTS]):
        _read_light(light, model, state, offsets, row[at : at + LIGHT_SIZE])
        at += LIGHT_SIZE
    for g in range(geoms.shape[0]):
        part = row[at : at + GEOM_SIZE]
        _read_geom(geoms[g, ID], geoms[g, OWN_MATERIAL], model, state, offsets, part)
        at += GEOM_SIZE


@inner
def _read_camera(
    camera: int,
    model: int,
    state: Any,
    offsets: Any,
    height: int,
    width: int,
    row: Any,
) -> None:
    copy_into(row, CAM_POS, doubles(state[_CAM_POS] + 24 * camera, 3))
    copy_into(row, CAM_MAT, doubles(state[_CAM_MAT] + 72 * camera, 9))
    row[CENTER], row[CENTER + 1] = width / 2.0, height / 2.0
    sensor = floats(pointer_at(model + offsets[_SENSOR]) + 8 * camera, 2)
    if sensor[1] > 0.0:  # a sensor of a given size, with its intrinsic parameters
        lens = floats(pointer_at(model + offsets[_INTRINSIC]) + 16 * camera, 4)
        per_meter = height / sensor[1]
        row[FOCAL], row[FOCAL + 1] = lens[0] * per_meter, lens[1] * per_meter
        # As in MuJoCo, the principal point moves the sensor, and the image against it.
        row[CENTER] -= lens[2] * per_meter
        row[CENTER + 1] -= lens[3] * per_meter
    else:
        fovy = doubles(pointer_at(model + offsets[_FOVY]) + 8 * camera, 1)[0]
        # Rounded, because mathematical libraries differ in the last bit.
        focal = np.float32(height / 2.0 / np.tan(np.pi / 360.0 * fovy))
        row[FOCAL] = row[FOCAL + 1] = focal

    # The headlight is at the camera, and shines where it looks.
    light = row[LIGHTS : LIGHTS + LIGHT_SIZE]
    given = floats(model + offsets[_HEADLIGHT], 9)
    light[LIGHT_ON] = integers(model + offsets[_HEADLIGHT] + 36, 1)[0]
    light[LIGHT_PLACED] = 0.0
    for axis in range(3):
        light[LIGHT_DIR + axis] = -row[CAM_MAT + 3 * axis + 2]
        light[LIGHT_POS + axis] = row[CAM_POS + axis]
    copy_into(light, AMBIENT, given)
    light[ATTENUATION:] = 0.0


@inner
def _read_light(light: int, model: int, state: Any, offsets: Any, row: Any) -> None:
    row[LIGHT_ON] = flag_at(pointer_at(model + offsets[_ACTIVE]) + light)
    kind = integers(pointer_at(model + offsets[_TYPE]) + 4 * light, 1)[0]
    row[LIGHT_PLACED] = kind == 0 or kind == 2
    copy_into(row, LIGHT_DIR, doubles(state[_LIGHT_DIR] + 24 * light, 3))
    copy_into(row, LIGHT_POS, doubles(state[_LIGHT_POS] + 24 * light, 3))
    for place, which in (
        (AMBIENT, _AMBIENT),
        (DIFFUSE, _DIFFUSE),
        (SPECULAR, _LIGHT_SPECULAR),
        (ATTENUATION, _ATTENUATION),
    ):
        values = floats(pointer_at(model + offsets[which]) + 12 * light, 3)
        copy_into(row, place, values)
    cutoff = floats(pointer_at(model + offsets[_CUTOFF]) + 4 * light, 1)[0]
    # A point light shines everywhere.
    row[CUTOFF] = np.float32(np.cos(np.pi / 180.0 * cutoff)) if kind == 0 else -2.0
    row[EXPONENT] = floats(pointer_at(model + offsets[_EXPONENT]) + 4 * light, 1)[0]


@inner
def _read_geom(
    geom: int, material: int, model: int, state: Any, offsets: Any, row: Any
) -> None:
    copy_into(row, GEOM_POS, doubles(state[_GEOM_POS] + 24 * geom, 3))
    copy_into(row, GEOM_MAT, doubles(state[_GEOM_MAT] + 72 * geom, 9))
    rgba = floats(pointer_at(model + offsets[_GEOM_RGBA]) + 16 * geom, 4)
    copy_into(row, RGBA, rgba)
    row[MATERIAL] = 0.0
    row[MATERIAL + 1] = row[MATERIAL + 2] = 0.5
    row[TEXTURE] = -1.0
    row[REPEAT] = row[REPEAT + 1] = 1.0
    row[UNIFORM] = 0.0
    if material < 0:
        return
    unset = True
    for c in range(4):
        unset = unset and rgba[c] == _UNSET[c]
    if unset:
        of_material = pointer_at(model + offsets[_MAT_RGBA]) + 16 * material
        copy_into(row, RGBA, floats(of_material, 4))
    for place, which in enumerate((_EMISSION, _SPECULAR, _SHININESS)):
        values = floats(pointer_at(model + offsets[which]) + 4 * material, 1)
        row[MATERIAL + place] = values[0]
    texture = pointer_at(model + offsets[_TEXTURE]) + 4 * (_ROLES * material + _RGB)
    row[TEXTURE] = integers(texture, 1)[0]
    repeat = pointer_at(model + offsets[_REPEAT]) + 8 * material
    copy_into(row, REPEAT, floats(repeat, 2))
    row[UNIFORM] = flag_at(pointer_at(model + offsets[_UNIFORM]) + material)
