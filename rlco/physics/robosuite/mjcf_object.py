"""A robosuite object from MJCF generated in Python.

robosuite reads objects of several bodies from XML files. A scene computed by a task (a
ring of boxes, a handle of another length) needs no file.
"""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

from rlco.physics.robosuite.robosuite_api import MujocoObject

# robosuite's geom groups: collision (with mass), and visual.
COLLISION_GROUP, VISUAL_GROUP = "0", "1"


class MjcfObject(MujocoObject):
    """A body with its children, as robosuite adds objects to a scene.

    Every name is prefixed with the object's name and an underscore, as in all of
    robosuite's objects: body ``drawer`` of ``cabinet`` is ``cabinet_drawer``.

    Args:
        name: The object's name.
        body: The root body; give its geoms with `geom`.

    Example:
        >>> from xml.etree import ElementTree
        >>> body = ElementTree.Element("body", name="main")
        >>> geom(body, "lid", "box", (0, 0, 0.1), (0.1, 0.1, 0.01), (1, 1, 1, 1))
        >>> MjcfObject("crate", body).visual_geoms
        ['crate_lid_visual']
    """

    def __init__(self, name: str, body: ElementTree.Element) -> None:
        super().__init__()
        self._name = name
        self._obj = body
        self._get_object_properties()

    def exclude_from_prefixing(self, inp: object) -> bool:
        """Exclude no name from prefixing."""
        return False


def geom(
    body: ElementTree.Element,
    name: str,
    kind: str,
    position: Sequence[float],
    size: Sequence[float],
    rgba: Sequence[float],
    *,
    quaternion: str | None = None,
    **attributes: str,
) -> None:
    """Add a geom that collides and has mass, and its visual twin.

    Args:
        body: The body to add it to.
        name: Its name.
        kind: MuJoCo's type of a primitive.
        position: Centre in the body's frame [m].
        size: In MuJoCo's convention: half sizes, or radius and half height [m].
        rgba: Colour.
        quaternion: Orientation in the body's frame, as in MJCF.
        attributes: Further MJCF attributes, for the colliding geom.
    """
    place = {
        "type": kind,
        "pos": numbers(position),
        "size": numbers(size),
        **({"quat": quaternion} if quaternion else {}),
    }
    solid = {"name": name, "group": COLLISION_GROUP, **place, **attributes}
    ElementTree.SubElement(body, "geom", solid)
    visual = {"contype": "0", "conaffinity": "0", "mass": "0", "rgba": numbers(rgba)}
    visual |= {"name": f"{name}_visual", "group": VISUAL_GROUP}
    ElementTree.SubElement(body, "geom", {**visual, **place})


def numbers(values: Sequence[float]) -> str:
    """Format numbers as in MJCF.

    Example:
        >>> numbers((0.1, -2, 3.0))
        '0.1 -2 3'
    """
    return " ".join(f"{value:.10g}" for value in values)
