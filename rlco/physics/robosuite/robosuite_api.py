"""The names of robosuite that rlco uses, imported without start-up messages.

At import robosuite logs several warnings about files that are not needed, and Python
warns about escape sequences in its docstrings. Later warnings and errors are not
suppressed.
"""

from __future__ import annotations

import logging
import warnings


def _is_relevant(record: logging.LogRecord) -> bool:
    return False


_logger = logging.getLogger("robosuite_logs")
_logger.addFilter(_is_relevant)
try:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SyntaxWarning)
        import robosuite
        from robosuite.controllers import load_composite_controller_config
        from robosuite.controllers.parts.arm.osc import OperationalSpaceController
        from robosuite.controllers.parts.generic.joint_pos import (
            JointPositionController,
        )
        from robosuite.controllers.parts.gripper.simple_grip import SimpleGripController
        from robosuite.environments.manipulation.manipulation_env import ManipulationEnv
        from robosuite.environments.manipulation.two_arm_env import TwoArmEnv
        from robosuite.models.arenas import TableArena
        from robosuite.models.base import MujocoModel
        from robosuite.models.grippers import (
            BDGripper,
            JacoThreeFingerGripper,
            NullGripper,
            PandaGripper,
            RethinkGripper,
            Robotiq85Gripper,
            Robotiq140Gripper,
            WipingGripper,
        )
        from robosuite.models.objects import BoxObject, CylinderObject, MujocoObject
        from robosuite.models.tasks import ManipulationTask
        from robosuite.robots import ROBOT_CLASS_MAPPING, FixedBaseRobot
        from robosuite.utils.binding_utils import MjSim
        from robosuite.utils.control_utils import nullspace_torques, opspace_matrices
        from robosuite.utils.observables import NO_CORRUPTION, NO_DELAY, NO_FILTER
finally:
    _logger.removeFilter(_is_relevant)
# Below warnings, every environment logs its controller file.
_logger.setLevel(logging.WARNING)
for _handler in _logger.handlers:
    _handler.setLevel(logging.WARNING)

__all__ = [
    "NO_CORRUPTION",
    "NO_DELAY",
    "NO_FILTER",
    "ROBOT_CLASS_MAPPING",
    "BDGripper",
    "BoxObject",
    "CylinderObject",
    "FixedBaseRobot",
    "JacoThreeFingerGripper",
    "JointPositionController",
    "ManipulationEnv",
    "ManipulationTask",
    "MjSim",
    "MujocoModel",
    "MujocoObject",
    "NullGripper",
    "OperationalSpaceController",
    "PandaGripper",
    "RethinkGripper",
    "Robotiq85Gripper",
    "Robotiq140Gripper",
    "SimpleGripController",
    "TableArena",
    "TwoArmEnv",
    "WipingGripper",
    "load_composite_controller_config",
    "nullspace_torques",
    "opspace_matrices",
    "robosuite",
]
