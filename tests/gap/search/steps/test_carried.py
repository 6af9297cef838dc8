"""A payload at the link that carries a jaw is not named at the jaw."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rlco.gap.compare.arm.rollouts import ArmRollouts
from rlco.gap.compare.problem import Candidate
from rlco.gap.logs.log import Log, Recording
from rlco.gap.search.state import State
from rlco.gap.search.steps.carried import carried, carrier
from rlco.gap.search.steps.start import start
from rlco.physics.effects import AppliedEffect

FPS, NOISE = 50, 4e-4
PLACE = [0.0, 0.03, 0.06]  # of the payload; 0.1 m away from the jaw's axis
JOINTS = ("shoulder", "elbow", "jaw")
ARM = """
<mujoco><compiler angle="radian"/>
<option timestep="0.004" integrator="implicitfast"/><worldbody>
<body name="upper"><joint name="shoulder" axis="0 0 1" damping="0.2" armature="0.01"/>
<inertial pos="0.1 0 0" mass="0.5" diaginertia="0.001 0.002 0.002"/>
<body name="gripper" pos="0.2 0 0"><joint name="elbow" axis="0 1 0" damping="0.1"
armature="0.01"/><inertial pos="0.08 0 0" mass="0.3" diaginertia="0.001 0.001 0.001"/>
<body name="finger" pos="0.1 0 0.02"><joint name="jaw" axis="0 1 0" damping="0.05"
armature="0.005"/><inertial pos="0.03 0 0" mass="0.03" diaginertia="1e-5 1e-5 1e-5"/>
</body></body></body></worldbody><actuator>
<position name="shoulder" joint="shoulder" kp="40" kv="2"/>
<position name="elbow" joint="elbow" kp="20" kv="1"/>
<position name="jaw" joint="jaw" kp="5" kv="0.2"/></actuator></mujoco>
"""


def _waves(seed: int) -> NDArray[np.float64]:
    random, time = np.random.default_rng(seed), np.arange(4 * FPS) / FPS
    columns = [
        sum(
            0.25 * np.sin(2 * np.pi * random.uniform(0.2, 1.2) * time + phase)
            for phase in random.uniform(0, 2 * np.pi, 3)
        )
        for _ in JOINTS
    ]
    return np.stack(columns, axis=1) * np.minimum(time / 0.3, 1.0)[:, None]


def _recorded(holder: str, seed: int) -> Recording:
    """A recording with 150 g at a link, by a plain loop of MuJoCo's steps."""
    spec = mujoco.MjSpec.from_string(ARM)
    held = spec.body(holder).add_body(pos=PLACE)
    held.mass, held.inertia, held.ipos = 0.15, [6e-6] * 3, [0.0] * 3
    held.explicitinertial = True
    model = spec.compile()
    data, sent = mujoco.MjData(model), _waves(seed)
    position, velocity = np.empty_like(sent), np.empty_like(sent)
    for frame, goal in enumerate(sent):
        position[frame], velocity[frame] = data.qpos, data.qvel
        data.ctrl[:] = goal
        mujoco.mj_step(model, data, nstep=round(1 / FPS / model.opt.timestep))
    told = position + np.random.default_rng(seed).normal(0, NOISE, position.shape)
    time = np.arange(len(sent)) / FPS
    return Recording(f"episode {seed}", time, told, velocity, sent)


def _found_at_the_jaw(holder: str) -> State:
    """A search that ended with a payload at the jaw, fitted, and nothing else."""
    recordings = tuple(_recorded(holder, seed) for seed in range(4))
    log = Log(recordings, JOINTS, JOINTS)
    problem = ArmRollouts(mujoco.MjSpec.from_string(ARM), log, np.full(3, NOISE))
    state = start(problem)
    place = {"mass": 0.1, "x": 0.02, "y": 0.0, "z": 0.0}
    state, (best, *_) = state.fit([[AppliedEffect("payload", "finger", place)]], 12)
    return replace(state, best=best, ended=True)


@pytest.mark.slow
def test_what_the_gripper_holds_is_not_named_at_its_jaw() -> None:
    state = _found_at_the_jaw("gripper")
    assert state.best.error > 1.5  # what the jaw cannot explain
    found = carried(state).best
    ((name, target),) = ((one.name, one.target) for one in found.effects)
    assert (name, target) == ("payload", "gripper")
    assert found.effects[0].values == pytest.approx([0.15, *PLACE], abs=0.01)
    assert found.error < 1.1


@pytest.mark.slow
def test_what_the_jaw_holds_stays_there() -> None:
    state = _found_at_the_jaw("finger")
    assert carried(state).best is state.best


def test_a_link_that_is_no_light_jaw_has_no_carrier() -> None:
    model = mujoco.MjModel.from_xml_string(ARM)

    assert carrier(model, Candidate("payload", "finger")) == "gripper"
    assert carrier(model, Candidate("payload", "gripper")) is None  # 0.3 kg on 0.5 kg
    assert carrier(model, Candidate("payload", "upper")) is None  # on the ground
    assert carrier(model, Candidate("armature", "jaw")) is None
