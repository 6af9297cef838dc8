"""Read the parameters of robosuite's controllers of one arm and its gripper.

`read_control` takes them from a robosuite environment. It refuses, by name, whatever
the compiled loops of `rlco.physics.native.arm_kernels` do not compute.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rlco.errors import RlcoError
from rlco.physics.robosuite.effect_sim import corrected_model_of
from rlco.physics.robosuite.robosuite_api import (
    BDGripper,
    FixedBaseRobot,
    JacoThreeFingerGripper,
    JointPositionController,
    NullGripper,
    OperationalSpaceController,
    PandaGripper,
    RethinkGripper,
    Robotiq85Gripper,
    Robotiq140Gripper,
    SimpleGripController,
    WipingGripper,
)
from rlco.physics.spec.control import Array, Control, Integers

# Direction of each actuator when a gripper closes.
FINGER_DIRECTIONS: dict[type, tuple[float, ...]] = {
    BDGripper: (1.0,),
    JacoThreeFingerGripper: (-1.0, -1.0, -1.0),
    NullGripper: (),
    PandaGripper: (-1.0, 1.0),
    RethinkGripper: (1.0, -1.0),
    Robotiq140Gripper: (1.0, -1.0),
    Robotiq85Gripper: (1.0, 1.0),
    WipingGripper: (),
}


def read_control(env: Any, *, exact: bool) -> Control:
    """Return the controller of a robosuite environment, after its reset.

    Args:
        env: A robosuite environment with one arm on a fixed base.
        exact: Compute torques with robosuite's own linear algebra.

    Raises:
        RlcoError: If the environment has an unsupported feature, which is named.
    """
    refuse_unsupported(env)
    robot = env.robots[0]
    name = robot.arms[0]
    arm, gripper = robot.part_controllers[name], robot.gripper[name]
    model = env.sim.model._model
    joint_position = isinstance(arm, JointPositionController)
    fingers = integers(robot._ref_joint_gripper_actuator_indexes[name] or [])
    arm_ctrl = integers(robot._ref_actuators_indexes_dict[name])
    substeps = int(env.control_timestep / env.model_timestep)
    origin, rotation = robot.composite_controller.get_controller_base_pose(name)
    inputs = [
        arm.input_min,
        arm.input_max,
        (arm.input_max + arm.input_min) / 2.0,
        abs(arm.output_max - arm.output_min) / abs(arm.input_max - arm.input_min),
        (arm.output_max + arm.output_min) / 2.0,
    ]
    return Control(
        joint_position=joint_position,
        base_frame=not joint_position and arm.input_ref_frame == "base",
        exact=exact,
        site=int(robot.eef_site_id[name]),
        nq=int(model.nq),
        nv=int(model.nv),
        nm=int(model.nM),
        nu=int(model.nu),
        substeps=substeps,
        arm_qpos=integers(arm.qpos_index),
        arm_dof=integers(arm.qvel_index),
        arm_ctrl=arm_ctrl,
        mass_address=integers(model.dof_Madr),
        parent=integers(model.dof_parentid),
        arm_range=model.actuator_ctrlrange[arm_ctrl].copy(),
        inputs=np.stack(inputs).astype(np.float64),
        origin=np.concatenate([origin, np.ravel(rotation)]),
        finger_ctrl=fingers,
        finger_range=model.actuator_ctrlrange[fingers].reshape(-1, 2).copy(),
        finger_step=gripper.speed * np.array(FINGER_DIRECTIONS[type(gripper)]),
        acting=corrected_model_of(env.sim).acting(substeps),
    )


def read_gains(env: Any) -> tuple[Array, Array]:
    """Return stiffness and damping of the arm's controller, each shape (D,)."""
    arm = env.robots[0].part_controllers[env.robots[0].arms[0]]
    return np.array(arm.kp, dtype=np.float64), np.array(arm.kd, dtype=np.float64)


def integers(values: Any) -> Integers:
    """Return indices in the type of the compiled loops."""
    return np.array(values, dtype=np.int64)


def refuse_unsupported(env: Any) -> None:
    """Refuse environments where the compiled loops would differ from robosuite.

    Raises:
        RlcoError: If a feature is not supported; it is named.
    """
    name = type(env).__name__
    if len(env.robots) != 1 or len(env.robots[0].arms) != 1:
        raise RlcoError(
            f"{name}: the native backend does not support more than one arm; use an "
            "environment with one."
        )
    robot = env.robots[0]
    if type(robot) is not FixedBaseRobot:
        raise _unsupported(
            name, f"the base of {robot.name} ({type(robot).__name__})", "fix the base"
        )
    if not env.lite_physics:
        raise _unsupported(name, "lite_physics=False", "leave it at True")
    if type(robot.composite_controller).name != "BASIC":
        raise _unsupported(
            name,
            f"the composite controller {type(robot.composite_controller).name}",
            "use BASIC",
        )
    arm, gripper = robot.arms[0], robot.get_gripper_name(robot.arms[0])
    other = sorted(set(robot.part_controllers) - {arm, gripper})
    if other:
        raise _unsupported(name, f"the controlled parts {other}", "control one arm")
    _refuse_arm(name, robot.part_controllers[arm])
    model = env.sim.model._model
    frame = model.site(f"{robot.robot_model.naming_prefix}{arm}_center").bodyid[0]
    if model.body_weldid[frame] != 0:
        raise _unsupported(
            name,
            f"{robot.name}, whose controller's frame moves with its joints",
            "use another arm",
        )
    _refuse_gripper(name, robot.gripper[arm], robot.part_controllers.get(gripper))


def _refuse_arm(name: str, arm: Any) -> None:
    advice = "use OSC_POSE or JOINT_POSITION as robosuite configures them"
    known = (OperationalSpaceController, JointPositionController)
    if type(arm) not in known or arm.name not in ("OSC_POSE", "JOINT_POSITION"):
        raise _unsupported(name, f"the controller {arm.name}", advice)
    osc = isinstance(arm, OperationalSpaceController)
    interpolators = (
        [arm.interpolator_pos, arm.interpolator_ori] if osc else [arm.interpolator]
    )
    limits = [arm.position_limits, arm.orientation_limits if osc else None]
    for what, found in (
        (f"impedance_mode={arm.impedance_mode!r}", arm.impedance_mode != "fixed"),
        (f"input_type={arm.input_type!r}", arm.input_type != "delta"),
        ("interpolation", any(i is not None for i in interpolators)),
        ("limits of the goal", any(limit is not None for limit in limits)),
        ("uncouple_pos_ori=False", osc and not arm.uncoupling),
    ):
        if found:
            raise _unsupported(name, f"{what} of {arm.name}", advice)


def _refuse_gripper(name: str, gripper: Any, controller: Any) -> None:
    if type(gripper) not in FINGER_DIRECTIONS:
        known = ", ".join(sorted(kind.__name__ for kind in FINGER_DIRECTIONS))
        raise _unsupported(
            name, f"the gripper {type(gripper).__name__}", f"use one of {known}"
        )
    if not FINGER_DIRECTIONS[type(gripper)]:
        return
    plain = type(controller) is SimpleGripController and controller.use_action_scaling
    if not plain or controller.interpolator is not None:
        raise _unsupported(
            name,
            f"the gripper controller {type(controller).__name__} without action "
            "scaling or with interpolation",
            "use GRIP as robosuite configures it",
        )


def _unsupported(env: str, what: str, advice: str) -> RlcoError:
    return RlcoError(
        f"{env}: the native backend does not support {what}; {advice}, or give "
        "backend='robosuite'."
    )
