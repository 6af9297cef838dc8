"""Response of an actuator to its command: gain, lag, limits, losses, bias."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from rlco.physics.effects.effect import (
    Array,
    ControllerTiming,
    Effect,
    Parameter,
    Present,
    actuators_of,
)
from rlco.physics.effects.targets import (
    actuator_of,
    driven_joints,
    holding_torque,
    is_servo,
    servo_joints,
)


def _actuator_gain_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    actuator, present = actuator_of(model, str(target)), None
    if is_servo(model, actuator):
        stiffness = float(model.actuator_gainprm[actuator, 0])
        present = Present(stiffness, "stiffness kp", "N m/rad")
    return (Parameter("factor", "", 0.1, 10.0, 1.0, (0.75, 1.35), present=present),)


def _actuator_gain_on_spec(
    spec: mujoco.MjSpec, target: str | None, values: Array
) -> None:
    for actuator in actuators_of(spec, target):
        gain, bias = np.array(actuator.gainprm), np.array(actuator.biasprm)
        gain[0] *= values[0]
        bias[1] *= values[0]
        actuator.gainprm, actuator.biasprm = gain, bias


ACTUATOR_GAIN = Effect(
    name="actuator_gain",
    summary=(
        "An actuator pulls with another strength: a servo's stiffness kp, or a "
        "motor's torque, times a factor."
    ),
    signature=(
        "Offsets in holds that scale with the load; faster or slower answers to steps."
    ),
    confused_with=("payload", "torque_limit", "encoder_scale", "viscous_damping"),
    targets=driven_joints,
    parameters=_actuator_gain_parameters,
    on_spec=_actuator_gain_on_spec,
    tolerances=("gain",),
)


def _servo_damping_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    damping = -float(model.actuator_biasprm[actuator_of(model, str(target)), 2])
    present = Present(damping, "damping kv", "N m s/rad")
    return (Parameter("factor", "", 0.1, 10.0, 1.0, (0.75, 1.35), present=present),)


def _servo_damping_on_spec(
    spec: mujoco.MjSpec, target: str | None, values: Array
) -> None:
    for actuator in actuators_of(spec, target):
        bias = np.array(actuator.biasprm)
        bias[2] *= values[0]
        actuator.biasprm = bias


SERVO_DAMPING = Effect(
    name="servo_damping",
    summary="A servo damps its joint by another damping kv, within its torque limit.",
    signature="As viscous damping, but gone while the motor is at its limit.",
    confused_with=("viscous_damping", "actuator_gain"),
    targets=servo_joints,
    parameters=_servo_damping_parameters,
    on_spec=_servo_damping_on_spec,
    shown_by=("positions",),
    candidate=False,
)


def _actuator_lag_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    return (Parameter("time_constant", "s", 0.0, 1.0, 0.0, (0.02, 0.1)),)


def lag_part(time_constant: float, timestep: float) -> float:
    """Return the fraction of the remaining distance that a lagging actuator moves.

    This is the exact solution over one step, as in MuJoCo's ``filterexact``. Dividing
    the step by the time constant would add half a step of lag.

    Example:
        >>> lag_part(0.02, 0.0), lag_part(0.0, 0.002)
        (0.0, 1.0)
        >>> round((1.0 - lag_part(0.02, 0.002)) ** 10, 6)  # after 20 ms
        0.367879
    """
    return -math.expm1(-timestep / time_constant) if time_constant > 0.0 else 1.0


def _actuator_lag_on_command(
    commands: Array, column: int | None, timestep: float, values: Array
) -> Array:
    from scipy.signal import lfilter  # seconds, of which most programs need nothing

    commands = commands.copy()
    part = lag_part(float(values[0]), timestep)
    first = commands[0, column]
    filtered = lfilter([part], [1.0, part - 1.0], commands[:, column] - first)
    commands[:, column] = filtered + first
    return commands


def _actuator_lag_on_controller(
    timing: ControllerTiming, actuator: int, timestep: float, values: Array
) -> None:
    timing.lag[actuator] = lag_part(float(values[0]), timestep)


ACTUATOR_LAG = Effect(
    name="actuator_lag",
    summary="An actuator follows its command through a first-order low-pass filter.",
    signature="Amplitude falls and lags more the faster the command moves.",
    confused_with=("command_delay", "viscous_damping", "armature", "velocity_limit"),
    targets=driven_joints,
    parameters=_actuator_lag_parameters,
    on_command=_actuator_lag_on_command,
    on_controller=_actuator_lag_on_controller,
    order=50,
    shown_by=("positions", "servo", "task"),
)


def _torque_limit_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    torque = holding_torque(model, str(target))
    actuator = actuator_of(model, str(target))
    present, known = 100.0 * torque, None
    if model.actuator_forcelimited[actuator]:
        present = float(model.actuator_forcerange[actuator, 1])
        known = Present(present)
    sizes = [part * torque for part in (0.15, 0.3, 0.6, 1.2, 2.5)]
    low = min(0.02 * torque, 0.1 * present)
    starts = tuple(size for size in sizes if size < present) or (0.5 * present,)
    size = ("limit", "N m", low, present, present, starts, False)
    return (Parameter(*size, present=known),)


def _torque_limit_on_spec(
    spec: mujoco.MjSpec, target: str | None, values: Array
) -> None:
    for actuator in actuators_of(spec, target):
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = np.array([-values[0], values[0]])


TORQUE_LIMIT = Effect(
    name="torque_limit",
    summary="An actuator gives at most this torque.",
    signature=(
        "A residual only while the command is far or the load large; clipped "
        "acceleration."
    ),
    confused_with=("actuator_gain", "drive_loss", "velocity_limit"),
    targets=driven_joints,
    parameters=_torque_limit_parameters,
    on_spec=_torque_limit_on_spec,
    shown_by=("positions", "servo", "task"),
    tolerances=("limit",),
)


def _torque_bias_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    torque = holding_torque(model, str(target))
    bound = 5.0 * torque
    starts = (0.1 * torque, -0.1 * torque)
    return (Parameter("torque", "N m", -bound, bound, 0.0, starts),)


def _torque_bias_on_spec(
    spec: mujoco.MjSpec, target: str | None, values: Array
) -> None:
    actuator = actuators_of(spec, target)[0]
    bias = np.array(actuator.biasprm)
    if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:
        bias[:] = 0.0  # a class may have set values that were not read before
    bias[0] += values[0] / actuator.gear[0]
    actuator.biasprm = bias
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE


TORQUE_BIAS = Effect(
    name="torque_bias",
    summary="A constant torque on a joint, of a cable or a badly zeroed drive.",
    signature=(
        "A constant offset of the joint, that shrinks with the servo's stiffness."
    ),
    confused_with=("joint_offset", "joint_stiffness", "gravity_tilt", "payload"),
    targets=driven_joints,
    parameters=_torque_bias_parameters,
    on_spec=_torque_bias_on_spec,
)


def _drive_loss_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    scale = 1.0 / holding_torque(model, str(target))
    starts = (0.1 * scale, 0.4 * scale)
    return (Parameter("loss", "1/(N m)", 0.0, 20.0 * scale, 0.0, starts),)


def _drive_loss(
    position: float,
    velocity: float,
    torque: float,
    carried: float,
    values: Sequence[float],
) -> float:
    kept = 1.0 / (1.0 + values[0] * abs(torque))
    return -(1.0 - kept) * torque


DRIVE_LOSS = Effect(
    name="drive_loss",
    summary=(
        "An actuator's torque T becomes T / (1 + loss |T|), by supply, "
        "resistance or heat."
    ),
    signature="Too little torque where much is asked for, without a sharp limit.",
    confused_with=("torque_limit", "actuator_gain"),
    targets=driven_joints,
    parameters=_drive_loss_parameters,
    torque=_drive_loss,
    shown_by=("positions", "servo", "task"),
)
