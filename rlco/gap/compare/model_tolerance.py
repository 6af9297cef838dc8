"""Model tolerance: every parameter of a model may be a few per cent off.

A model that is slightly wrong everywhere leaves a residual that some single effect
would seem to explain. Therefore all parameters below may vary, each with a prior of a
few per cent, before an effect is named.
"""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.physics.effects.targets import ONE_AXIS, actuated_joint


def tolerance_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return ``kind:name`` for each nonzero parameter of a model.

    An actuator's parameters carry the name of its joint, as its effects do.

    Example:
        >>> model = mujoco.MjModel.from_xml_string(
        ...     "<mujoco><worldbody><body name='arm'><joint name='j' damping='1'/>"
        ...     "<geom size='0.1'/></body></worldbody>"
        ...     "<actuator><position name='servo' joint='j'/></actuator></mujoco>")
        >>> tolerance_names(model)
        ('mass:arm', 'inertia:arm', 'damping:j', 'gain:j')
    """
    names = []
    for body in range(1, model.nbody):
        if model.body_mass[body] > 0 and model.body_weldid[body] != 0:
            name = model.body(body).name
            names += [f"mass:{name}", f"inertia:{name}"]
    for joint in range(model.njnt):
        if model.jnt_type[joint] not in ONE_AXIS:
            continue
        dof, name = model.jnt_dofadr[joint], model.joint(joint).name
        for kind, field in (
            ("damping", model.dof_damping),
            ("armature", model.dof_armature),
            ("friction", model.dof_frictionloss),
        ):
            if field[dof] > 0:
                names.append(f"{kind}:{name}")
    for actuator in range(model.nu):
        driven = actuated_joint(model, actuator)
        if driven is None:
            continue
        names.append(f"gain:{driven}")
        if model.actuator_biasprm[actuator, 2] < 0:
            names.append(f"feedback:{driven}")
        if model.actuator_forcelimited[actuator]:
            names.append(f"limit:{driven}")
    return tuple(dict.fromkeys(names))


def apply_tolerance(
    spec: mujoco.MjSpec, names: tuple[str, ...], parts: tuple[float, ...]
) -> None:
    """Multiply each parameter by one plus its relative change, in place."""
    for full, part in zip(names, parts, strict=True):
        if part == 0.0:
            continue
        kind, name = full.split(":", 1)
        _scale(spec, kind, name, 1.0 + part)


def _scale(spec: mujoco.MjSpec, kind: str, name: str, factor: float) -> None:
    if kind in ("mass", "inertia"):
        body = spec.body(name)
        if kind == "mass":
            body.mass *= factor
        elif np.isfinite(body.fullinertia).all():
            body.fullinertia = np.array(body.fullinertia) * factor
        else:
            body.inertia = np.array(body.inertia) * factor
    elif kind in ("damping", "armature", "friction"):
        joint = spec.joint(name)
        if kind == "damping":
            joint.damping = np.array(joint.damping, dtype=float) * factor
        elif kind == "armature":
            joint.armature *= factor
        else:
            joint.frictionloss *= factor
    else:
        for actuator in spec.actuators:
            joint = actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT
            if joint and actuator.target == name:
                _scale_actuator(actuator, kind, factor)


def _scale_actuator(actuator: mujoco.MjsActuator, kind: str, factor: float) -> None:
    if kind == "limit":
        actuator.forcerange = np.array(actuator.forcerange) * factor
        return
    gain, bias = np.array(actuator.gainprm), np.array(actuator.biasprm)
    if kind == "gain":
        gain[0] *= factor
        bias[1] *= factor
    else:
        bias[2] *= factor
    actuator.gainprm, actuator.biasprm = gain, bias
