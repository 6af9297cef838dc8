"""The plain robosuite environment behind a task and a domain.

robosuite's own stepping, controller and model; a task supplies the objects and
the rules, a domain what differs from the simulator as built.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np

from rlco.physics.camera import move_camera
from rlco.physics.domain import Domain, make_domain
from rlco.physics.effect_sim import BelievedSim, EffectSim, initialize_with
from rlco.physics.effects.effects_file import EffectsFile
from rlco.physics.quiet_robosuite import (
    ManipulationEnv,
    ManipulationTask,
    TableArena,
    load_composite_controller_config,
)
from rlco.physics.task import Array, InitialState, SceneState, Task, make_task

TABLE_SIZE = (0.8, 0.8, 0.05)
CAMERA = "agentview"


class Tabletop(ManipulationEnv):
    """robosuite's Panda at a table, with a task's objects and rules.

    An ordinary robosuite environment: ``reset()``, ``step(action)``, ``reward()``,
    ``sim``. Episodes are drawn from the generator given to `start`.

    Args:
        task: The task.
        domain: What differs from the simulator as built.
        image_size: Height and width of ``agentview`` frames; None: no rendering.
        variation: A named variation of the scene.
        effects: Effects to add to the model.

    Raises:
        RlcoError: If an effect cannot be applied; names it.
    """

    def __init__(
        self,
        task: Task,
        domain: Domain,
        *,
        image_size: tuple[int, int] | None = None,
        variation: str | None = None,
        effects: EffectsFile | None = None,
    ) -> None:
        self.task = task
        self.domain = domain
        self.variation = variation
        self.effects = effects
        self.initial: InitialState | None = None
        self._delayed: deque[Array] = deque()
        config = load_composite_controller_config(controller="BASIC", robot="Panda")
        # robosuite's default names parts that a Panda does not have.
        arm = config["body_parts"]["right"]
        arm["kp"] = arm["kp"] * domain.stiffness_scale
        config["body_parts"] = {"right": arm}
        height, width = image_size or (128, 128)
        super().__init__(
            robots="Panda",
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
        for name, extra in (
            ("frictionloss", self.domain.joint_friction),
            ("damping", self.domain.joint_damping),
        ):
            joints = [
                j for j in model._elements["joints"] if "finger" not in j.get("name")
            ]
            for joint in joints:
                joint.set(name, str(float(joint.get(name, "0")) + extra))
        arena = TableArena(
            table_full_size=TABLE_SIZE,
            table_friction=self.task.table_friction(self.domain),
            table_offset=(0, 0, 0.8),
        )
        arena.set_origin([0, 0, 0])
        self.objects = self.task.make_objects(self.domain, self.variation)
        self.model = ManipulationTask(arena, [model], self.objects)
        # Marks move from episode to episode without touching the compiled model.
        first = len(self.task.objects)
        last = first + len(self.task.goals)
        # What has a free joint: the tracked objects, then a variation's distractors.
        self.loose = [*self.objects[:first], *self.objects[last:]]
        for mark in self.objects[first:last]:
            self.model.worldbody.find(f"./body[@name='{mark.root_body}']").set(
                "mocap", "true"
            )

    def _initialize_sim(self, xml_string: str | None = None) -> None:
        if self.effects is None:
            super()._initialize_sim(xml_string)
        else:
            initialize_with(self, self.effects)
        # What its pictures show agrees with the positions that it reports.
        move_camera(
            self.sim.model._model, self.domain.camera_yaw, self.domain.camera_shift
        )

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
        """Reserve 16 MB for a copy's contacts in place of robosuite's 1.3 GB.

        A tenth of a megabyte is used. With 1.3 GB reserved for each of many copies
        the process could not start another one, such as a video encoder.
        """
        root = ElementTree.fromstring(super().edit_model_xml(xml_str))
        for size in root.iter("size"):
            size.attrib.clear()
            size.set("memory", "16M")
        return ElementTree.tostring(root, encoding="unicode")

    def start(self, initial: InitialState) -> Any:
        """Reset to the given start of an episode; return robosuite's observations."""
        self.initial = initial
        return self.reset()

    def _reset_internal(self) -> None:
        super()._reset_internal()
        self._delayed = deque(
            np.zeros(self.action_dim) for _ in range(self.domain.command_delay)
        )
        if self.initial is None:  # robosuite's constructor, before any episode
            return
        data, robot = self.sim.data, self.robots[0]
        data.qpos[robot._ref_arm_joint_pos_indexes] = self.initial.joint_position
        fingers = robot._ref_gripper_joint_pos_indexes["right"]
        half = self.initial.gripper_opening / 2.0
        data.qpos[fingers] = (half, -half)
        robot.gripper["right"].current_action = self.initial.gripper_goal()
        for item, pose in zip(self.loose, self.initial.object_pose, strict=True):
            data.set_joint_qpos(item.joints[0], pose)
        data._data.mocap_pos[self.mocap_ids] = self.initial.goal_position
        data._data.mocap_quat[self.mocap_ids] = self.initial.goal_orientation()
        data.qpos[self.fixture_qpos] = self.initial.fixture_opening()
        # Also moves the controller's goal and null-space posture to the new pose.
        joints = self.initial.joint_position
        if (believed := self._believed()) is not None:
            joints = believed.tell(data.qpos)[robot._ref_arm_joint_pos_indexes]
        robot.part_controllers["right"].update_initial_joints(joints)

    def _believed(self) -> BelievedSim | None:
        return self.sim.believed if isinstance(self.sim, EffectSim) else None

    def step(self, action: Array) -> Any:
        """Execute one control step, `command_delay` steps after its command."""
        self._delayed.append(np.asarray(action, dtype=float))
        return super().step(self._delayed.popleft())

    def scene_state(self) -> SceneState:
        """Return the true state, without batch axes."""
        if self.initial is None:
            raise RuntimeError("call start() before scene_state()")
        data, robot = self.sim.data, self.robots[0]
        site = robot.eef_site_id["right"]
        fingers = data.qpos[robot._ref_gripper_joint_pos_indexes["right"]]
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
        """Return the state with the robot where its encoders tell that it is."""
        state, believed = self.scene_state(), self._believed()
        if believed is None:
            return state
        data, robot = believed.data, self.robots[0]
        site = robot.eef_site_id["right"]
        return replace(
            state,
            tool_position=data.site_xpos[site].copy(),
            tool_rotation=data.site_xmat[site].reshape(3, 3).copy(),
            joint_position=believed.tell(self.sim.data.qpos)[
                robot._ref_arm_joint_pos_indexes
            ],
        )

    def reward(self, action: Array | None = None) -> float:
        """Return the sparse reward: 1 where the task is solved now, else 0."""
        del action  # robosuite's signature
        return float(self._check_success())

    def _check_success(self) -> bool:
        return bool(self.task.success(self.scene_state()))


def make_robosuite(
    task: str | Task,
    *,
    domain: str | Domain = "sim",
    seed: int = 0,
    image_size: tuple[int, int] | None = None,
) -> Tabletop:
    """Return the plain robosuite environment of a task, at an episode's start.

    Args:
        task: A task or its name.
        domain: A domain or its name.
        seed: Draws the episode that the environment starts in.
        image_size: Height and width of camera frames; None: no rendering.

    Raises:
        UnknownNameError: If the task or the domain is unknown.

    Example:
        >>> env = make_robosuite("push_cube", seed=3)
        >>> env.scene_state().object_position.shape
        (3, 3)
    """
    env = Tabletop(make_task(task), make_domain(domain), image_size=image_size)
    env.start(env.task.sample(np.random.default_rng(seed), None))
    return env
