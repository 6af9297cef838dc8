"""A DC servo and its pendulum, as parameters for the kernel."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np

from rlco.gap.compare.servo.kernel import Plant
from rlco.gap.logs.log import Array
from rlco.gap.servo_models import Servo
from rlco.physics.effects import AppliedEffect, Parameter
from rlco.physics.effects.step_forces import StepForces

# The model's own parameters that may differ, each by a relative amount. The pendulum's
# mass and length are measured with a scale and a ruler.
OWN = ("damping", "armature", "friction", "gain", "feedback")
#: The name under which they are fitted, with the encoder's zero.
SERVO_NUMBERS = "servo_numbers"


def servo_numbers() -> tuple[Parameter, ...]:
    """Return the parameters of `SERVO_NUMBERS`: five relative ones and an angle.

    Example:
        >>> [parameter.name for parameter in servo_numbers()]
        ['damping', 'armature', 'friction', 'gain', 'feedback', 'zero']
    """
    parts = tuple(Parameter(name, "", -0.99, 20.0, 0.0, (0.3, -0.3)) for name in OWN)
    return (*parts, Parameter("zero", "rad", -0.5, 0.5, 0.0, (0.02, -0.02)))


def fitted_servo(servo: Servo, effects: Iterable[AppliedEffect]) -> tuple[Servo, float]:
    """Return a servo with its own parameters as fitted, and its encoder's zero [rad].

    Stall torque ``k V / R`` and back-EMF ``k^2 / R`` determine the torque constant k
    and the resistance R. Six digits are kept, which exceeds the accuracy of any
    measurement.

    Args:
        servo: Its published parameters.
        effects: Only those of `SERVO_NUMBERS` among them are used.

    Example:
        >>> parts = {name: 0.0 for name in OWN} | {"gain": 0.25, "zero": 0.02}
        >>> own = AppliedEffect(SERVO_NUMBERS, "servo", parts)
        >>> servo = Servo("a", 1.0, 2.0, 0.001, 0.01, 0.02, 0.003)
        >>> fitted, zero = fitted_servo(servo, [own])
        >>> fitted.stall(8.0) / servo.stall(8.0), round(fitted.back_emf, 6), zero
        (1.25, 0.5, 0.02)
    """
    numbers = dict.fromkeys((*OWN, "zero"), 0.0)
    for effect in effects:
        if effect.name == SERVO_NUMBERS:
            numbers |= effect.parameters
    gain, feedback = 1.0 + numbers["gain"], 1.0 + numbers["feedback"]
    fitted = Servo(
        servo.name,
        torque_constant=_short(servo.torque_constant * feedback / gain),
        resistance=_short(servo.resistance * feedback / gain**2),
        armature=_short(servo.armature * (1.0 + numbers["armature"])),
        damping=_short(servo.damping * (1.0 + numbers["damping"])),
        frictionloss=_short(servo.frictionloss * (1.0 + numbers["friction"])),
        duty_gain=servo.duty_gain,
    )
    return fitted, _short(numbers["zero"])


def _short(number: float) -> float:
    return float(f"{number:.6g}")


def plant_of(
    nominal: mujoco.MjModel,
    data: mujoco.MjData,
    model: mujoco.MjModel,
    forces: StepForces,
) -> Plant:
    """Return the kernel's parameters of a model that effects have changed.

    Args:
        nominal: The model before the effects. A change of its actuator's gain is
            taken as a change of the firmware's gain.
        data: Scratch data of the nominal model.
        model: One hinge with one actuator.
        forces: Forces applied at each step besides the model's.
    """
    if model.nbody != nominal.nbody:
        data = mujoco.MjData(model)
    weights, weight = [], np.zeros(1)
    for angle in (0.5 * np.pi, 0.0):
        data.qpos[0] = angle
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_rne(model, data, 0, weight)
        weights.append(float(weight[0]))
    limited = bool(model.actuator_forcelimited[0])
    stall = float(nominal.actuator_gainprm[0, 0])
    return Plant(
        inertia=float(data.qM[0]),
        gravity_sin=weights[0],
        gravity_cos=weights[1],
        stiffness=float(model.jnt_stiffness[0]),
        rest=float(model.qpos_spring[0]),
        damping=float(model.dof_damping[0]),
        friction=float(model.dof_frictionloss[0]),
        stall=stall,
        back_emf=-float(model.actuator_biasprm[0, 2]),
        bias=float(model.actuator_biasprm[0, 0]),
        limit=float(model.actuator_forcerange[0, 1]) if limited else np.inf,
        forces=forces,
        stiff=float(model.actuator_gainprm[0, 0]) / stall,
    )


def tolerance_plant(plant: Plant, model: mujoco.MjModel, parts: Array) -> Plant:
    """Return a plant whose own parameters are off by these relative amounts."""
    damping, armature, friction, gain, feedback = parts
    return plant._replace(
        damping=plant.damping + damping * float(model.dof_damping[0]),
        inertia=plant.inertia + armature * float(model.dof_armature[0]),
        friction=plant.friction + friction * float(model.dof_frictionloss[0]),
        stall=plant.stall * (1.0 + gain),
        back_emf=plant.back_emf * (1.0 + feedback),
    )
