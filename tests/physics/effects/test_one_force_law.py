"""What acts at each physics step is one law, wherever a step is taken.

The rollout that identifies an effect, the native stepper and the robosuite backend that
a policy is trained in: each takes one physics step from the same state, with the same
command, and applies the same generalised force.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from rlco.errors import RlcoError
from rlco.gap.compare.arm.kernel import Views, roll_out_forces
from rlco.gap.compare.arm.step_through import NONE
from rlco.physics.effects import EFFECTS, AppliedEffect, Effect, Parameter, register
from rlco.physics.effects.apply import step_forces
from rlco.physics.effects.effect import Array
from rlco.physics.effects.targets import joints
from rlco.physics.native.kernels import advance_range
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.robosuite.tabletop import Tabletop
from rlco.physics.spec.domain import SIM, with_effects
from rlco.physics.tasks.push_cube import TASK

STEP_EFFECTS = [
    AppliedEffect("stribeck_friction", "joint2", {"static": 9.0, "speed": 0.2}),
    AppliedEffect("load_friction", "joint4", {"ratio": 0.1}),
    AppliedEffect("drive_loss", "joint2", {"loss": 0.02}),
    AppliedEffect(
        "cogging",
        "joint4",
        {
            "amplitude": 3.0,
            "count": 40.0,
            "phase": 1.0,
            "second_sine": 1.0,
            "second_cosine": -0.5,
        },
    ),
    AppliedEffect("hardening_spring", "joint6", {"hardening": 2.0, "rest": 1.0}),
    AppliedEffect("directional_friction", "joint1", {"forward": 5.0, "backward": 2.0}),
]
OWN = [
    AppliedEffect("wind", "joint2", {"drag": 2.0, "gust": 0.3}),
    AppliedEffect("worn_gear", "joint2", {"friction": 4.0}),
]
STATES = 200


def _wind(
    position: float,
    velocity: float,
    torque: float,
    carried: float,
    values: Sequence[float],
) -> float:
    return -values[0] * abs(velocity) * velocity + values[1] * math.sin(position)


def _worn_gear(
    position: float,
    velocity: float,
    torque: float,
    carried: float,
    values: Sequence[float],
) -> float:
    return values[0] * (1.0 + math.cos(8.0 * position)) + 0.01 * abs(torque) * carried


def _own(name: str, numbers: tuple[str, ...]) -> Effect:
    parameters = tuple(Parameter(n, "", 0.0, 9.0, 0.0, (1.0,)) for n in numbers)
    return Effect(name, "", "", (), joints, lambda model, target: parameters)


@pytest.fixture
def own_effects() -> Iterator[None]:
    """Two effects of a user's own, each one entry."""
    register(replace(_own("wind", ("drag", "gust")), torque=_wind))
    register(replace(_own("worn_gear", ("friction",)), friction=_worn_gear))
    yield
    del EFFECTS["wind"], EFFECTS["worn_gear"]


class Three:
    """One model with effects under three who step it."""

    def __init__(self, effects: list[AppliedEffect]) -> None:
        self.env = Tabletop(TASK, with_effects(SIM, effects))
        self.native = NativeStepper(TASK, SIM, num_envs=1, threads=1, effects=effects)
        start = TASK.sample(np.random.default_rng(0), None)
        self.env.start(start)
        self.native.reset([start])
        self.model: mujoco.MjModel = copy.copy(self.env.sim.model._model)
        self.data = mujoco.MjData(self.model)
        self.effects = self.env.sim.corrected.effects
        self.coulomb = self.model.dof_frictionloss.copy()

    def draw(self, rng: np.random.Generator) -> None:
        """Draw a state, the forces of the step before, and what was lost in it."""
        data, model = self.data, self.model
        mujoco.mj_resetData(model, data)
        model.dof_frictionloss[:] = self.coulomb
        arm = self.native.worlds.control
        data.qpos[arm.arm_qpos] = self.native.data[0].qpos[arm.arm_qpos]
        data.qpos[arm.arm_qpos] += rng.normal(0.0, 0.2, arm.arm_qpos.size)
        data.qvel[arm.arm_dof] = rng.normal(0.0, 0.4, arm.arm_dof.size)
        data.ctrl[:] = rng.uniform(-40.0, 40.0, model.nu)
        data.qfrc_applied[arm.arm_dof] = rng.normal(0.0, 1.0, arm.arm_dof.size)
        mujoco.mj_forward(model, data)

    def place(self, data: mujoco.MjData) -> None:
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.empty(mujoco.mj_stateSize(self.model, kind))
        mujoco.mj_getState(self.model, self.data, state, kind)
        mujoco.mj_setState(self.model, data, state, kind)
        for name in ("qfrc_actuator", "qfrc_bias"):
            getattr(data, name)[:] = getattr(self.data, name)

    def step_natively(self, action: Array) -> tuple[Array, Array, Array]:
        """Take a physics step; return the command, and both forces."""
        copies, data = self.native.worlds, self.native.data[0]
        self.place(data)
        copies.memory.clock[0] = 0
        control = copies.control._replace(substeps=1)
        steps = np.ones(1, dtype=np.int64)
        advance_range(0, 1, control, copies.memory, action[None, None], steps)
        friction = self.native.model_of(0).dof_frictionloss
        return data.ctrl.copy(), data.qfrc_applied.copy(), friction.copy()

    def step_robosuite(self, command: Array) -> tuple[Array, Array]:
        sim = self.env.sim
        data = sim.data._data
        self.place(data)
        sim.step1()
        data.ctrl[:] = command
        sim.step2()
        friction = sim.model._model.dof_frictionloss
        return data.qfrc_applied.copy(), friction.copy()

    def step_rollout(self, command: Array) -> tuple[Array, Array]:
        model, data = self.model, self.data
        views = Views(
            data.qpos,
            data.qvel,
            data.ctrl,
            data.qfrc_bias,
            data.qfrc_actuator,
            data.qfrc_applied,
            model.dof_frictionloss,
            self.coulomb,
        )
        roll_out_forces(
            model._address,
            data._address,
            views,
            command[None],
            np.zeros((1, 2), dtype=np.int64),
            np.zeros((2, 1)),
            step_forces(model, self.effects),
            NONE,
            False,
        )
        return data.qfrc_applied.copy(), model.dof_frictionloss.copy()


def assert_one_force(effects: list[AppliedEffect]) -> None:
    """Compare the three over many states."""
    three, rng = Three(effects), np.random.default_rng(0)
    for _ in range(STATES):
        three.draw(rng)
        command, applied, friction = three.step_natively(rng.uniform(-1, 1, 7))
        for other in (three.step_robosuite(command), three.step_rollout(command)):
            np.testing.assert_allclose(other[0], applied, rtol=1e-9, atol=1e-12)
            np.testing.assert_allclose(other[1], friction, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("effect", STEP_EFFECTS, ids=lambda e: e.name)
def test_three_steppers_apply_one_force(effect: AppliedEffect) -> None:
    assert_one_force([effect])


def test_three_steppers_apply_all_forces_together(own_effects: None) -> None:
    assert_one_force([*STEP_EFFECTS, *OWN])


@pytest.mark.slow
def test_an_effect_of_ones_own_acts_wherever_a_robot_is_stepped(
    own_effects: None,
) -> None:
    assert {e.name for e in EFFECTS.values() if "step" in e.acts_on} == {
        *(one.name for one in (*STEP_EFFECTS, *OWN))
    }
    assert_one_force(OWN)
    three = Three(OWN)
    three.draw(np.random.default_rng(1))
    position, velocity = float(three.data.qpos[1]), float(three.data.qvel[1])
    pushed = three.data.qfrc_applied.copy()
    _, applied, friction = three.step_natively(np.zeros(7))
    pushed[1] = _wind(position, velocity, 0.0, 0.0, [2.0, 0.3])
    # What others push elsewhere stays.
    np.testing.assert_allclose(applied, pushed)
    torque, bias = three.data.qfrc_actuator[1], three.data.qfrc_bias[1]
    carried = abs(torque + three.data.qfrc_applied[1] + bias)
    rubbed = _worn_gear(position, velocity, torque, carried, [4.0])
    assert (friction - three.coulomb)[1] == pytest.approx(rubbed)


def test_a_loss_is_of_the_torque_that_the_motor_gives_in_this_very_step() -> None:
    loss = 0.02
    three = Three([AppliedEffect("drive_loss", "joint2", {"loss": loss})])
    three.draw(np.random.default_rng(1))
    command, applied, _ = three.step_natively(np.zeros(7))
    # The arm's motors are geared one to one: 2 is the second joint's command.
    torque = command[1]
    assert applied[1] == pytest.approx(torque / (1 + loss * abs(torque)) - torque)


@pytest.mark.parametrize(
    ("law", "reason"),
    [
        (lambda position, velocity: 0.0, "takes 2 arguments"),
        (lambda position, velocity, torque, carried, values: "much", "float64"),
        (0.5, "it is not a function"),
    ],
)
def test_a_law_that_cannot_be_compiled_is_refused_when_it_is_registered(
    law: Any, reason: str
) -> None:
    with pytest.raises(RlcoError, match=f"cannot be compiled .*{reason}.*; write it"):
        register(replace(_own("odd", ("size",)), torque=law))
    assert "odd" not in EFFECTS
