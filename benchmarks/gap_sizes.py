"""How large a hidden effect is: typical sizes, by the robot's own torques and speeds.

Severity 1 is typical, 0.5 and 2 are half and twice of that. Sizes come from what the
nominal model does in the case's own motion, so that an effect is as easy to see on a
shoulder as on a wrist.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from gap_arms import TIMESTEP, Arm, Array
from gap_plant import Hidden

Random = np.random.Generator

#: In the library and possible on an arm in free space.
IN_LIBRARY = (
    "coulomb_friction",
    "viscous_damping",
    "stribeck_friction",
    "load_friction",
    "armature",
    "payload",
    "link_inertia",
    "actuator_gain",
    "actuator_lag",
    "torque_limit",
    "velocity_limit",
    "command_delay",
    "joint_offset",
    "encoder_scale",
    "joint_stiffness",
    "torque_bias",
    "backlash",
    "joint_compliance",
    "gravity_tilt",
    "control_rate",
    "drive_loss",
)
#: In the library, and tried where all of the above leave something. The names are the
#: plant's: a ripple is cogging of one wave, and friction by direction is named as
#: Coulomb friction with a constant torque, which it equals.
UNCOMMON = ("cogging", "torque_ripple", "hardening_spring", "directional_friction")
#: In no library when the list of cases was written; two of them are uncommon now.
OUTSIDE = (
    "torque_ripple",
    "cogging",
    "encoder_eccentricity",
    "slow_drift",
    "dropped_commands",
    "external_push",
    "repeated_frames",
    "finer_steps",
)
#: Of `OUTSIDE`, what acts at one joint as a torque or a position, and is in no library.
OUTSIDE_AT_JOINT = ("encoder_eccentricity", "slow_drift", "external_push")
_WHOLE_ROBOT = ("command_delay", "gravity_tilt", "control_rate")
_WHOLE_ROBOT += ("dropped_commands", "repeated_frames", "finer_steps", "random_delay")


@dataclass(frozen=True)
class Usual:
    """What the nominal model does in a case's motion, a number a joint.

    Attributes:
        torque: Root mean square of the actuator's torque, (joints,) [N m].
        high: Quantiles 0.80, 0.90 and 0.96 of its size, (3, joints) [N m].
        speed: Root mean square, (joints,) [rad/s].
        fast: Quantile 0.98 of speed, (joints,) [rad/s].
        inertia: At the home pose, (joints,) [kg m^2].
    """

    torque: Array
    high: Array
    speed: Array
    fast: Array
    inertia: Array


def usual(arm: Arm, torque: Array, speed: Array) -> Usual:
    """Return what a motion asks of an arm, from all its episodes, (rows, joints)."""
    model = mujoco.MjModel.from_xml_string(arm.xml)
    data = mujoco.MjData(model)
    data.qpos[:] = arm.home
    mujoco.mj_forward(model, data)
    whole = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, whole, data.qM)
    return Usual(
        np.sqrt((torque**2).mean(0)),
        np.quantile(np.abs(torque), (0.80, 0.90, 0.96), axis=0),
        np.sqrt((speed**2).mean(0)),
        np.quantile(np.abs(speed), 0.98, axis=0),
        np.diag(whole).copy(),
    )


def draw(name: str, arm: Arm, used: Usual, severity: float, random: Random) -> Hidden:
    """Return an effect of a typical size at a random place.

    Args:
        name: One of `IN_LIBRARY`, `UNCOMMON` or `OUTSIDE`, or ``random_delay``.
        arm: The robot.
        used: What the motion asks of it.
        severity: 1 for the typical size; a random delay has its own.
        random: Decides on the place, the sign and a third of the size.
    """
    outside = name in OUTSIDE and name not in UNCOMMON
    joints = arm.joints
    size = severity * random.uniform(0.85, 1.15)
    sign = float(random.choice([-1.0, 1.0]))
    column = int(random.integers(len(joints)))
    target: str | None = joints[column]
    if name in _WHOLE_ROBOT:
        target = None
    elif name == "payload":
        target = arm.hand
    elif name == "link_inertia":
        bodies = [n for n in range(len(joints)) if _heavy(arm, joints[n])]
        column = int(random.choice(bodies))
        target = _body(arm, joints[column])
    numbers = _numbers(name, arm, used, column, size, sign, random)
    return Hidden(name, target, numbers, outside)


def _numbers(
    name: str,
    arm: Arm,
    used: Usual,
    column: int,
    size: float,
    sign: float,
    random: Random,
) -> dict[str, float]:
    torque, inertia = float(used.torque[column]), float(used.inertia[column])
    level = {0: 2, 1: 1, 2: 0}[int(np.clip(round(np.log2(size) + 1), 0, 2))]
    match name:
        case "coulomb_friction":
            return {"frictionloss": 0.3 * torque * size}
        case "viscous_damping":
            return {"damping": 0.3 * torque / float(used.speed[column]) * size}
        case "stribeck_friction":
            return {"static": 0.5 * torque * size, "speed": random.uniform(0.06, 0.2)}
        case "load_friction":
            return {"ratio": 0.12 * size}
        case "armature":
            return {"armature": 0.5 * inertia * size}
        case "payload":
            place = arm.grip + random.uniform(-0.02, 0.02, 3)
            mass = 0.08 * _moving_mass(arm) * size
            return {"mass": mass, **dict(zip("xyz", place.tolist(), strict=True))}
        case "link_inertia":
            return {"factor": (1.0 + 0.4 * size) ** sign}
        case "actuator_gain":
            return {"factor": (1.0 + 0.35 * size) ** sign}
        case "actuator_lag":
            return {"time_constant": 0.03 * size}
        case "torque_limit":
            return {"limit": float(used.high[level, column])}
        case "velocity_limit":
            part = (0.45, 0.65, 0.85)[level]
            return {"limit": part * float(used.fast[column])}
        case "command_delay":
            return {"delay": _whole_steps(0.03 * size)}
        case "random_delay":
            mean = random.uniform(0.005, 0.030)
            return {"mean": mean, "spread": mean * random.uniform(0.4, 1.0)}
        case "joint_offset":
            return {"offset": sign * 0.05 * size}
        case "encoder_scale":
            return {"factor": (1.0 + 0.06 * size) ** sign}
        case "joint_stiffness":
            rest = float(arm.home[column] + random.uniform(-0.8, 0.8))
            return {"stiffness": 0.6 * torque * size, "rest": rest}
        case "torque_bias":
            return {"torque": sign * 0.3 * torque * size}
        case "backlash":
            return {"width": 0.025 * size}
        case "joint_compliance":
            return {"compliance": 0.015 / torque * size}
        case "gravity_tilt":
            angle = random.uniform(0.0, 2 * np.pi)
            tilt = 0.06 * size
            return {"roll": tilt * np.cos(angle), "pitch": tilt * np.sin(angle)}
        case "control_rate":
            return {"period": _whole_steps(0.06 * size)}
        case "drive_loss":
            return {"loss": 0.3 / torque * size}
    phase = random.uniform(0.0, 2 * np.pi)
    match name:
        case "torque_ripple":
            count = 2 * np.pi / random.uniform(0.3, 0.6)
            return {"amplitude": 0.5 * torque * size, "count": count, "phase": phase}
        case "cogging":
            poles = float(random.choice([18, 24, 30]))
            return {"amplitude": 0.5 * torque * size, "count": poles, "phase": phase}
        case "hardening_spring":
            rest = float(arm.home[column] + random.uniform(-0.3, 0.3))
            return {"hardening": 4.0 * torque * size, "rest": rest}
        case "directional_friction":
            mean, part = 0.3 * torque * size, random.uniform(0.3, 0.7)
            return {"frictionloss": mean, "torque": sign * part * mean}
        case "encoder_eccentricity":
            return {"amplitude": 0.06 * size, "phase": phase}
        case "slow_drift":
            return {"amplitude": 0.6 * torque * size}
        case "dropped_commands":
            return {"share": 0.2 * min(size, 2.5)}
        case "external_push":
            return {"amplitude": 2.0 * torque * size, "seconds": 0.25, "knocks": 3.0}
        case "repeated_frames":
            return {"share": 0.15 * min(size, 2.5)}
        case "finer_steps":
            return {"timestep": TIMESTEP / 4}
    raise KeyError(f"no effect {name!r}")


def _whole_steps(seconds: float) -> float:
    """Return a time that the plant can keep exactly."""
    return TIMESTEP * round(seconds / TIMESTEP)


def _body(arm: Arm, joint: str) -> str:
    model = mujoco.MjModel.from_xml_string(arm.xml)
    return str(model.body(model.joint(joint).bodyid[0]).name)


def _heavy(arm: Arm, joint: str) -> bool:
    """Return whether the link that a joint turns has mass in the compiled model."""
    model = mujoco.MjModel.from_xml_string(arm.xml)
    return bool(model.body_mass[model.joint(joint).bodyid[0]] > 0)


def _moving_mass(arm: Arm) -> float:
    model = mujoco.MjModel.from_xml_string(arm.xml)
    moving = model.body_weldid != 0
    return float(model.body_mass[moving].sum())
