"""What the compiled loops keep of each copy, and their working space."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from rlco.physics.arm_control import Array, Integers

# Columns of the table of field addresses, one row a copy.
FIELDS = (
    "qpos",
    "qvel",
    "ctrl",
    "qfrc_bias",
    "qM",
    "site_xpos",
    "site_xmat",
    "xpos",
    "xquat",
    "mocap_pos",
    "mocap_quat",
    "qfrc_actuator",
    "qfrc_applied",
)
_COLUMN = {name: i + 1 for i, name in enumerate(FIELDS)}  # 0: mjData itself
(QPOS, QVEL, CTRL, BIAS, MASS, SITE_POS, SITE_MAT, POS, QUAT) = (
    _COLUMN[name] for name in FIELDS[:9]
)
MOCAP_POS, MOCAP_QUAT = _COLUMN["mocap_pos"], _COLUMN["mocap_quat"]
ACTUATION, APPLIED = _COLUMN["qfrc_actuator"], _COLUMN["qfrc_applied"]
# Beyond this, as MuJoCo has it, a number is as good as NaN (its mjMAXVAL).
TOO_LARGE = 1e10


class Memory(NamedTuple):
    """What each of N copies has of its own beside MuJoCo's state.

    With n arm joints, D numbers that command the arm, G actuators of the gripper,
    actions of A numbers, delays of at most L control steps, nv degrees of freedom and
    nu actuators.
    """

    models: Integers  # addresses of their models, (N,)
    fields: Integers  # addresses of their data and its arrays, (N, 1 + FIELDS)
    seen: Integers  # the same of what the controller takes the state to be
    posture: Array  # where the null space pulls the arm, (N, n), [rad]
    grip: Array  # the gripper's goals in [-1, 1], (N, G)
    stiffness: Array  # (N, D)
    damping: Array  # (N, D)
    delay: Integers  # control steps between a command and its execution, (N,)
    pending: Array  # commands given and not yet executed, (N, L, A)
    broken: NDArray[np.bool_]  # diverged: not stepped until reset, (N,)
    fresh: NDArray[np.bool_]  # the next physics step takes the first matrices, (N,)
    first_mass: Array  # (N, n, n), see `set_first_matrices`
    first_jacobian: Array  # (N, 6, n)
    goal: Array  # the tool's place [m], or the joints' [rad], (N, max(3, D))
    goal_rotation: Array  # (N, 3, 3)
    clock: Integers  # physics steps since the reset, (N,)
    action: Array  # the command that has arrived last, (N, D + 1)
    unread: NDArray[np.bool_]  # and is not read yet, (N,)
    ctrl: Array  # what lagging actuators have come to, (N, nu)
    friction: Integers  # addresses of their models' dof_frictionloss, (N,)
    coulomb: Array  # and what it is without friction of the effects', (N, nv)


class Scratch(NamedTuple):
    """Working space of one thread."""

    action: Array
    mass: Array
    jacobian: Array
    arm_jacobian: Array
    bias: Array
    torque: Array
    null: Array
    qpos: Array
    qvel: Array
    wanted: Array
    velocity: Array
    error: Array
    move: Array


@njit(nogil=True, cache=True)
def scratch(control: Any) -> Any:
    """Return working space for copies under this control."""
    n, moves = control.arm_dof.shape[0], control.inputs.shape[1]
    return Scratch(
        np.empty(moves + 1),
        np.empty((n, n)),
        np.zeros((6, control.nv)),
        np.empty((6, n)),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(6),
        np.empty(6),
        np.empty(3),
        np.empty(moves),
    )
