"""A direct-current servo and its pendulum, as MJCF and as numbers for the kernel."""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.gap.log import Array
from rlco.gap.servo_kernel import Plant
from rlco.physics.effects import Parameter, StepTerms

# The model's own numbers that may differ, each by a part of it. Mass and length of the
# pendulum are known by a scale and a ruler.
OWN = ("damping", "armature", "friction", "gain", "feedback")
#: The name under which they are fitted, with the encoder's zero.
SERVO_NUMBERS = "servo_numbers"


def servo_numbers() -> tuple[Parameter, ...]:
    """Return the parameters of `SERVO_NUMBERS`: five parts and an angle.

    Example:
        >>> [parameter.name for parameter in servo_numbers()]
        ['damping', 'armature', 'friction', 'gain', 'feedback', 'zero']
    """
    parts = tuple(Parameter(name, "", -0.99, 20.0, 0.0, (0.3, -0.3)) for name in OWN)
    return (*parts, Parameter("zero", "rad", -0.5, 0.5, 0.0, (0.02, -0.02)))


def pendulum(
    *,
    mass: float,
    length: float,
    volts: float,
    torque_constant: float,
    resistance: float,
    armature: float,
    damping: float,
    frictionloss: float,
    timestep: float = 0.005,
) -> mujoco.MjSpec:
    """Return a point mass on a massless arm, driven by a direct-current motor.

    Hanging down is zero. The actuator's command is the duty in [-1, 1].

    Args:
        mass: [kg].
        length: [m].
        volts: Of the supply [V].
        torque_constant: Torque for each ampere, behind the gear [N m/A].
        resistance: Of the winding [ohm].
        armature: [kg m^2].
        damping: [N m s/rad].
        frictionloss: [N m].
        timestep: [s].

    Example:
        >>> spec = pendulum(mass=0.5, length=0.1, volts=8.0, torque_constant=0.3,
        ...     resistance=4.0, armature=0.002, damping=0.01, frictionloss=0.01)
        >>> round(float(spec.compile().actuator_gainprm[0, 0]), 3)
        0.6
    """
    stall = torque_constant * volts / resistance
    back_emf = torque_constant**2 / resistance
    return mujoco.MjSpec.from_string(f"""
        <mujoco model="pendulum">
          <option timestep="{timestep}"/>
          <worldbody>
            <body name="arm">
              <joint name="servo" axis="0 -1 0" armature="{armature}"
                     damping="{damping}" frictionloss="{frictionloss}"/>
              <inertial mass="{mass}" pos="0 0 {-length}"
                        diaginertia="1e-9 1e-9 1e-9"/>
            </body>
          </worldbody>
          <actuator>
            <general name="servo" joint="servo" ctrlrange="-1 1" gainprm="{stall}"
                     biastype="affine" biasprm="0 0 {-back_emf}"/>
          </actuator>
        </mujoco>""")


def plant_of(
    nominal: mujoco.MjModel,
    data: mujoco.MjData,
    model: mujoco.MjModel,
    terms: StepTerms,
) -> Plant:
    """Return the kernel's numbers of a model that effects have changed.

    Args:
        nominal: The model before, with the duty's torque; how much stronger the other
            pulls is taken as the firmware's gain.
        data: Of the model before, for scratch.
        model: One hinge with one actuator.
        terms: What acts at each step beside the model.
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
        static=float(terms.static[0]),
        stribeck_speed=float(terms.stribeck_speed[0]),
        load=float(terms.load[0]),
        stall=stall,
        back_emf=-float(model.actuator_biasprm[0, 2]),
        bias=float(model.actuator_biasprm[0, 0]),
        limit=float(model.actuator_forcerange[0, 1]) if limited else np.inf,
        loss=float(terms.drive[0]),
        stiff=float(model.actuator_gainprm[0, 0]) / stall,
    )


def spread_plant(plant: Plant, model: mujoco.MjModel, parts: Array) -> Plant:
    """Return a plant whose model has its own numbers off by these parts."""
    damping, armature, friction, gain, feedback = parts
    return plant._replace(
        damping=plant.damping + damping * float(model.dof_damping[0]),
        inertia=plant.inertia + armature * float(model.dof_armature[0]),
        friction=plant.friction + friction * float(model.dof_frictionloss[0]),
        stall=plant.stall * (1.0 + gain),
        back_emf=plant.back_emf * (1.0 + feedback),
    )
