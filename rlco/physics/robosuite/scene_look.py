"""Looks in robosuite's scenes: textures and lights that are added, arrays that change.

What a look needs beyond the scene as built (a texture, a second lamp) is added to the
scene's XML before it is compiled. All else is numbers of the compiled model, which
differ between worlds and change from one episode to the next.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import UnknownNameError
from rlco.physics.mj.model_struct import HEADLIGHT, get_array
from rlco.physics.rendering.camera import camera_id
from rlco.physics.robosuite.robosuite_api import robosuite
from rlco.physics.spec.look import (
    PARTS,
    PLAIN,
    Light,
    Look,
    Surface,
    View,
)
from rlco.physics.spec.look_ranges import LookRanges

Fields = dict[str, NDArray[Any]]
_FOLDER = Path(robosuite.models.assets_root) / "textures"
_PREFIX = "look_"
# Materials of the parts that may have a texture, and how a texture lies on them.
_MATERIALS = {
    "table": ("table_ceramic", "cube"),
    "table_legs": ("table_legs_metal", "cube"),
    "floor": ("floorplane", "2d"),
    "walls": ("walls_mat", "2d"),
}
_OF_ROBOT = ("robot0_", "gripper0_", "fixed_mount0_")
# robosuite's own geoms that are no part of a scene.
_MARKERS = ("left_eef_target", "right_eef_target")
_LUMA = np.array([0.299, 0.587, 0.114])  # of ITU-R BT.601
_NO_TEXTURE = -1
# Arrays that a look may change.
FIELDS = (
    "geom_rgba",
    "mat_rgba",
    "mat_specular",
    "mat_texid",
    "light_active",
    "light_type",
    "light_pos",
    "light_dir",
    "light_ambient",
    "light_diffuse",
    "light_specular",
    "cam_pos",
    "cam_quat",
    "cam_fovy",
    "cam_sensorsize",
    "cam_intrinsic",
    HEADLIGHT,
)


def add_to_scene(root: Any, look: Look | LookRanges) -> None:
    """Add the textures and lights that a look needs to a scene's XML.

    Args:
        root: robosuite's model of the scene, with ``asset`` and ``worldbody``.
        look: The look, or the ranges of looks.

    Raises:
        UnknownNameError: If there is no such texture.
    """
    known = sorted(path.stem for path in _FOLDER.glob("*.png"))
    added = set()
    for part, name in _textures(look):
        if name not in known:
            raise UnknownNameError("texture", name, [PLAIN, *known])
        kind = _MATERIALS[part][1]
        if (kind, name) in added:
            continue
        added.add((kind, name))
        attributes = {
            "name": _texture_name(kind, name),
            "type": kind,
            "file": str(_FOLDER / f"{name}.png"),
        }
        root.asset.append(ElementTree.Element("texture", attributes))
    lights = look.lights if isinstance(look, Look) else None
    present = len(root.worldbody.findall(".//light"))
    for number in range(present, len(lights or ())):
        name = f"{_PREFIX}light_{number}"
        attributes = {"name": name, "active": "false", "castshadow": "false"}
        root.worldbody.append(ElementTree.Element("light", attributes))


def _textures(look: Look | LookRanges) -> Iterator[tuple[str, str]]:
    """Yield parts and names of the textures that they may have."""
    if isinstance(look, LookRanges):
        for part, names in look.all_textures().items():
            yield from ((part, name) for name in names)
        return
    for part, surface in look.surfaces.items():
        if surface.texture not in (None, PLAIN):
            yield part, surface.texture


def _texture_name(kind: str, name: str) -> str:
    return f"{_PREFIX}{kind}_{name}"


class SceneLook:
    """The numbers of a compiled scene that looks change, as they are without one.

    Args:
        model: The compiled model, with what `add_to_scene` added, before any look.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._base = {name: get_array(model, name).copy() for name in FIELDS}
        self._materials, self._geoms = _parts(model)
        self._objects = sorted(set(self._geoms) | set(self._materials) - set(PARTS))

    def fields(self, look: Look) -> Fields:
        """Return the arrays of the model with a look, by MuJoCo's names.

        Raises:
            UnknownNameError: If the scene has no such part, object or camera.
        """
        found = {name: value.copy() for name, value in self._base.items()}
        for part, surface in look.surfaces.items():
            self._paint(found, part, surface, look)
        if look.lights is not None:
            for number in range(self._model.nlight):
                lamp = look.lights[number] if number < len(look.lights) else None
                _shine(found, number, lamp)
        if look.headlight is not None:
            lamp = look.headlight
            found[HEADLIGHT][:] = lamp.ambient, lamp.diffuse, lamp.specular
        for name, view in look.cameras.items():
            _place(found, camera_id(self._model, name), view)
        return found

    def _paint(self, found: Fields, part: str, surface: Surface, look: Look) -> None:
        """Change the surface of a part: one of `PARTS`, or an object."""
        names = [part]
        if part == "objects":
            names = [name for name in self._objects if name not in look.surfaces]
        elif part not in (*PARTS, *self._objects):
            raise UnknownNameError("part of a look", part, [*PARTS, *self._objects])
        materials = [m for name in names for m in self._materials.get(name, ())]
        geoms = [g for name in names for g in self._geoms.get(name, ())]
        if surface.texture is not None:
            role = mujoco.mjtTextureRole.mjTEXROLE_RGB
            found["mat_texid"][materials, role] = self._texture(part, surface.texture)
        if surface.gloss is not None:
            found["mat_specular"][materials] = surface.gloss
        for name, rows in (("mat_rgba", materials), ("geom_rgba", geoms)):
            found[name][rows, :3] = painted(self._base[name][rows, :3], surface)

    def _texture(self, part: str, name: str) -> int:
        if name == PLAIN:
            return _NO_TEXTURE
        full = _texture_name(_MATERIALS[part][1], name)
        kind = mujoco.mjtObj.mjOBJ_TEXTURE
        return int(mujoco.mj_name2id(self._model, kind, full))


def painted(colours: NDArray[Any], surface: Surface) -> NDArray[Any]:
    """Return colours (..., 3) with a surface's saturation and factors, in [0, 1].

    Example:
        >>> painted(np.array([0.9, 0.1, 0.1]), Surface(saturation=0.0)).round(4)
        array([0.3392, 0.3392, 0.3392])
    """
    grey = (colours @ _LUMA)[..., None]
    mixed = grey + surface.saturation * (colours - grey)
    out: NDArray[Any] = np.clip(mixed * surface.colour, 0.0, 1.0)
    return out


def _parts(model: mujoco.MjModel) -> tuple[dict[str, list[int]], dict[str, list[int]]]:
    """Return the materials and the geoms of each part and object that have colours."""
    materials = {
        part: [number]
        for part, (name, _) in _MATERIALS.items()
        if (number := mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_MATERIAL, name)) >= 0
    }
    geoms: dict[str, list[int]] = {}
    arena = {number for (number,) in materials.values()}
    for geom in range(model.ngeom):
        body = model.body(model.geom_bodyid[geom]).name
        if model.geom_group[geom] == 0 or body in _MARKERS:
            continue
        material = int(model.geom_matid[geom])
        if material in arena:
            continue
        part = "robot" if body.startswith(_OF_ROBOT) else _object(model, geom)
        # MuJoCo's colour of a geom that was given none: its material's counts then.
        unset = (model.geom_rgba[geom] == (0.5, 0.5, 0.5, 1.0)).all()
        if material < 0 or not unset:
            geoms.setdefault(part, []).append(geom)
        elif material not in materials.setdefault(part, []):
            materials[part].append(material)
    return materials, geoms


def _object(model: mujoco.MjModel, geom: int) -> str:
    """Return the name of the object that a geom belongs to, as its task gives it."""
    root = model.body_rootid[model.geom_bodyid[geom]]
    return str(model.body(root).name).removesuffix("_main")


def _shine(found: Fields, number: int, lamp: Light | None) -> None:
    """Change one of the model's lights; None switches it off."""
    found["light_active"][number] = lamp is not None
    if lamp is None:
        return
    kinds = mujoco.mjtLightType
    placed = lamp.position is not None
    kind = kinds.mjLIGHT_POINT if placed else kinds.mjLIGHT_DIRECTIONAL
    found["light_type"][number] = int(kind)
    if lamp.position is not None:
        found["light_pos"][number] = lamp.position
    direction = np.array(lamp.direction)
    found["light_dir"][number] = direction / np.linalg.norm(direction)
    for name in ("ambient", "diffuse", "specular"):
        found[f"light_{name}"][number] = getattr(lamp, name)


def _place(found: Fields, camera: int, view: View) -> None:
    """Change one camera."""
    position, quaternion = found["cam_pos"][camera], found["cam_quat"][camera]
    matrix, turn, step = np.empty(9), np.empty(4), np.empty(4)
    mujoco.mju_quat2Mat(matrix, quaternion)
    position += matrix.reshape(3, 3) @ view.shift
    for axis, angle in zip(np.eye(3), view.turn, strict=True):
        mujoco.mju_axisAngle2Quat(turn, axis, angle)
        mujoco.mju_mulQuat(step, quaternion, turn)
        quaternion[:] = step
    if view.field_of_view is not None:
        found["cam_fovy"][camera] = view.field_of_view
    if view.crop == 1.0 and not any(view.sensor_shift):
        return
    # A sensor of height 1, in whatever unit; MuJoCo's principal point moves the sensor.
    half = np.tan(np.deg2rad(found["cam_fovy"][camera]) / 2.0)
    found["cam_sensorsize"][camera] = 1.0
    focal, (right, down) = 0.5 / half / view.crop, view.sensor_shift
    found["cam_intrinsic"][camera] = focal, focal, -right, -down
