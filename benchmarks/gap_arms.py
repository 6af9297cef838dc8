"""Robot models that hidden cases are recorded from: MJCF of their own, no meshes.

Small arms of capsules, a servo with a bar, an arm of hobby servos, and robosuite's
Panda (its kinematics and inertias, read from robosuite) with position servos.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TIMESTEP = 0.002  # [s]


@dataclass(frozen=True)
class Arm:
    """A nominal model and the motions that suit it.

    Attributes:
        name: Its name in a case's truth.
        xml: The model; an actuator bears the name of the joint it drives.
        home: Where recordings start, (joints,) [rad].
        sweep: How far from there joints are sent, (joints,) [rad].
        hand: The body that holds a payload.
        grip: Where in that body's frame it is held, (3,) [m].
    """

    name: str
    xml: str
    home: Array
    sweep: Array
    hand: str
    grip: Array

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, which the actuators share."""
        model = mujoco.MjModel.from_xml_string(self.xml)
        return tuple(model.joint(i).name for i in range(model.njnt))


@dataclass(frozen=True)
class _Link:
    """One link of a chain of capsules along x, turned by one servo."""

    joint: str
    axis: str
    length: float
    mass: float
    kp: float
    kv: float
    damping: float
    armature: float
    friction: float = 0.0
    force: float = 0.0
    sweep: float = 1.1


_SERVO = (_Link("joint1", "0 1 0", 0.22, 0.28, 11.0, 0.35, 0.05, 0.004),)
_ARM3 = (
    _Link("joint1", "0 0 1", 0.28, 1.00, 70.0, 4.5, 0.35, 0.018),
    _Link("joint2", "0 1 0", 0.24, 0.70, 90.0, 5.5, 0.45, 0.020),
    _Link("joint3", "0 1 0", 0.18, 0.35, 35.0, 1.8, 0.20, 0.015),
)
_ARM6 = (
    _Link("joint1", "0 0 1", 0.05, 0.17, 28.0, 1.3, 0.09, 0.006),
    _Link("joint2", "0 1 0", 0.13, 0.13, 36.0, 1.6, 0.11, 0.006),
    _Link("joint3", "0 1 0", 0.13, 0.10, 28.0, 1.1, 0.10, 0.005),
    _Link("joint4", "1 0 0", 0.06, 0.08, 11.0, 0.35, 0.05, 0.005),
    _Link("joint5", "0 1 0", 0.05, 0.06, 10.0, 0.30, 0.04, 0.005),
    _Link("joint6", "1 0 0", 0.05, 0.05, 6.5, 0.20, 0.03, 0.004),
)
# Hobby servos: high gears, so much armature and friction for little torque.
_SO101 = (
    _Link("shoulder_pan", "0 0 1", 0.04, 0.12, 18.0, 0.70, 0.25, 0.028, 0.04, 3.0),
    _Link("shoulder_lift", "0 1 0", 0.115, 0.16, 18.0, 0.70, 0.25, 0.028, 0.04, 3.0),
    _Link("elbow_flex", "0 1 0", 0.135, 0.15, 18.0, 0.70, 0.25, 0.028, 0.04, 3.0),
    _Link("wrist_flex", "0 1 0", 0.06, 0.10, 18.0, 0.60, 0.20, 0.024, 0.03, 3.0),
    _Link("wrist_roll", "1 0 0", 0.05, 0.09, 18.0, 0.60, 0.20, 0.024, 0.03, 3.0),
    _Link("gripper", "0 0 1", 0.06, 0.04, 18.0, 0.60, 0.20, 0.024, 0.03, 3.0, 0.6),
)
_PANDA_GAINS = (600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0)
_PANDA_HOME = (0.0, 0.0, 0.0, -1.571, 0.0, 1.868, 0.0)
_PANDA_SWEEP = (1.3, 1.1, 1.3, 0.8, 1.5, 1.1, 1.5)


def _chain(name: str, links: tuple[_Link, ...], home: tuple[float, ...]) -> Arm:
    bodies, servos, place = "", "", "0 0 0.1"
    for number, link in enumerate(links, start=1):
        friction = f' frictionloss="{link.friction}"' if link.friction else ""
        limit = f' forcerange="{-link.force} {link.force}"' if link.force else ""
        bodies += (
            f'<body name="link{number}" pos="{place}">'
            f'<joint name="{link.joint}" axis="{link.axis}" damping="{link.damping}" '
            f'armature="{link.armature}"{friction}/>'
            f'<geom name="link{number}" type="capsule" '
            f'fromto="0 0 0 {link.length} 0 0" size="0.018" mass="{link.mass}" '
            'contype="0" conaffinity="0"/>'
        )
        servos += (
            f'<position name="{link.joint}" joint="{link.joint}" kp="{link.kp}" '
            f'kv="{link.kv}"{limit}/>'
        )
        place = f"{link.length} 0 0"
    xml = (
        f'<mujoco model="{name}"><compiler angle="radian" autolimits="true"/>'
        f'<option timestep="{TIMESTEP}" integrator="implicitfast"/><worldbody>'
        f"{bodies}{'</body>' * len(links)}</worldbody>"
        f"<actuator>{servos}</actuator></mujoco>"
    )
    sweep = np.array([link.sweep for link in links])
    hand, grip = f"link{len(links)}", np.array([links[-1].length, 0.0, 0.0])
    return Arm(name, xml, np.array(home), sweep, hand, grip)


def _panda() -> Arm:
    found = find_spec("robosuite")
    if found is None or found.origin is None:
        raise ImportError("the panda is read from robosuite, which is not installed")
    # Only a file of it is needed: importing it takes seconds.
    path = Path(found.origin).parent / "models/assets/robots/panda/robot.xml"
    # Some of robosuite's files hold comments that are not well formed.
    source = re.sub(r"<!--.*?-->", "", path.read_text(), flags=re.DOTALL)
    root = ElementTree.fromstring(source)
    model = ElementTree.Element("mujoco", model="panda")
    ElementTree.SubElement(model, "compiler", angle="radian")
    option = {"timestep": str(TIMESTEP), "integrator": "implicitfast"}
    ElementTree.SubElement(model, "option", option)
    world = ElementTree.SubElement(model, "worldbody")
    base = root.find("worldbody/body")
    if base is None:
        raise LookupError(f"{path} holds no body")
    world.append(_bare(base))
    servos = ElementTree.SubElement(model, "actuator")
    for joint, kp in zip(world.iter("joint"), _PANDA_GAINS, strict=True):
        joint.set("armature", "0.1")
        joint.set("damping", "1")
        force = 87 if kp > 500 else 12
        servo = {"joint": joint.get("name", ""), "forcerange": f"{-force} {force}"}
        servo |= {"name": servo["joint"], "kp": str(kp), "kv": str(0.1 * kp)}
        ElementTree.SubElement(servos, "position", servo)
    xml = ElementTree.tostring(model, encoding="unicode")
    home, sweep = np.array(_PANDA_HOME), np.array(_PANDA_SWEEP)
    return Arm("panda", xml, home, sweep, "right_hand", np.array([0.0, 0.0, 0.08]))


def _bare(body: ElementTree.Element) -> ElementTree.Element:
    """Return a body with its joints and inertias, and so all that hang on it."""
    bare = ElementTree.Element("body", body.attrib)
    for part in body:
        if part.tag in ("inertial", "joint"):
            ElementTree.SubElement(bare, part.tag, part.attrib)
        # Cameras, sites and the gripper's mount are not needed, nor empty bodies.
        elif part.tag == "body" and part.find("inertial") is not None:
            bare.append(_bare(part))
    return bare


ARMS = ("servo", "arm3", "arm6", "so101", "panda")


def make_arm(name: str) -> Arm:
    """Return one of `ARMS`.

    Example:
        >>> make_arm("arm3").joints
        ('joint1', 'joint2', 'joint3')
    """
    match name:
        case "servo":
            return _chain(name, _SERVO, (0.3,))
        case "arm3":
            return _chain(name, _ARM3, (0.0,) * 3)
        case "arm6":
            return _chain(name, _ARM6, (0.0,) * 6)
        case "so101":
            return _chain(name, _SO101, (0.0, -0.9, 1.2, 0.4, 0.0, 0.3))
        case "panda":
            return _panda()
    raise KeyError(f"no arm {name!r}: {', '.join(ARMS)}")
