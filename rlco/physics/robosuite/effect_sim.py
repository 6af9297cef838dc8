"""Effects in an environment that robosuite steps itself.

`rlco.physics.native.effect_kernels` does the same for native worlds, in the same order
and by the same laws.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.errors import RlcoError
from rlco.physics.effects.command import newest_arrival
from rlco.physics.effects.corrected_model import (
    CorrectedModel,
    PlainModel,
    without_effects,
)
from rlco.physics.effects.effects_file import EffectsFile
from rlco.physics.effects.step_forces import set_friction, set_torques
from rlco.physics.mj.model_struct import ModelValues
from rlco.physics.robosuite.drawn_models import DrawnModels
from rlco.physics.robosuite.global_random import peeked_seed
from rlco.physics.robosuite.robosuite_api import MjSim
from rlco.physics.spec.sample import Sample

Array = NDArray[np.float64]


class EffectSim(MjSim):
    """robosuite's simulation of a model with effects.

    Args:
        corrected: The model and the effects beyond it.
        drawn: Parameter sets that `draw` may give it; None: none.

    Attributes:
        corrected: The model and the effects beyond it at present.
        drawn: The parameter sets.
        controller_sim: The robot's state as its controller observes it; None where that
            is the true state.
        clock: Physics steps since the reset.
        seed: Of the random delays of the episode's commands.
    """

    def __init__(
        self, corrected: CorrectedModel, drawn: DrawnModels | None = None
    ) -> None:
        super().__init__(corrected.model)
        self.corrected = corrected
        self.drawn = drawn
        self._own = ModelValues.without_arrays(corrected.model)
        self.controller_sim: ControllerSim | None = None
        if corrected.controller_model is not None:
            self.controller_sim = ControllerSim(corrected, self.data._data)
        self._coulomb = corrected.model.dof_frictionloss.copy()
        self._forces = corrected.forces
        self._reached: Array = np.zeros(corrected.model.nu)
        self._begin()

    def reset(self) -> None:
        """Reset simulation."""
        super().reset()
        self.model._model.dof_frictionloss[:] = self._coulomb
        self._begin()

    def _begin(self) -> None:
        self.clock, self.seed = 0, 0
        if self.corrected.random_delay.size:
            self.seed = peeked_seed()

    def draw(self, row: int) -> None:
        """Give the simulation a parameter set, from its next reset on.

        Raises:
            RlcoError: If it has none.
        """
        if self.drawn is None:
            raise RlcoError(
                "the domain has no parameter sets to draw from; give an effects.yaml "
                "with a sample, or draw none."
            )
        drawn, model = self.drawn[row], self.model._model
        model.dof_frictionloss[:] = self._coulomb  # without a law's part
        own = self._own.arrays
        for name in drawn.values.arrays.keys() - own.keys():
            own[name] = getattr(model, name).copy()
        self._own.write_to(model)
        drawn.values.write_to(model)
        self.corrected, self._forces = drawn.corrected, drawn.corrected.forces
        self._coulomb = model.dof_frictionloss.copy()
        if self.controller_sim is not None:
            self.controller_sim.report_as(drawn.corrected)

    def step1(self) -> None:
        """Compute the quantities that the controller needs from the state."""
        if self._forces.friction.rows.size:
            self._write_friction()
        super().step1()
        if self.controller_sim is not None:
            self.controller_sim.forward()

    def step2(self) -> None:
        """Complete the physics step, after the controller has set its commands."""
        if self._forces.torque.rows.size:
            self._write_torques()
        super().step2()

    def lag_behind(self) -> None:
        """Move lagging actuators a fraction of the distance to their commands."""
        ctrl, lag, reached = self.data._data.ctrl, self.corrected.lag, self._reached
        behind = (lag < 1.0) & (self.clock > 0)
        gone = reached + lag * (ctrl - reached)
        reached[:] = np.where(behind, gone, ctrl)
        ctrl[:] = reached

    def _write_friction(self) -> None:
        data = self.data._data
        set_friction(
            self._forces.friction,
            data.qpos,
            data.qvel,
            data.qfrc_actuator,
            data.qfrc_applied,
            data.qfrc_bias,
            self._coulomb,
            self.model._model.dof_frictionloss,
        )

    def _write_torques(self) -> None:
        data = self.data._data
        mujoco.mj_fwdActuation(self.model._model, data)
        set_torques(
            self._forces.torque,
            data.qpos,
            data.qvel,
            data.qfrc_actuator,
            data.qfrc_bias,
            data.qfrc_applied,
        )


class ControllerSim(MjSim):
    """A robot's state as its controller observes it: reported positions, its own model.

    Args:
        corrected: The model with effects, and the one without.
        data: The true state.
    """

    def __init__(self, corrected: CorrectedModel, data: mujoco.MjData) -> None:
        super().__init__(corrected.controller_model)
        self._true = data
        self.report_as(corrected)

    def report_as(self, corrected: CorrectedModel) -> None:
        """Read the encoders as these effects change them."""
        self._reported, self._reported_speed = (
            corrected.reported,
            corrected.reported_speed(),
        )

    def reported_positions(self, qpos: Array) -> Array:
        """Return positions as the encoders report them, (nq,)."""
        reported: Array = self._reported[0] * qpos + self._reported[1]
        return reported

    def forward(self) -> None:
        """Compute kinematics, inertia and bias forces."""
        model, data = self.model._model, self.data._data
        data.qpos[:] = self.reported_positions(self._true.qpos)
        data.qvel[:] = self._reported_speed * self._true.qvel
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, data.qfrc_bias)


class CommandPath:
    """The path of a robosuite robot's commands: read, sent, and followed.

    It replaces the robot's ``control`` method.

    Args:
        sim: The simulation, with effects on commands.
        control: robosuite's own method.
        substeps: Physics steps per control step.
    """

    def __init__(
        self, sim: EffectSim, control: Callable[..., None], substeps: int
    ) -> None:
        self._sim, self._control, self._substeps = sim, control, substeps
        self._acting = sim.corrected.acting(substeps)
        self._pending: deque[Array] = deque()
        self._arriving: Array = np.zeros(0)
        self._arrived: Array = np.zeros(0)
        self._unread = False
        self._step = 0
        # Of commands with random delays: the last that has passed, the last sent.
        self._passed, self._sent = 0, 0

    def __call__(self, action: Array, policy_step: bool = False) -> None:
        """Do what robosuite does, with the command that is due, if there is one."""
        clock = self._sim.clock
        if clock == 0:
            self._acting = self._sim.corrected.acting(self._substeps)
        acting = self._acting
        if clock == 0:
            zeros = np.zeros_like(action)
            self._pending = deque([zeros] * acting.whole)
            self._arrived, self._unread = zeros, False
            if acting.random.size:
                self._pending = deque([zeros] * (acting.room - 1))
                self._passed, self._sent = -acting.room, -1
        if acting.random.size:
            due = self._arrives_at_random(action, policy_step=policy_step)
        else:
            due = self._arrives(action, policy_step=policy_step)
        # A robot holds its position until the first command arrives.
        due = due or clock == 0
        self._unread = self._unread and not due
        self._control(self._arrived, policy_step=due)
        self._sim.lag_behind()
        self._step += 1
        self._sim.clock += 1

    def _arrives(self, action: Array, *, policy_step: bool) -> bool:
        """Return whether a command is read, where all have one delay."""
        acting = self._acting
        if policy_step:
            self._pending.append(np.array(action, dtype=float))
            self._arriving = self._pending.popleft()
            self._step = 0
        if self._step == acting.phase:
            self._arrived, self._unread = self._arriving, True
        due = self._unread
        if acting.period > 0.0:
            since = self._sim.clock - acting.whole * self._substeps - acting.phase
            now = np.floor(since / acting.period + 1e-9)
            due = due and bool(now > np.floor((since - 1) / acting.period + 1e-9))
        return due

    def _arrives_at_random(self, action: Array, *, policy_step: bool) -> bool:
        """Return whether a command arrives, where each has a delay of its own."""
        acting, before = self._acting, self._passed
        if policy_step:
            self._pending.append(np.array(action, dtype=float))
            self._sent += 1
        self._passed, arrived = newest_arrival(
            acting.random,
            self._sim.seed,
            acting.whole * self._substeps + acting.phase,
            acting.period,
            self._substeps,
            self._sim.clock,
            before,
            self._sent,
        )
        if arrived > before:
            self._arrived = self._pending[arrived - before - 1]
        for _ in range(self._passed - before):
            self._pending.popleft()
        return bool(arrived > before)


def drawn_models_of(sim: MjSim) -> DrawnModels | None:
    """Return the parameter sets that a simulation's episodes may draw."""
    return sim.drawn if isinstance(sim, EffectSim) else None


def corrected_model_of(sim: MjSim) -> CorrectedModel:
    """Return a simulation's model with the effects beyond it."""
    if isinstance(sim, EffectSim):
        return sim.corrected
    return without_effects(sim.model._model)


def initialize_with(
    env: Any, effects: EffectsFile, sample: Sample | None = None
) -> None:
    """Do what robosuite's ``_initialize_sim`` does, with effects in the model.

    Args:
        env: A robosuite environment whose model is assembled but not compiled.
        effects: The effects.
        sample: Parameter sets of them, which episodes may draw.

    Raises:
        RlcoError: If an effect cannot be applied to this model, or robosuite would
            step in one piece, without the effects between the halves of a step.
    """
    if not env.lite_physics:
        raise RlcoError(
            "effects need lite_physics=True, but the environment was given "
            "lite_physics=False; leave it out, or leave out the effects."
        )
    xml = env.model.get_xml()
    for processor in env._xml_processors:
        xml = processor(xml)
    plain = PlainModel.of(xml)
    found = plain.checked(effects)
    corrected = plain.with_effects(found)
    drawn = None
    if sample is not None:
        drawn = DrawnModels(plain, corrected, found, sample)
    env.sim = sim = EffectSim(corrected, drawn)
    sim.forward()
    env.initialize_time(env.control_freq)
    substeps = int(env.control_timestep / env.model_timestep)
    for robot in env.robots:
        robot.control = CommandPath(sim, robot.control, substeps)
        if sim.controller_sim is not None:
            robot.reset = _ControllerReset(robot, robot.reset, sim.controller_sim)


class _ControllerReset:
    """A robot's reset, after which its arm's controller computes what it believes."""

    def __init__(self, robot: Any, reset: Callable[..., None], sim: MjSim) -> None:
        self._robot, self._reset, self._sim = robot, reset, sim

    def __call__(self, deterministic: bool = False) -> None:
        self._reset(deterministic)
        for arm in self._robot.arms:
            controller = self._robot.part_controllers[arm]
            controller.sim = self._sim
            reported = self._sim.reported_positions(self._robot.sim.data.qpos)
            controller.update_initial_joints(reported[controller.qpos_index])
