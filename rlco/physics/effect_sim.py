"""Effects in an environment that robosuite steps itself.

`rlco.physics.effect_kernels` does the same to native copies, in the same order.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.physics.effects.effects_file import EffectsFile
from rlco.physics.mended_model import MendedModel, compile_mended, without_effects
from rlco.physics.quiet_robosuite import MjSim

Array = NDArray[np.float64]


class EffectSim(MjSim):
    """robosuite's simulation of a model with effects.

    Args:
        mended: The model and what acts beside it.

    Attributes:
        mended: The same.
        believed: What the controller takes the robot's state to be; None where that is
            the state.
        clock: Physics steps since the reset.
    """

    def __init__(self, mended: MendedModel) -> None:
        super().__init__(mended.model)
        self.mended = mended
        self.believed: BelievedSim | None = None
        if mended.believed is not None:
            self.believed = BelievedSim(mended, self.data._data)
        self._coulomb = mended.model.dof_frictionloss.copy()
        self._dofs = mended.acting(1).dofs
        self._reached: Array = np.zeros(mended.model.nu)
        self.clock = 0

    def reset(self) -> None:
        """Reset simulation."""
        super().reset()
        self.model._model.dof_frictionloss[:] = self._coulomb
        self.clock = 0

    def step1(self) -> None:
        """Compute what follows from the state, for the controller."""
        if self.mended.terms.act:
            self._add_step_terms()
        super().step1()
        if self.believed is not None:
            self.believed.forward()

    def lag_behind(self) -> None:
        """Let lagging actuators go a part of the way to their commands."""
        ctrl, lag, reached = self.data._data.ctrl, self.mended.lag, self._reached
        behind = (lag < 1.0) & (self.clock > 0)
        gone = reached + lag * (ctrl - reached)
        reached[:] = np.where(behind, gone, ctrl)
        ctrl[:] = reached

    def _add_step_terms(self) -> None:
        model, data, terms = self.model._model, self.data._data, self.mended.terms
        carried = np.abs(data.qfrc_actuator + data.qfrc_applied + data.qfrc_bias)
        stribeck = terms.static * np.exp(-((data.qvel / terms.stribeck_speed) ** 2))
        model.dof_frictionloss[:] = self._coulomb + stribeck + terms.load * carried
        data.qfrc_applied[:] = 0.0
        for loss, dof in zip(terms.drive, self._dofs, strict=True):
            if loss > 0.0 and dof >= 0:
                torque = data.qfrc_actuator[dof]
                lost = (1.0 - 1.0 / (1.0 + loss * abs(torque))) * torque
                data.qfrc_applied[dof] -= lost


class BelievedSim(MjSim):
    """What a controller takes a robot's state to be: told positions, its own model.

    Args:
        mended: The model with effects, and the one without.
        data: The true state.
    """

    def __init__(self, mended: MendedModel, data: mujoco.MjData) -> None:
        super().__init__(mended.believed)
        self._true = data
        self._told, self._told_speed = mended.told, mended.told_speed()

    def tell(self, qpos: Array) -> Array:
        """Return positions as the encoders tell them, (nq,)."""
        told: Array = self._told[0] * qpos + self._told[1]
        return told

    def forward(self) -> None:
        """Compute kinematics, inertia and bias forces."""
        model, data = self.model._model, self.data._data
        data.qpos[:] = self.tell(self._true.qpos)
        data.qvel[:] = self._told_speed * self._true.qvel
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_makeM(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, data.qfrc_bias)


class CommandPath:
    """The way of a robosuite robot's commands: read, sent, and followed.

    It takes the place of the robot's ``control`` method.

    Args:
        sim: The simulation, whose effects say how.
        control: robosuite's own method.
        substeps: Physics steps in a control step.
    """

    def __init__(
        self, sim: EffectSim, control: Callable[..., None], substeps: int
    ) -> None:
        self._sim, self._control, self._substeps = sim, control, substeps
        self._acting = sim.mended.acting(substeps)
        self._pending: deque[Array] = deque()
        self._arriving: Array = np.zeros(0)
        self._arrived: Array = np.zeros(0)
        self._unread = False
        self._step = 0

    def __call__(self, action: Array, policy_step: bool = False) -> None:
        """Do what robosuite does, with the command that is due, if one is."""
        acting, clock = self._acting, self._sim.clock
        if clock == 0:
            zeros = np.zeros_like(action)
            self._pending = deque([zeros] * acting.whole)
            self._arrived, self._unread = zeros, False
        if policy_step:
            self._pending.append(np.array(action, dtype=float))
            self._arriving = self._pending.popleft()
            self._step = 0
        if self._step == acting.phase:
            self._arrived, self._unread = self._arriving, True
        due = self._is_due(clock)
        self._unread = self._unread and not due
        self._control(self._arrived, policy_step=due)
        self._sim.lag_behind()
        self._step += 1
        self._sim.clock += 1

    def _is_due(self, clock: int) -> bool:
        acting, due = self._acting, self._unread
        if acting.period > 0.0:
            since = clock - acting.whole * self._substeps - acting.phase
            now = np.floor(since / acting.period + 1e-9)
            due = due and now > np.floor((since - 1) / acting.period + 1e-9)
        # A robot that no command has reached yet holds its place.
        return bool(due or clock == 0)


def mended_model_of(sim: MjSim) -> MendedModel:
    """Return a simulation's model with what acts beside it."""
    if isinstance(sim, EffectSim):
        return sim.mended
    return without_effects(sim.model._model)


def initialize_with(env: Any, effects: EffectsFile) -> None:
    """Do what robosuite's ``_initialize_sim`` does, with effects in the model.

    Args:
        env: A robosuite environment whose model is put together and not compiled.
        effects: The effects.

    Raises:
        RlcoError: If an effect cannot be applied to this model.
    """
    xml = env.model.get_xml()
    for processor in env._xml_processors:
        xml = processor(xml)
    env.sim = sim = EffectSim(compile_mended(xml, effects))
    sim.forward()
    env.initialize_time(env.control_freq)
    substeps = int(env.control_timestep / env.model_timestep)
    for robot in env.robots:
        robot.control = CommandPath(sim, robot.control, substeps)
        if sim.believed is not None:
            robot.reset = _BelievingReset(robot, robot.reset, sim.believed)


class _BelievingReset:
    """A robot's reset, after which its arm's controller computes what it believes."""

    def __init__(self, robot: Any, reset: Callable[..., None], sim: MjSim) -> None:
        self._robot, self._reset, self._sim = robot, reset, sim

    def __call__(self, deterministic: bool = False) -> None:
        self._reset(deterministic)
        for arm in self._robot.arms:
            controller = self._robot.part_controllers[arm]
            controller.sim = self._sim
            told = self._sim.tell(self._robot.sim.data.qpos)
            controller.update_initial_joints(told[controller.qpos_index])
