"""The names of robosuite that rlco uses, imported without its start-up noise.

At import robosuite logs a handful of warnings about files that nobody needs, and
Python warns about escape sequences in its docstrings. Its later warnings and
errors pass.
"""

from __future__ import annotations

import logging
import warnings


def _is_news(record: logging.LogRecord) -> bool:
    return False


_logger = logging.getLogger("robosuite_logs")
_logger.addFilter(_is_news)
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
        from robosuite.models.objects import MujocoObject
        from robosuite.models.tasks import ManipulationTask
        from robosuite.robots import ROBOT_CLASS_MAPPING, FixedBaseRobot
        from robosuite.utils.binding_utils import MjSim
        from robosuite.utils.control_utils import nullspace_torques, opspace_matrices
        from robosuite.utils.observables import NO_CORRUPTION, NO_DELAY, NO_FILTER
finally:
    _logger.removeFilter(_is_news)
# Below warnings it repeats which controller file it loads, at every environment.
_logger.setLevel(logging.WARNING)
for _handler in _logger.handlers:
    _handler.setLevel(logging.WARNING)

__all__ = [
    "NO_CORRUPTION",
    "NO_DELAY",
    "NO_FILTER",
    "ROBOT_CLASS_MAPPING",
    "BDGripper",
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
