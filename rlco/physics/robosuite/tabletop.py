"""The plain robosuite environment of a task in a domain.

Stepping, controller and model are robosuite's own. A task supplies the objects and the
rules, a domain the differences from the simulator as built.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np

from rlco.physics.effects.effects_file import EffectsFile
from rlco.physics.mj.model_struct import set_array
from rlco.physics.rendering.camera import move_camera
from rlco.physics.robosuite.check_objects import check_objects
from rlco.physics.robosuite.effect_sim import ControllerSim, EffectSim, initialize_with
from rlco.physics.robosuite.faster.release import release
from rlco.physics.robosuite.robosuite_api import (
    ManipulationEnv,
    ManipulationTask,
    TableArena,
    load_composite_controller_config,
)
from rlco.physics.robosuite.scene_look import SceneLook, add_to_scene
from rlco.physics.spec.domain import Domain
from rlco.physics.spec.look import Look
from rlco.physics.spec.task import Array, InitialState, SceneState, Task

TABLE_SIZE = (0.8, 0.8, 0.05)
CAMERA = "agentview"


class Tabletop(ManipulationEnv):
    """A task's robot at robosuite's table, with the task's objects and rules.

    An ordinary robosuite environment: ``reset()``, ``step(action)``, ``reward()``,
    ``sim``. Episodes are drawn from the generator given to `start`.

    Args:
        task: The task.
        domain: Differences from the simulator as built.
        image_size: Height and width of ``agentview`` frames; None: no rendering.
        variation: A named variation of the scene.

    Raises:
        RlcoError: If an effect cannot be applied; the effect is named.
    """

    def __init__(
        self,
        task: Task,
        domain: Domain,
        *,
        image_size: tuple[int, int] | None = None,
        variation: str | None = None,
    ) -> None:
        self.task = task
        self.domain = domain
        self.variation = variation
        self.initial: InitialState | None = None
        kind, name = task.robot.name, task.robot.arm
        config = load_composite_controller_config(controller="BASIC", robot=kind)
        # robosuite's default names parts that a single arm does not have.
        arm = config["body_parts"][name]
        arm["kp"] = arm["kp"] * domain.stiffness_scale
        config["body_parts"] = {name: arm}
        height, width = image_size or (128, 128)
        super().__init__(
            robots=kind,
            controller_configs=config,
            initialization_noise=None,
            use_camera_obs=image_size is not None,
            has_offscreen_renderer=image_size is not None,
            camera_names=CAMERA,
            camera_heights=height,
            camera_widths=width,
            control_freq=task.control_frequency,
            horizon=task.horizon,
            ignore_done=True,
            hard_reset=False,
            renderer="mujoco",
        )

    def _load_model(self) -> None:
        super()._load_model()
        model = self.robots[0].robot_model
        model.set_base_xpos(model.base_xpos_offset["table"](TABLE_SIZE[0]))
        arena = TableArena(
            table_full_size=TABLE_SIZE,
            table_friction=self.task.table_friction(self.domain),
            table_offset=(0, 0, 0.8),
        )
        arena.set_origin([0, 0, 0])
        self.objects = self.task.make_objects(self.domain, self.variation)
        check_objects(self.task, self.objects, self.variation)
        self.model = ManipulationTask(arena, [model], self.objects)
        add_to_scene(self.model, self.domain.look)
        # Marks move between episodes without changes of the compiled model.
        first = len(self.task.objects)
        last = first + len(self.task.goals)
        # Bodies with a free joint: the tracked objects, then a variation's distractors.
        self.loose = [*self.objects[:first], *self.objects[last:]]
        for mark in self.objects[first:last]:
            self.model.worldbody.find(f"./body[@name='{mark.root_body}']").set(
                "mocap", "true"
            )

    def _initialize_sim(self, xml_string: str | None = None) -> None:
        if effects := self.domain.model_effects:
            initialize_with(self, EffectsFile(effects), self.domain.model_sample)
        else:
            super()._initialize_sim(xml_string)
        # Images agree with the reported positions.
        sensors = self.domain.sensors
        move_camera(self.sim.model._model, sensors.camera_yaw, sensors.camera_shift)
        look = self.domain.look
        if isinstance(look, Look) and look.changes_scene:
            scene = SceneLook(self.sim.model._model)
            for name, value in scene.fields(look).items():
                set_array(self.sim.model._model, name, value)

    def _setup_references(self) -> None:
        super()._setup_references()
        count = len(self.task.objects)
        model = self.sim.model
        ids = [model.body_name2id(o.root_body) for o in self.objects]
        parts = [model.body_name2id(name) for name in self.task.fixtures]
        self.object_ids = np.array([*ids[:count], *parts], dtype=np.int64)
        marks = ids[count : count + len(self.task.goals)]
        self.mocap_ids = model._model.body_mocapid[marks]
        joints = [model.get_joint_qpos_addr(n) for n in self.task.fixture_joints]
        self.fixture_qpos = np.array(joints, dtype=np.int64)

    def edit_model_xml(self, xml_str: str) -> str:
        """Reserve 16 MB for a world's contacts instead of robosuite's 1.3 GB.

        A tenth of a megabyte is used. If many worlds reserved 1.3 GB each, the process
        could not start another one, such as a video encoder.
        """
        root = ElementTree.fromstring(super().edit_model_xml(xml_str))
        for size in root.iter("size"):
            size.attrib.clear()
            size.set("memory", "16M")
        return ElementTree.tostring(root, encoding="unicode")

    def start(self, initial: InitialState, drawn: int | None = None) -> Any:
        """Reset to an episode's initial state; return robosuite's observations.

        Args:
            initial: The initial state.
            drawn: The parameter set of the domain's sample that the episode has; None:
                the last one, or at first the effects' own numbers.
        """
        self.initial = initial
        if drawn is not None:
            self.sim.draw(drawn)
        return self.reset()

    def _reset_internal(self) -> None:
        super()._reset_internal()
        if self.initial is None:  # robosuite's constructor, before any episode
            return
        if isinstance(self.sim, EffectSim):
            self.sim.seed = self.initial.seed
        data, robot = self.sim.data, self.robots[0]
        data.qpos[robot._ref_arm_joint_pos_indexes] = self.initial.joint_position
        kind, opening = self.task.robot, self.initial.gripper_opening
        fingers = robot._ref_gripper_joint_pos_indexes[kind.arm]
        data.qpos[fingers] = kind.fingers(opening)
        robot.gripper[kind.arm].current_action = kind.gripper_goal(opening)
        for item, pose in zip(self.loose, self.initial.object_pose, strict=True):
            data.set_joint_qpos(item.joints[0], pose)
        data._data.mocap_pos[self.mocap_ids] = self.initial.goal_position
        data._data.mocap_quat[self.mocap_ids] = self.initial.goal_orientation()
        data.qpos[self.fixture_qpos] = self.initial.fixture_opening()
        # This also sets the controller's goal and null-space posture to the new pose.
        joints = self.initial.joint_position
        if (controller_sim := self._controller_sim()) is not None:
            joints = controller_sim.reported_positions(data.qpos)[
                robot._ref_arm_joint_pos_indexes
            ]
        robot.part_controllers[kind.arm].update_initial_joints(joints)

    def _controller_sim(self) -> ControllerSim | None:
        return self.sim.controller_sim if isinstance(self.sim, EffectSim) else None

    def scene_state(self) -> SceneState:
        """Return the true state, without batch axes."""
        if self.initial is None:
            raise RuntimeError("call start() before scene_state()")
        data, robot = self.sim.data, self.robots[0]
        arm = self.task.robot.arm
        site = robot.eef_site_id[arm]
        fingers = data.qpos[robot._ref_gripper_joint_pos_indexes[arm]]
        return SceneState(
            tool_position=data.site_xpos[site].copy(),
            tool_rotation=data.site_xmat[site].reshape(3, 3).copy(),
            gripper_opening=np.asarray(fingers[0] - fingers[1]),
            joint_position=data.qpos[robot._ref_arm_joint_pos_indexes].copy(),
            object_position=data.body_xpos[self.object_ids].copy(),
            object_quaternion=data.body_xquat[self.object_ids].copy(),
            joint_opening=data.qpos[self.fixture_qpos].copy(),
            goal_position=self.initial.goal_position.copy(),
            goal_quaternion=self.initial.goal_orientation().copy(),
            instruction_id=np.asarray(self.initial.instruction_id),
        )

    def reported_state(self) -> SceneState:
        """Return the state with the robot as its encoders report it."""
        state, controller_sim = self.scene_state(), self._controller_sim()
        if controller_sim is None:
            return state
        data, robot = controller_sim.data, self.robots[0]
        site = robot.eef_site_id[self.task.robot.arm]
        return replace(
            state,
            tool_position=data.site_xpos[site].copy(),
            tool_rotation=data.site_xmat[site].reshape(3, 3).copy(),
            joint_position=controller_sim.reported_positions(self.sim.data.qpos)[
                robot._ref_arm_joint_pos_indexes
            ],
        )

    def reward(self, action: Array | None = None) -> float:
        """Return the sparse reward: 1 where the task is solved now, else 0."""
        del action  # robosuite's signature
        return float(self._check_success())

    def _check_success(self) -> bool:
        return bool(self.task.success(self.scene_state()))

    def close(self) -> None:
        """Free all that it holds, some 100 MB; it can be used no longer."""
        release(self)
