"""The controller of one arm and its gripper, as values for compiled loops."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rlco.physics.effects.corrected_model import Acting

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


class Control(NamedTuple):
    """One arm's controller and gripper, as compiled loops read them.

    With n arm joints, commands of D dimensions for the arm (6, or n) and G actuators of
    the gripper.
    """

    joint_position: bool  # JOINT_POSITION rather than OSC_POSE
    base_frame: bool  # deltas along the axes of the arm's base, or the world's
    exact: bool  # robosuite's own linear algebra
    site: int  # the tool
    nq: int
    nv: int
    nm: int  # size of MuJoCo's sparse mass matrix
    nu: int
    substeps: int  # physics steps per control step
    arm_qpos: Integers  # (n,)
    arm_dof: Integers  # (n,)
    arm_ctrl: Integers  # (n,)
    mass_address: Integers  # dof_Madr, (nv,)
    parent: Integers  # dof_parentid, (nv,)
    arm_range: Array  # limits of the arm's actuators, (n, 2), [N m]
    inputs: Array  # lowest, highest, middle, scale, middle of the output; (5, D)
    origin: Array  # controller's base: position (3), rotation (9)
    finger_ctrl: Integers  # (G,)
    finger_range: Array  # (G, 2)
    finger_step: Array  # change of each goal per control step when closing, (G,)
    acting: Acting  # effects in each physics step

    @property
    def action_size(self) -> int:
        """Size of an action."""
        return int(self.inputs.shape[1]) + bool(self.finger_ctrl.size)
