"""A task's robosuite model, without visual elements, under each hypothesis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from rlco.gap.compare.model_tolerance import apply_tolerance, tolerance_names
from rlco.gap.compare.problem import Hypothesis
from rlco.gap.logs.log import Array
from rlco.gap.prune import prune
from rlco.physics.effects.apply import checked
from rlco.physics.effects.command import at_mean_delay
from rlco.physics.effects.corrected_model import CorrectedModel, correct
from rlco.physics.effects.names import in_model
from rlco.physics.native.kernels import Tracked
from rlco.physics.native.stepper import tracked_of
from rlco.physics.robosuite.read_control import integers, read_control, read_gains
from rlco.physics.spec.control import Control
from rlco.physics.spec.domain import Domain
from rlco.physics.spec.robot import PANDA
from rlco.physics.spec.task import Task

#: Parameters with a tolerance. Link masses and inertias are not among them: the
#: controller knows its own robot and cancels them.
TOLERANCES = (
    "joint damping",
    "joint friction",
    "controller stiffness",
    "object mass",
    "object friction",
)
_ROBOT = PANDA.prefixes


@dataclass(frozen=True)
class Plant:
    """One compiled model, with its controller and features.

    Attributes:
        corrected: The model with effects applied, and forces beyond the model's.
        control: The arm's controller, with effects in each physics step.
        tracked: Addresses of features.
        stiffness: Of the controller, (6,).
        damping: Of the controller, (6,).
        friction: Coulomb friction of the joints, (nv,); the compiled model's own value
            is overwritten by effects at each step.
    """

    corrected: CorrectedModel
    control: Control
    tracked: Tracked
    stiffness: Array
    damping: Array
    friction: Array

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model."""
        return self.corrected.model


class Plants:
    """Compile a task's model under hypotheses.

    Args:
        task: The task.
        domain: Differences from the simulator as built, before any hypothesis.

    Attributes:
        spec: The pruned model, without effects.
        plain: The same, compiled: the controller's internal model.
        control: The arm's controller.
        nominal: The plant of the domain without hypotheses.

    Example:
        >>> from rlco.physics.spec.domain import SIM
        >>> from rlco.physics.tasks.push_cube import TASK
        >>> plants = Plants(TASK, SIM)
        >>> plants.nominal.model.body("red_cube_main").mass.round(3).tolist()
        [0.06]
    """

    def __init__(self, task: Task, domain: Domain) -> None:
        # Importing robosuite takes seconds.
        from rlco.physics.robosuite.tabletop import Tabletop

        self.task, self.domain = task, domain
        source = Tabletop(task, domain)
        source.start(task.sample(np.random.default_rng(0), None))
        xml = source.model.get_xml()
        for edit in source._xml_processors:
            xml = edit(xml)
        self.spec = prune(mujoco.MjSpec.from_string(xml))
        self.control: Control = read_control(source, exact=False)
        self._gains = read_gains(source)
        self._tracked = tracked_of(source)
        full = source.sim.model._model
        self._bodies = [full.body(i).name for i in source.object_ids.tolist()]
        source.close()
        self.plain = _compiled(self.spec)
        self._effects = tuple(
            checked(self.plain, effect, controlled=True)
            for effect in in_model(domain.model_effects, self.plain)
        )
        self.nominal = self._compiled(Hypothesis())

    @property
    def objects(self) -> Sequence[str]:
        """Bodies of the task's objects, in the task's order."""
        return self._bodies[: len(self.task.objects)]

    def plant(self, hypothesis: Hypothesis) -> Plant:
        """Return the model compiled under a hypothesis.

        Raises:
            EffectError: If an effect adds joints or actuators.
        """
        if hypothesis == Hypothesis():
            return self.nominal  # to compile it takes as long as a second of physics
        return self._compiled(hypothesis)

    def _compiled(self, hypothesis: Hypothesis) -> Plant:
        spec, plain = self.spec, self.plain
        stiffness, damping = self._gains
        if any(hypothesis.spread):
            parts = dict(zip(TOLERANCES, hypothesis.spread, strict=True))
            spec = self.spec.copy()
            _apply_tolerances(spec, self.plain, parts)
            plain = _compiled(spec)
            stiffer = 1.0 + parts["controller stiffness"]
            stiffness, damping = stiffness * stiffer, damping * np.sqrt(stiffer)
        # Nobody knows when a recorded command arrived: all come late by the mean.
        effects = map(at_mean_delay, (*self._effects, *hypothesis.effects))
        corrected = correct(spec, plain, list(effects))
        corrected.model.opt.disableflags |= _NO_RESET
        bodies = integers([corrected.model.body(name).id for name in self._bodies])
        return Plant(
            corrected,
            self.control._replace(acting=corrected.acting(self.control.substeps)),
            self._tracked._replace(objects=bodies),
            stiffness,
            damping,
            corrected.model.dof_frictionloss.copy(),
        )


# Diverged states must stay visible instead of being reset.
_NO_RESET = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    model = spec.compile()
    model.opt.disableflags |= _NO_RESET
    return model


def _apply_tolerances(
    spec: mujoco.MjSpec, plain: mujoco.MjModel, parts: dict[str, float]
) -> None:
    """Multiply each group of parameters by one plus its relative change, in place."""
    names = [n for n in tolerance_names(plain) if _group(n) in parts]
    apply_tolerance(spec, tuple(names), tuple(parts[_group(n)] for n in names))
    for body in spec.bodies:
        if not body.name.startswith(_ROBOT):
            for geom in body.geoms:
                friction = np.array(geom.friction)
                friction[0] *= 1.0 + parts["object friction"]
                geom.friction = friction


def _group(name: str) -> str:
    """Return the entry of `TOLERANCES` that covers a model parameter, or ''."""
    kind, target = name.split(":", 1)
    if kind in ("mass", "inertia"):
        return "" if target.startswith(_ROBOT) else "object mass"
    return f"joint {kind}"
