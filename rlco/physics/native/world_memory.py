"""Memory of the compiled loops for each world, and their working space."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rlco.physics.mj.compiling import inner
from rlco.physics.spec.control import Array, Integers

# Columns of the table of field addresses, one row per world.
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


class Memory(NamedTuple):
    """The state of each of N worlds beyond MuJoCo's.

    With n arm joints, commands of D dimensions for the arm, G actuators of the gripper,
    actions of A dimensions, delays of at most L control steps, nv degrees of freedom
    and nu actuators.
    """

    models: Integers  # addresses of their models, (N,)
    fields: Integers  # addresses of their data and its arrays, (N, 1 + FIELDS)
    observed: Integers  # the same for the states that controllers observe
    posture: Array  # joint positions that the null space attracts to, (N, n), [rad]
    grip: Array  # the gripper's goals in [-1, 1], (N, G)
    stiffness: Array  # (N, D)
    damping: Array  # (N, D)
    delay: Integers  # of commands beyond the control's own [control steps], (N,)
    pending: Array  # commands given and not yet executed, (N, L, A)
    passed: Integers  # last command no longer on its way, where delays are random, (N,)
    seed: Integers  # of the delays of an episode's commands, (N,)
    broken: NDArray[np.bool_]  # diverged: not stepped until reset, (N,)
    fresh: NDArray[np.bool_]  # the next physics step uses the first matrices, (N,)
    first_mass: Array  # (N, n, n), see `set_first_matrices`
    first_jacobian: Array  # (N, 6, n)
    goal: Array  # the tool's position [m], or the joints' [rad], (N, max(3, D))
    goal_rotation: Array  # (N, 3, 3)
    clock: Integers  # physics steps since the reset, (N,)
    action: Array  # the command that arrived last, (N, D + 1)
    unread: NDArray[np.bool_]  # whether it has not been read yet, (N,)
    ctrl: Array  # the lagged commands of actuators, (N, nu)
    friction: Integers  # addresses of their models' dof_frictionloss, (N,)
    coulomb: Array  # its values without friction from effects, (N, nv)


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


@inner
def scratch(control: Any) -> Any:
    """Return working space for worlds under this controller."""
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
