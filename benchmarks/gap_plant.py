"""The plant that hidden cases are recorded from: MuJoCo and what the model lacks.

Nothing here comes from rlco: every effect is written a second time, from its physical
definition, by changing numbers of the compiled model, by filtering the commands sample
by sample and by forces in a plain stepping loop. A search that were tested on data of
its own code would only show that the code agrees with itself.

The plant takes the same steps as the model (2 ms): finer ones are a gap of their own,
of about 1 mrad in fast motion, and an effect of their own here (``finer_steps``).
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from gap_arms import Array

# A spring between motor and link loses this part of its critical damping.
_SPRING_DAMPING = 0.05
_PAYLOAD_RADIUS = 0.02  # [m]


@dataclass(frozen=True)
class Hidden:
    """An effect in the plant that the model lacks.

    Attributes:
        name: One of the library's names, or of an effect outside it.
        target: Joint, body or None.
        parameters: Its numbers, under the library's names where it is in the library.
        outside: Whether no library holds it.
    """

    name: str
    target: str | None
    parameters: Mapping[str, float]
    outside: bool = False

    def __getitem__(self, key: str) -> float:
        return float(self.parameters[key])


@dataclass
class Plant:
    """A compiled model, and what acts beside it.

    Attributes:
        model: With the effects that are numbers of it.
        joints: Names of the logged joints.
        hidden: All effects.
        dofs: Degrees of freedom (and positions) of the logged joints.
        springs: Position of the spring behind a joint's motor, by joint.
    """

    model: mujoco.MjModel
    joints: tuple[str, ...]
    hidden: tuple[Hidden, ...]
    dofs: dict[str, int] = field(default_factory=dict)
    springs: dict[str, int] = field(default_factory=dict)

    def of(self, name: str) -> list[Hidden]:
        """Return the hidden effects of a name."""
        return [effect for effect in self.hidden if effect.name == name]


def make_plant(
    xml: str,
    hidden: Sequence[Hidden],
    jitter: float = 0.0,
    seed: int = 0,
    off: tuple[float, float] | None = None,
) -> Plant:
    """Return the model with the effects in it, and numbers that are a little off.

    Args:
        xml: The nominal model.
        hidden: What it lacks.
        jitter: Standard deviation of each number, as a part of its value.
        seed: Of the jitter.
        off: Each number is instead so far off, at least and at most, up or down.
    """
    nominal = mujoco.MjModel.from_xml_string(xml)
    joints = tuple(nominal.joint(i).name for i in range(nominal.njnt))
    for effect in hidden:
        if effect.name == "joint_compliance":
            xml = _with_spring(xml, effect)
    model = mujoco.MjModel.from_xml_string(xml)
    plant = Plant(model, joints, tuple(hidden))
    for joint in joints:
        plant.dofs[joint] = int(model.joint(joint).dofadr[0])
        spring = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, f"{joint}_spring")
        if spring >= 0:
            plant.springs[joint] = int(model.jnt_qposadr[spring])
    _scatter(nominal, plant, jitter, seed, off)
    for effect in hidden:
        _write(plant, effect)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return plant


def _with_spring(xml: str, effect: Hidden) -> str:
    """Split a joint's body in two: a motor without mass, and a link on a spring."""
    root = ElementTree.fromstring(xml)
    for parent in root.iter():
        for place, body in enumerate(list(parent)):
            joint = body.find("joint") if body.tag == "body" else None
            if joint is None or joint.get("name") != effect.target:
                continue
            frame = {k: body.attrib.pop(k) for k in ("pos", "quat") if k in body.attrib}
            motor = ElementTree.Element("body", {"name": f"{effect.target}_motor"})
            motor.attrib |= frame
            tiny = {"pos": "0 0 0", "mass": "1e-6", "diaginertia": "1e-9 1e-9 1e-9"}
            ElementTree.SubElement(motor, "inertial", tiny)
            body.remove(joint)
            motor.append(joint)
            stiffness = 1.0 / effect["compliance"]
            inertia = max(float(joint.get("armature", 0.0)), 1e-4)
            damping = 2 * _SPRING_DAMPING * np.sqrt(stiffness * inertia)
            spring = {
                "name": f"{effect.target}_spring",
                "axis": joint.get("axis", "0 0 1"),
                "stiffness": repr(stiffness),
                "damping": repr(float(damping)),
            }
            body.insert(0, ElementTree.Element("joint", spring))
            motor.append(body)
            parent.remove(body)
            parent.insert(place, motor)
            return ElementTree.tostring(root, encoding="unicode")
    raise LookupError(f"no body turns about {effect.target!r}")


def _scatter(
    nominal: mujoco.MjModel,
    plant: Plant,
    jitter: float,
    seed: int,
    off: tuple[float, float] | None,
) -> None:
    """Multiply masses, inertias, damping, armature and gains by 1 + N(0, jitter)."""
    model, random = plant.model, np.random.default_rng(seed)

    def factor(size: int = 1) -> Any:
        if off is not None:
            return 1.0 + random.choice([-1.0, 1.0], size) * random.uniform(*off, size)
        return 1.0 + jitter * random.standard_normal(size)

    for number in range(1, nominal.nbody):
        body = model.body(nominal.body(number).name).id
        model.body_mass[body] *= factor()[0]
        model.body_inertia[body] *= factor()[0]
    for joint in plant.joints:
        dof = plant.dofs[joint]
        model.dof_damping[dof] *= factor()[0]
        model.dof_armature[dof] *= factor()[0]
        model.dof_frictionloss[dof] *= factor()[0]
    for actuator in range(model.nu):
        stiffness, damping = factor(2)
        model.actuator_gainprm[actuator, 0] *= stiffness
        model.actuator_biasprm[actuator, 1] *= stiffness
        model.actuator_biasprm[actuator, 2] *= damping


def _write(plant: Plant, effect: Hidden) -> None:
    """Change the numbers of the compiled model that an effect changes."""
    model, target = plant.model, effect.target or ""
    dof = plant.dofs.get(target, -1)
    match effect.name:
        case "coulomb_friction":
            model.dof_frictionloss[dof] += effect["frictionloss"]
        case "viscous_damping":
            model.dof_damping[dof] += effect["damping"]
        case "armature":
            model.dof_armature[dof] += effect["armature"]
        case "joint_stiffness":
            joint = model.joint(target)
            joint.stiffness[0] += effect["stiffness"]
            model.qpos_spring[joint.qposadr[0]] = effect["rest"]
        case "actuator_gain":
            actuator = model.actuator(target).id
            model.actuator_gainprm[actuator, 0] *= effect["factor"]
            model.actuator_biasprm[actuator, 1] *= effect["factor"]
        case "torque_limit":
            actuator = model.actuator(target).id
            model.actuator_forcelimited[actuator] = 1
            model.actuator_forcerange[actuator] = (-effect["limit"], effect["limit"])
        case "link_inertia":
            body = model.body(target).id
            model.body_mass[body] *= effect["factor"]
            model.body_inertia[body] *= effect["factor"]
        case "finer_steps":
            model.opt.timestep = effect["timestep"]
        case "payload":
            place = np.array([effect[axis] for axis in "xyz"])
            _hold(model, model.body(target).id, effect["mass"], place)
        case "gravity_tilt":
            roll, pitch = effect["roll"], effect["pitch"]
            # The base turns by roll about x, then by pitch about y; seen from it,
            # gravity turns the other way.
            down = [
                np.sin(pitch),
                -np.cos(pitch) * np.sin(roll),
                -np.cos(pitch) * np.cos(roll),
            ]
            model.opt.gravity[:] = np.linalg.norm(model.opt.gravity) * np.array(down)


def _hold(model: mujoco.MjModel, body: int, mass: float, place: Array) -> None:
    """Weld a small ball to a body: one mass, one centre, one tensor of inertia."""
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    turn = turn.reshape(3, 3)
    inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T
    ball = np.eye(3) * 0.4 * mass * _PAYLOAD_RADIUS**2
    total = model.body_mass[body] + mass
    centre = (model.body_mass[body] * model.body_ipos[body] + mass * place) / total
    whole = np.zeros((3, 3))
    parts = (
        (model.body_mass[body], inertia, model.body_ipos[body] - centre),
        (mass, ball, place - centre),
    )
    for weight, tensor, arm in parts:
        whole += tensor + weight * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    moments, axes = np.linalg.eigh(whole)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    mujoco.mju_mat2Quat(model.body_iquat[body], axes.ravel())
    model.body_inertia[body] = moments
    model.body_ipos[body] = centre
    model.body_mass[body] = total
    # The compiler took short cuts for the frame and inertia that were there.
    model.body_sameframe[body] = model.body_simple[body] = 0
