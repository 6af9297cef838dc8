"""Servos with published parameters, and the pendulum that a test bench attaches.

A servo here is a DC motor under proportional control: the firmware turns the position
error into a PWM duty, which sets the voltage across the winding (BAM, arXiv
2410.08650). The published parameters are where a search starts, as two servos of one
type differ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rlco.errors import UnknownNameError

#: Prefix of a servo's name, given in place of a model's path.
PREFIX = "bam:"
#: The joint and the actuator of the pendulum.
JOINT = "servo"
TIMESTEP = 0.005
_POINT = 1e-9  # [kg m^2], inertia of a point: MuJoCo requires a positive one


@dataclass(frozen=True)
class Servo:
    """The parameters of one type of servo, all at the output shaft.

    Attributes:
        name: As ``motor`` in BAM's files.
        torque_constant: Torque per ampere [N m/A].
        resistance: Of the winding [ohm].
        armature: Inertia of rotor and gears [kg m^2].
        damping: [N m s/rad].
        frictionloss: [N m].
        duty_gain: Duty per radian of error and unit of the firmware's gain
            [1/rad].
    """

    name: str
    torque_constant: float
    resistance: float
    armature: float
    damping: float
    frictionloss: float
    duty_gain: float

    def stall(self, volts: float) -> float:
        """Return the stall torque at full duty [N m]."""
        return self.torque_constant * volts / self.resistance

    @property
    def back_emf(self) -> float:
        """Torque lost per unit of speed [N m s/rad]."""
        return self.torque_constant**2 / self.resistance


@dataclass(frozen=True)
class Pendulum:
    """The servo's load and supply voltage.

    Attributes:
        mass: At the end of the arm [kg].
        length: Of the arm [m].
        volts: Of the supply [V].
        arm_mass: Of the arm, a rod [kg].
    """

    mass: float
    length: float
    volts: float
    arm_mass: float = 0.0


#: Servos by name. The XL330's: BAM's class m1, published with its recordings
#: (Rhoban/bam, commit af226046); its firmware counts 4096 steps per turn, divides by
#: 256, and has a largest duty of 885 (Dynamixel's manual).
SERVOS = {
    "xl330": Servo(
        name="xl330",
        torque_constant=0.32321138819018436,
        resistance=4.7636501514851926,
        armature=0.001643216859746982,
        damping=0.010494765451601431,
        frictionloss=0.0069659724474934286,
        duty_gain=4096.0 / (2.0 * np.pi) / (256.0 * 885.0),
    )
}


def servo_named(name: str) -> Servo:
    """Return a servo by its name.

    Raises:
        UnknownNameError: There is no such servo.

    Example:
        >>> servo_named("xl330").resistance > 4.0
        True
    """
    if name not in SERVOS:
        raise UnknownNameError("servo", name, tuple(SERVOS))
    return SERVOS[name]


def pendulum_xml(servo: Servo, pendulum: Pendulum, *, zero: float = 0.0) -> str:
    """Return the MJCF of a servo that drives a pendulum.

    The actuator's command is the duty in [-1, 1].

    Args:
        servo: The servo's parameters.
        pendulum: Its load.
        zero: The encoder's reading where the pendulum hangs down [rad].

    Example:
        >>> import mujoco
        >>> xml = pendulum_xml(SERVOS["xl330"], Pendulum(0.49, 0.1, volts=5.0))
        >>> model = mujoco.MjModel.from_xml_string(xml)
        >>> round(float(model.actuator_gainprm[0, 0]), 3)  # N m at full duty
        0.339
    """
    mass, place, inertia = (f"{number:.12g}" for number in _load(pendulum))
    stall, point = f"{servo.stall(pendulum.volts):.12g}", f"{_POINT:g}"
    ref = f' ref="{zero:.12g}"' if zero else ""
    return f"""\
<mujoco model="{servo.name}">
  <compiler angle="radian"/>
  <option timestep="{TIMESTEP}"/>
  <worldbody>
    <body name="arm">
      <joint name="{JOINT}" axis="0 -1 0"{ref} armature="{servo.armature:.12g}"
             damping="{servo.damping:.12g}" frictionloss="{servo.frictionloss:.12g}"/>
      <inertial mass="{mass}" pos="0 0 -{place}"
                diaginertia="{inertia} {inertia} {point}"/>
    </body>
  </worldbody>
  <actuator>
    <general name="{JOINT}" joint="{JOINT}" ctrlrange="-1 1"
             gainprm="{stall}" biastype="affine" biasprm="0 0 {-servo.back_emf:.12g}"/>
  </actuator>
</mujoco>
"""


def _load(pendulum: Pendulum) -> tuple[float, float, float]:
    """Return mass, distance, and inertia about the centre of mass of tip and rod."""
    tip, rod, length = pendulum.mass, pendulum.arm_mass, pendulum.length
    mass = tip + rod
    place = length * (tip + rod / 2.0) / mass
    # About the joint: m l^2 of the tip, m l^2 / 3 of the rod.
    inertia = (tip + rod / 3.0) * length**2 - mass * place**2
    return mass, place, max(inertia, _POINT)
