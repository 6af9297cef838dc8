"""A task's robosuite model, without what is only drawn, under each hypothesis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from rlco.gap.log import Array
from rlco.gap.problem import Hypothesis
from rlco.gap.slim import slim_down
from rlco.gap.spread import apply_spread, spread_names
from rlco.physics.arm_control import Control, integers, read_control, read_gains
from rlco.physics.domain import Domain
from rlco.physics.mended_model import MendedModel, mend
from rlco.physics.native_kernels import Tracked
from rlco.physics.task import Task

#: What may be a little off everywhere. Masses and inertias of links are not among it:
#: the controller knows its own robot, and cancels them.
SPREAD = (
    "joint damping",
    "joint friction",
    "controller stiffness",
    "object mass",
    "object friction",
)
_ROBOT = ("robot0_", "gripper0_", "fixed_mount0_")


@dataclass(frozen=True)
class Plant:
    """One compiled model with what its controller and features need of it.

    Attributes:
        mended: The model, and what acts beside it.
        control: The arm's controller, with what acts in each physics step.
        tracked: Where features are read.
        stiffness: Of the controller, (6,).
        damping: Of the controller, (6,).
        friction: The joints' Coulomb friction, (nv,); the model's own changes while
            effects act at each step.
    """

    mended: MendedModel
    control: Control
    tracked: Tracked
    stiffness: Array
    damping: Array
    friction: Array

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model."""
        return self.mended.model


class Plants:
    """Compiles a task's model under hypotheses.

    Args:
        task: The task.
        domain: What differs from the simulator as built, before any hypothesis.

    Attributes:
        spec: The model, slim.
        control: The arm's controller without effects.
        nominal: The plant without effects.

    Example:
        >>> from rlco.physics.domain import SIM
        >>> from rlco.physics.push_cube import TASK
        >>> plants = Plants(TASK, SIM)
        >>> plants.nominal.model.body("red_cube_main").mass.round(3).tolist()
        [0.06]
    """

    def __init__(self, task: Task, domain: Domain) -> None:
        # robosuite costs seconds to import.
        from rlco.physics.tabletop import Tabletop

        self.task, self.domain = task, domain
        source = Tabletop(task, domain)
        source.start(task.sample(np.random.default_rng(0), None))
        xml = source.model.get_xml()
        for edit in source._xml_processors:
            xml = edit(xml)
        self.spec = slim_down(mujoco.MjSpec.from_string(xml))
        self.control: Control = read_control(source, exact=False)
        self._gains = read_gains(source)
        self._tracked = _tracked(source)
        full = source.sim.model._model
        self._bodies = [full.body(i).name for i in source.object_ids.tolist()]
        self._plain = _compiled(self.spec)
        self.nominal = self.plant(Hypothesis())

    @property
    def objects(self) -> Sequence[str]:
        """Bodies of the task's objects, in its order."""
        return self._bodies[: len(self.task.objects)]

    def plant(self, hypothesis: Hypothesis) -> Plant:
        """Compile the model under a hypothesis.

        Raises:
            EffectError: If an effect adds joints or actuators.
        """
        spec, plain = self.spec, self._plain
        stiffness, damping = self._gains
        if any(hypothesis.spread):
            parts = dict(zip(SPREAD, hypothesis.spread, strict=True))
            spec = self.spec.copy()
            _apply_spread(spec, self._plain, parts)
            plain = _compiled(spec)
            stiffer = 1.0 + parts["controller stiffness"]
            stiffness, damping = stiffness * stiffer, damping * np.sqrt(stiffer)
        mended = mend(spec, plain, hypothesis.effects)
        mended.model.opt.disableflags |= _NO_RESET
        bodies = integers([mended.model.body(name).id for name in self._bodies])
        acting = mended.acting(self.control.substeps)
        whole = acting.whole + self.domain.command_delay
        return Plant(
            mended,
            self.control._replace(acting=acting._replace(whole=whole)),
            self._tracked._replace(objects=bodies),
            stiffness,
            damping,
            mended.model.dof_frictionloss.copy(),
        )


# A diverged state must show, not start over from the model's zero.
_NO_RESET = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    model = spec.compile()
    model.opt.disableflags |= _NO_RESET
    return model


def _tracked(source: Any) -> Tracked:
    robot, model = source.robots[0], source.sim.model
    joints = [item.joints[0] for item in source.loose]
    return Tracked(
        site=int(robot.eef_site_id["right"]),
        finger=int(robot._ref_gripper_joint_pos_indexes["right"][0]),
        nq=int(model._model.nq),
        arm_qpos=integers(robot.part_controllers["right"].qpos_index),
        objects=integers(source.object_ids),
        object_joints=integers([model.get_joint_qpos_addr(j)[0] for j in joints]),
        mocap=integers(source.mocap_ids),
        fixture_qpos=integers(source.fixture_qpos),
    )


def _apply_spread(
    spec: mujoco.MjSpec, plain: mujoco.MjModel, parts: dict[str, float]
) -> None:
    """Multiply what each part is of by one plus it, in place."""
    names = [n for n in spread_names(plain) if _group(n) in parts]
    apply_spread(spec, tuple(names), tuple(parts[_group(n)] for n in names))
    for body in spec.bodies:
        if not body.name.startswith(_ROBOT):
            for geom in body.geoms:
                friction = np.array(geom.friction)
                friction[0] *= 1.0 + parts["object friction"]
                geom.friction = friction


def _group(name: str) -> str:
    """Return which part of `SPREAD` a number of a model belongs to, if to any."""
    kind, target = name.split(":", 1)
    if kind in ("mass", "inertia"):
        return "" if target.startswith(_ROBOT) else "object mass"
    return f"joint {kind}"
