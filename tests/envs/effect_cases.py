"""What the tests of effects share: one effect of each kind, and how it is played."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rlco.physics.effects import AppliedEffect
from rlco.physics.native.stepper import NativeStepper
from rlco.physics.robosuite.effect_sim import EffectSim
from rlco.physics.robosuite.tabletop import Tabletop
from rlco.physics.spec.domain import SIM, Domain, with_effects
from rlco.physics.spec.task import InitialState
from rlco.physics.tasks.push_cube import TASK

Array = NDArray[np.float64]


def effect(name: str, target: str | None = None, **numbers: float) -> AppliedEffect:
    return AppliedEffect(name, target, numbers)


# Each is large enough to be seen in a second.
EFFECTS = {
    "coulomb_friction": effect("coulomb_friction", "joint2", frictionloss=6.0),
    "viscous_damping": effect("viscous_damping", "joint2", damping=30.0),
    "stribeck_friction": effect("stribeck_friction", "joint2", static=9.0, speed=0.2),
    "load_friction": effect("load_friction", "joint2", ratio=0.1),
    "armature": effect("armature", "joint2", armature=2.0),
    "payload": effect("payload", "right_hand", mass=1.5, x=0.0, y=0.02, z=0.1),
    "link_inertia": effect("link_inertia", "link5", factor=1.8),
    "actuator_gain": effect("actuator_gain", "joint2", factor=0.85),
    "actuator_lag": effect("actuator_lag", "joint2", time_constant=0.02),
    "torque_limit": effect("torque_limit", "joint2", limit=20.0),
    "command_delay": effect("command_delay", delay=0.13),
    "random_delay": effect("random_delay", mean=0.13, spread=0.05),
    "joint_offset": effect("joint_offset", "joint4", offset=0.05),
    "encoder_scale": effect("encoder_scale", "joint2", factor=1.06),
    "joint_stiffness": effect("joint_stiffness", "joint4", stiffness=9.0, rest=0.0),
    "torque_bias": effect("torque_bias", "joint2", torque=6.0),
    "gravity_tilt": effect("gravity_tilt", roll=0.1, pitch=0.15),
    "control_rate": effect("control_rate", period=0.12),
    "drive_loss": effect("drive_loss", "joint2", loss=0.01),
    "contact_friction": effect("contact_friction", friction=0.2),
    "contact_stiffness": effect("contact_stiffness", time_constant=0.05),
    "object_mass": effect("object_mass", "red_cube", factor=4.0),
    "cogging": effect(
        "cogging",
        "joint2",
        amplitude=6.0,
        count=40.0,
        phase=0.3,
        second_sine=2.0,
        second_cosine=-1.0,
    ),
    "hardening_spring": effect("hardening_spring", "joint4", hardening=9.0, rest=-1.5),
}
SERVO_ONLY = {
    "velocity_limit": effect("velocity_limit", "joint4", limit=0.5),
    "backlash": effect("backlash", "joint4", width=0.02),
    "joint_compliance": effect("joint_compliance", "joint4", compliance=1e-3),
}
MANY = (
    EFFECTS["stribeck_friction"],
    EFFECTS["payload"],
    EFFECTS["joint_offset"],
    EFFECTS["command_delay"],
    EFFECTS["control_rate"],
    EFFECTS["actuator_lag"],
    EFFECTS["drive_loss"],
)


def start_of(seed: int) -> InitialState:
    return TASK.sample(np.random.default_rng(seed), None)


class Pair:
    """The same effects in both backends, the native one led by robosuite's state."""

    def __init__(self, effects: Any, domain: Domain) -> None:
        self.env = Tabletop(TASK, with_effects(domain, effects))
        self.native = NativeStepper(
            TASK, domain, num_envs=1, threads=1, exact=True, effects=effects
        )

    def start(self, seed: int) -> None:
        self.env.start(start_of(seed))
        self.native.reset([start_of(seed)])

    def anchor(self) -> None:
        """Copy state, forces and friction, and what is on its way to the actuators."""
        model, data = self.env.sim.model._model, self.env.sim.data._data
        copies = self.native.worlds
        own, memory, ours = copies.model, copies.memory, copies.data[0]
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.empty(mujoco.mj_stateSize(model, kind))
        mujoco.mj_getState(model, data, state, kind)
        mujoco.mj_setState(own, ours, state, kind)
        memory.grip[0] = self.env.robots[0].gripper["right"].current_action
        for name in ("qfrc_actuator", "qfrc_bias"):
            getattr(ours, name)[:] = getattr(data, name)
        if isinstance(self.env.sim, EffectSim):
            memory.ctrl[0] = self.env.sim._reached

    def step(self, action: Array) -> float:
        """Step both; return the largest difference of a coordinate."""
        self.anchor()
        self.env.step(action)
        self.native.step(action[None, None])
        ours = self.native.data[0].qpos
        return float(np.abs(self.env.sim.data._data.qpos - ours).max())


def in_the_air(rng: np.random.Generator, step: int) -> Array:
    action = rng.uniform(-0.4, 0.4, 7)
    action[2] = 0.6 if step < 6 else 0.1
    action[6] = 1.0
    return action


def play(effects: Any, actions: Array, seed: int = 3) -> NativeStepper:
    """Play actions (T, 7) and return the stepper at their end."""
    native = NativeStepper(TASK, SIM, num_envs=1, threads=1, effects=effects)
    native.reset([start_of(seed)])
    native.step(actions[None])
    return native


def hold(steps: int = 12) -> Array:
    return np.zeros((steps, 7))


def rise(steps: int = 12) -> Array:
    actions = np.zeros((steps, 7))
    actions[:, 2] = 0.5
    return actions


def height(native: NativeStepper) -> float:
    return float(native.scene_state().tool_position[0, 2])
