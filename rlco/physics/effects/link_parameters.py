"""All ten inertial parameters of a link, and what a joint's torque sensor reports.

No search tries these: a calibration fits them, and `torque_scale` is tried between two
recordings of one robot.

A link's mass, centre and rotational inertia are one symmetric matrix, its
pseudo-inertia J (4 x 4). A link that could exist has a positive definite one (Wensing,
Kim and Slotine, RA-L 2018). With J = A A^T for the model's link, the link's J is
A U U^T A^T. U is upper triangular with exponentials on its diagonal, the log-Cholesky
parametrisation of Rucker and Wensing (RA-L 2022) relative to the model: every value of
the ten numbers is a link that could exist, and zero is the model's own.
"""

from __future__ import annotations

import mujoco
import numpy as np

from rlco.errors import RlcoError
from rlco.physics.effects.effect import Array, Effect, Parameter, body_of
from rlco.physics.effects.targets import joints, moving_bodies

#: Half the logarithm of the mass; logarithms of stretches along the link's principal
#: axes; shears; and the shift of the centre, in radii of gyration along these axes.
LINK_NUMBERS = ("mass", "dx", "dy", "dz", "sxy", "sxz", "syz", "x", "y", "z")
_LEAST_MOMENT = 1e-9  # of a link that is a line or a plane, over its largest
_LEAST_MASS = 1e-6  # [kg]
_MOST = 20.0  # of a number: a mass of e^40 times the model's is that of a mountain


def _link_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(name, "", -3.0, 3.0, 0.0, (0.1,), most=_MOST) for name in LINK_NUMBERS
    )


def changed_link(
    mass: float, centre: Array, inertia: Array, values: Array
) -> tuple[float, Array, Array]:
    """Return a link with its ten numbers changed.

    Args:
        mass: Of the link [kg].
        centre: Its centre of mass along its principal axes, (3,) [m].
        inertia: Its principal moments [kg m^2], (3,).
        values: In the order of `LINK_NUMBERS`, (10,).

    Returns:
        The mass, the centre (3,) and the inertia about it (3, 3), along the same axes.

    Example:
        >>> rod = 2.0, np.zeros(3), np.array([0.06, 0.06, 0.001])
        >>> heavier = np.log(1.1) / 2 * np.eye(10)[0]
        >>> mass, centre, inertia = changed_link(*rod, heavier)
        >>> round(mass, 6), centre.tolist(), np.diag(inertia).round(6).tolist()
        (2.2, [0.0, 0.0, 0.0], [0.066, 0.066, 0.0011])
    """
    moments = np.maximum(0.5 * inertia.sum() - inertia, 0.0)
    moments = np.maximum(moments, _LEAST_MOMENT * moments.max())
    own = np.zeros((4, 4))
    own[:3, :3] = np.diag(np.sqrt(moments))
    own[:3, 3], own[3, 3] = np.sqrt(mass) * centre, np.sqrt(mass)
    upper = np.eye(4)
    upper[[0, 1, 2], [0, 1, 2]] = np.exp(values[1:4])
    upper[[0, 0, 1], [1, 2, 2]] = values[4:7]
    upper[:3, 3] = values[7:10]
    factor = np.exp(values[0]) * own @ upper
    pseudo = factor @ factor.T
    mass, place = pseudo[3, 3], pseudo[:3, 3] / pseudo[3, 3]
    second = pseudo[:3, :3] - mass * np.outer(place, place)
    return float(mass), place, np.trace(second) * np.eye(3) - second


def _link_on_spec(spec: mujoco.MjSpec, target: str | None, values: Array) -> None:
    body = body_of(spec, target)
    if not body.explicitinertial:
        message = f"body {target!r} has its mass from its geoms: give it an inertial."
        raise RlcoError(message)
    if body.mass < _LEAST_MASS or not np.any(values):
        return
    turn, inertia = _principal(body)
    centre = turn.T @ np.nan_to_num(np.array(body.ipos))
    mass, centre, whole = changed_link(float(body.mass), centre, inertia, values)
    moments, axes = np.linalg.eigh(turn @ whole @ turn.T)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    frame = np.zeros(4)
    mujoco.mju_mat2Quat(frame, np.ascontiguousarray(axes).ravel())
    body.mass, body.ipos = mass, turn @ centre
    body.fullinertia = np.full(6, np.nan)
    body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    body.iquat, body.inertia = frame, moments


def _principal(body: mujoco.MjsBody) -> tuple[Array, Array]:
    """Return a link's principal axes as columns, (3, 3), and moments, (3,)."""
    full = np.array(body.fullinertia, dtype=float)
    if np.isfinite(full).all():
        xx, yy, zz, xy, xz, yz = full
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        moments, axes = np.linalg.eigh(matrix)
        return axes, moments
    turn = np.zeros(9)
    frame = np.array(body.iquat, dtype=float)
    mujoco.mju_quat2Mat(turn, frame / np.linalg.norm(frame))
    return turn.reshape(3, 3), np.array(body.inertia, dtype=float)


LINK_PARAMETERS = Effect(
    name="link_parameters",
    summary="A link's mass, centre and inertia differ, as one that could exist.",
    signature="A torque that turns with the pose on the joints below, and inertia.",
    confused_with=("link_inertia", "payload"),
    targets=moving_bodies,
    parameters=_link_parameters,
    on_spec=_link_on_spec,
    shown_by=("positions", "torques", "task"),
    tolerances=("mass", "inertia"),
    candidate=False,
)


def _scale_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    return (Parameter("factor", "", 0.01, 100.0, 1.0, (0.75, 1.35)),)


TORQUE_SCALE = Effect(
    name="torque_scale",
    summary="A joint's torque is reported times a factor: a unit, or a gear's ratio.",
    signature="A residual in proportion to the whole torque of a joint.",
    confused_with=("actuator_gain", "payload", "link_inertia"),
    targets=joints,
    parameters=_scale_parameters,
    shown_by=("torques",),
    candidate=False,
)


def _offset_parameters(
    model: mujoco.MjModel, target: str | None
) -> tuple[Parameter, ...]:
    return (Parameter("offset", "N m", -1e3, 1e3, 0.0, (0.1, -0.1)),)


TORQUE_OFFSET = Effect(
    name="torque_offset",
    summary="A joint's torque is reported plus a constant, by gravity or a bad zero.",
    signature="A constant residual of a joint's torque.",
    confused_with=("torque_bias", "payload", "gravity_tilt"),
    targets=joints,
    parameters=_offset_parameters,
    shown_by=("torques",),
    candidate=False,
)
